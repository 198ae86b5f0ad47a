"""``corridor export``: a run's policies as the ONNX files that Unity's inference reads; see ``onnx_graph``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mlagents_envs.base_env import BehaviorSpec
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from torch import Tensor, nn

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.files import write_whole
from trainer.learning.normaliser import ObservationNormaliser
from trainer.learning.stages import Stages, build_stages
from trainer.learning.transitions import Singles
from trainer.players.behavior import described, recorded_spec
from trainer.players.slots import Slots
from trainer.players.vec_env import action_space, observation_space
from trainer.runs.behavior_learners import restored_learners
from trainer.runs.folder import RunFolder
from trainer.runs.onnx_check import Allowed, Choices, check_graph
from trainer.runs.onnx_graph import LimitedActor, Scaling, graph_of
from trainer.runs.onnx_learner import learner_as_onnx
from trainer.runs.training import load_trained


def export_run(config: RunConfig, folder: RunFolder, path: Path) -> list[Path]:
    """Writes the policies of a run's newest checkpoint, each whole or not at all, once all equal the run's own.

    Args:
        config: The run.
        folder: Its folder.
        path: The ONNX file. In a run of several behaviors, each has its own beside it, ``<stem>-<behavior>.onnx``.

    Returns:
        The files, in the behaviors' order.

    Raises:
        TrainerError: There is no checkpoint or it does not fit, a policy has no form in ONNX, or a file can't be
            written.
    """
    learners = restored_learners(config, folder.read_checkpoint(config))
    programs = {}
    for name, learner in learners.items():
        own = path.with_stem(f"{path.stem}-{folder.behavior(name, only=False).path.name}")
        programs[own if len(learners) > 1 else path] = learner_as_onnx(learner)
    if not learners:
        programs[path] = _lockstep_as_onnx(config, folder)
    for each, program in programs.items():
        try:
            write_whole(each, program)
        except OSError as error:
            raise TrainerError(f"{each} can't be written ({error}); choose another file with --onnx.") from error
    return list(programs)


def _lockstep_as_onnx(config: RunConfig, folder: RunFolder) -> bytes:
    spec = _spec(folder)
    agents = folder.read_agents() or config.num_areas
    stages = build_stages(config, _Nobody(config.num_envs * agents, spec))
    load_trained(config, folder, stages)
    return policy_as_onnx(stages, spec)


def policy_as_onnx(stages: Stages, spec: BehaviorSpec) -> bytes:
    """A policy of Stable-Baselines3 as a serialised ONNX model, compared with the policy.

    Args:
        stages: Hold the policy, and the normaliser of its observations.
        spec: The behavior that it was trained on: vectors, and either continuous actions or discrete ones.

    Raises:
        TrainerError: The policy has no form in ONNX, or they differ.
    """
    policy = stages.model.policy
    if type(policy) is not ActorCriticPolicy:
        raise TrainerError(
            f"A policy of {type(stages.model).__name__} ({type(policy).__name__}) can't be exported; train with ppo, "
            "a2c or trpo, whose actor is one network from observations to actions."
        )
    behavior, scalings = described("", spec), _scalings(stages, spec)
    log_std = torch.zeros(0) if behavior.discrete_branches else policy.log_std
    program = graph_of(behavior, LimitedActor(_LockstepActor(policy), log_std), scalings)
    check_graph(program, behavior, scalings, _LockstepPolicy(policy, stages.normaliser, behavior.discrete_branches))
    return program


def _scalings(stages: Stages, spec: BehaviorSpec) -> Mapping[int, Scaling]:
    """What eq. 7 does to each observation, of all of them one after the other."""
    statistics, epsilon = stages.normaliser.statistics, stages.normaliser.epsilon
    ends = np.cumsum([int(each.shape[0]) for each in spec.observation_specs])[:-1]
    parts = zip(np.split(statistics.mean, ends), np.split(np.sqrt(statistics.var + epsilon), ends), strict=True)
    return {place: Scaling(mean, deviation) for place, (mean, deviation) in enumerate(parts)}


class _Nobody(Slots):
    """Slots that nobody is in: what a policy needs to be built, without a player."""

    def __init__(self, count: int, spec: BehaviorSpec) -> None:
        super().__init__(count, observation_space(spec), action_space(spec))

    def reset(self) -> VecEnvObs:
        raise NotImplementedError

    def step_async(self, actions: NDArray[Any]) -> None:
        raise NotImplementedError

    def step_wait(self) -> VecEnvStepReturn:
        raise NotImplementedError

    def close(self) -> None:
        pass


class _LockstepActor(nn.Module):
    def __init__(self, policy: ActorCriticPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observations: Sequence[Tensor]) -> Tensor:
        joined = torch.cat(list(observations), dim=1) if len(observations) > 1 else observations[0]
        layer: Tensor = self.policy.action_net(self.policy.mlp_extractor.forward_actor(joined))
        return layer


class _LockstepPolicy:
    """A policy of Stable-Baselines3, which knows no masks: they are put on the logits of its choices."""

    def __init__(self, policy: ActorCriticPolicy, normaliser: ObservationNormaliser, branches: Sequence[int]) -> None:
        self._policy, self._normaliser, self._branches = policy, normaliser, branches

    def best(self, observations: Sequence[Singles], allowed: Allowed) -> tuple[Singles, Choices]:
        rows = len(observations[0])
        if allowed is None:
            actions, _ = self._policy.predict(self._normalised(observations), deterministic=True)
            return actions, np.zeros((rows, 0), np.int64)
        parts = np.split(np.where(allowed, self._logits(observations), -np.inf), np.cumsum(self._branches)[:-1], axis=1)
        return np.zeros((rows, 0), np.float32), np.stack([part.argmax(axis=1) for part in parts], axis=1)

    def log_probs(self, observations: Sequence[Singles], allowed: Allowed, choices: Choices) -> Singles:
        places = choices + np.cumsum((0, *self._branches[:-1]))
        chosen: Singles = np.take_along_axis(self._logits(observations), places, axis=1).sum(axis=1)
        return chosen

    def _normalised(self, observations: Sequence[Singles]) -> Singles:
        return self._normaliser.normalize_obs(np.concatenate(observations, axis=1))

    @torch.no_grad()
    def _logits(self, observations: Sequence[Singles]) -> Singles:
        distribution: Any = self._policy.get_distribution(torch.from_numpy(self._normalised(observations))).distribution
        each = distribution if isinstance(distribution, list) else [distribution]
        logits: Singles = np.concatenate([part.logits.numpy() for part in each], axis=1)
        return logits


def _spec(folder: RunFolder) -> BehaviorSpec:
    try:
        spec = recorded_spec(folder.read_behavior())
    except (KeyError, TypeError) as error:
        raise TrainerError(
            f"{folder.configuration} does not say what the policy observes and does; continue the run with --resume, "
            "which records it."
        ) from error
    others = [tuple(each.shape) for each in spec.observation_specs if len(each.shape) != 1]
    if others:
        raise TrainerError(
            f"{folder.configuration} says that the policy observes shape {others[0]}, but policies with a preset "
            "observe vectors alone; restore the file, or train the run again with --force."
        )
    return spec
