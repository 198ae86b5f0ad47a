"""The policy of a behavior's learner as ONNX; see ``onnx_graph``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN, Actor, SACPolicy
from torch import Tensor, nn

from trainer.learning.actor_critic import ActorCritic
from trainer.learning.learner import Learner
from trainer.learning.observation_encoder import ObservationEncoder
from trainer.learning.observation_scaling import EPSILON
from trainer.learning.ppo_learner import PPOLearner
from trainer.learning.sac_learner import SACLearner
from trainer.learning.tensors import tensor, tensors
from trainer.learning.transitions import Singles
from trainer.runs.onnx_check import Allowed, Choices, OwnPolicy, check_graph
from trainer.runs.onnx_graph import LimitedActor, Scaling, SquashedActor, graph_of


def learner_as_onnx(learner: Learner) -> bytes:
    """A learner's policy as a serialised ONNX model, compared with the policy.

    Raises:
        TrainerError: They differ.
    """
    scalings = {
        place: Scaling(each.mean, np.sqrt(each.var + EPSILON))
        for place, each in learner.observations.statistics.items()
    }
    actor: LimitedActor | SquashedActor
    policy: OwnPolicy
    if isinstance(learner, SACLearner):
        actor, policy = SquashedActor(_SACActor(learner)), _SACPolicy(learner)
    else:
        assert isinstance(learner, PPOLearner)
        actor, policy = LimitedActor(_PPOActor(learner.policy), learner.policy.log_std), _PPOPolicy(learner)
    program = graph_of(learner.behavior, actor, scalings)
    check_graph(program, learner.behavior, scalings, policy)
    return program


class _PPOActor(nn.Module):
    def __init__(self, policy: ActorCritic) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observations: Sequence[Tensor]) -> Tensor:
        features = self.policy.encoder.encode(observations)
        layer: Tensor = self.policy.action_net(self.policy.mlp_extractor.policy_net(features))
        return layer


class _PPOPolicy:
    def __init__(self, learner: PPOLearner) -> None:
        self._policy, self._observations = learner.policy, learner.observations

    def best(self, observations: Sequence[Singles], allowed: Allowed) -> tuple[Singles, Choices]:
        acted = self._policy.act(tensors(self._observations.scaled(observations)), tensor(allowed), deterministic=True)
        return np.clip(acted.continuous.numpy(), -1.0, 1.0), acted.discrete.numpy()

    @torch.no_grad()
    def log_probs(self, observations: Sequence[Singles], allowed: Allowed, choices: Choices) -> Singles:
        scaled, masks = tensors(self._observations.scaled(observations)), tensor(allowed)
        means = self._policy.act(scaled, masks, deterministic=True).continuous
        log_probs: Singles = self._policy.evaluate(scaled, masks, means, torch.from_numpy(choices))[1].numpy()
        return log_probs


def _sacs_actor(learner: SACLearner) -> Actor:
    assert isinstance(learner.policy, SACPolicy)
    return learner.policy.actor


class _SACActor(nn.Module):
    def __init__(self, learner: SACLearner) -> None:
        super().__init__()
        self.actor = _sacs_actor(learner)

    def forward(self, observations: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        encoder = self.actor.features_extractor
        assert isinstance(encoder, ObservationEncoder)
        latent = self.actor.latent_pi(encoder.encode(observations))
        log_std: Any = self.actor.log_std  # a layer, without state-dependent exploration
        return self.actor.mu(latent), log_std(latent).clamp(LOG_STD_MIN, LOG_STD_MAX)


class _SACPolicy:
    """Has no choices: they are PPO's alone."""

    def __init__(self, learner: SACLearner) -> None:
        self._actor, self._observations = _sacs_actor(learner), learner.observations

    def best(self, observations: Sequence[Singles], allowed: Allowed) -> tuple[Singles, Choices]:
        scaled = tensors(self._observations.scaled(observations))
        named = {f"obs_{place}": each for place, each in enumerate(scaled)}
        with torch.no_grad():
            actions: Singles = self._actor(named, deterministic=True).numpy()
        return actions, np.zeros((len(actions), 0), np.int64)

    def log_probs(self, observations: Sequence[Singles], allowed: Allowed, choices: Choices) -> Singles:
        raise NotImplementedError
