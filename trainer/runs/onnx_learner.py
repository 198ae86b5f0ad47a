"""The policy of a behavior's learner as ONNX; see ``onnx_graph``."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from trainer.learning.actor_critic import ActorCritic
from trainer.learning.observation_scaling import EPSILON
from trainer.learning.ppo_learner import PPOLearner
from trainer.learning.tensors import tensor, tensors
from trainer.learning.transitions import Singles
from trainer.runs.onnx_check import Allowed, Choices, check_graph
from trainer.runs.onnx_graph import Scaling, graph_of


def learner_as_onnx(learner: PPOLearner) -> bytes:
    """A learner's policy as a serialised ONNX model, compared with the policy.

    Raises:
        TrainerError: They differ.
    """
    scalings = {
        place: Scaling(each.mean, np.sqrt(each.var + EPSILON))
        for place, each in learner.observations.statistics.items()
    }
    actor = _LearnersActor(learner.policy)
    program = graph_of(learner.behavior, actor, learner.policy.log_std, scalings)
    check_graph(program, learner.behavior, scalings, _LearnersPolicy(learner))
    return program


class _LearnersActor(nn.Module):
    def __init__(self, policy: ActorCritic) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observations: Sequence[Tensor]) -> Tensor:
        features = self.policy.encoder.encode(observations)
        layer: Tensor = self.policy.action_net(self.policy.mlp_extractor.policy_net(features))
        return layer


class _LearnersPolicy:
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
