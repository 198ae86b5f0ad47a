"""``corridor export``: a run's policy as the ONNX file that Unity's inference reads, named as ``mlagents-learn`` does.

Inputs are ``obs_0``, ``obs_1``, ... [batch, n] and, for discrete actions, ``action_masks`` [batch, all branches] (1
allows a choice). Outputs, in this order: ``version_number`` [1] = 3, ``memory_size`` [1] = 0, then for continuous
actions ``continuous_actions`` (sampled), ``continuous_action_output_shape`` and ``deterministic_continuous_actions``;
for discrete ones the same three with ``discrete``. Normalisation of the observations and clipping of the actions are
inside.
"""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.utils
import torch
from mlagents_envs.base_env import BehaviorSpec
from numpy.typing import NDArray
from onnx.reference import ReferenceEvaluator
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from torch import Tensor, nn

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.files import write_whole
from trainer.learning.normaliser import ObservationNormaliser
from trainer.learning.stages import Stages, build_stages
from trainer.players.behavior import recorded_spec
from trainer.players.slots import Slots
from trainer.players.vec_env import action_space, observation_space
from trainer.runs.folder import RunFolder
from trainer.runs.training import load_trained
from trainer.signals import temporary_folder

OPSET = 9  # ML-Agents' own, which every version of Unity's inference reads
API_VERSION = 3.0  # ModelApiVersion.MLAgents2_0
BLOCKED = 1e8
TOLERANCE = 1e-5
CHECKED_ROWS = 256


def export_run(config: RunConfig, folder: RunFolder, path: Path) -> None:
    """Writes the policy of a run's newest checkpoint, whole or not at all, after comparing it with the run's own.

    Args:
        config: The run.
        folder: Its folder.
        path: The ONNX file.

    Raises:
        TrainerError: There is no checkpoint or it does not fit, the policy has no form in ONNX, or the file can't be
            written.
    """
    spec = _spec(folder)
    agents = folder.read_agents() or config.num_areas
    stages = build_stages(config, _Nobody(config.num_envs * agents, spec))
    load_trained(config, folder, stages)
    program = policy_as_onnx(stages, spec)
    try:
        write_whole(path, program)
    except OSError as error:
        raise TrainerError(f"{path} can't be written ({error}); choose another file with --onnx.") from error


def policy_as_onnx(stages: Stages, spec: BehaviorSpec) -> bytes:
    """A policy as a serialised ONNX model.

    Args:
        stages: Hold the policy, and the normaliser of its observations.
        spec: The behavior that it was trained on.

    Raises:
        TrainerError: The policy has no form in ONNX.
    """
    policy, normaliser = stages.model.policy, stages.normaliser
    if type(policy) is not ActorCriticPolicy:
        raise TrainerError(
            f"A policy of {type(stages.model).__name__} ({type(policy).__name__}) can't be exported; train with ppo, "
            "a2c or trpo, whose actor is one network from observations to actions."
        )
    sizes = [int(each.shape[0]) for each in spec.observation_specs]
    discrete = spec.action_spec.is_discrete()
    branches = [int(size) for size in spec.action_spec.discrete_branches]
    network = _DiscreteActor(policy, normaliser, branches) if discrete else _ContinuousActor(policy, normaliser)
    inputs = [torch.zeros(1, size) for size in sizes]
    names = [f"obs_{index}" for index in range(len(sizes))]
    kind = "discrete" if discrete else "continuous"
    if discrete:
        inputs.append(torch.ones(1, sum(branches)))
        names.append("action_masks")
    actions = [f"{kind}_actions", f"deterministic_{kind}_actions"]
    outputs = ["version_number", "memory_size", actions[0], f"{kind}_action_output_shape", actions[1]]
    program = _traced(network, inputs, names, outputs, [*names, *actions])
    _check(program, stages, sizes, names, sum(branches))
    return program


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


class _Actor(nn.Module):
    """Observations to the actor's last layer, with the normalisation of ``VecNormalize``."""

    mean: Tensor
    mean_rest: Tensor
    scale: Tensor
    version_number: Tensor
    memory_size: Tensor
    shape: Tensor

    def __init__(self, policy: ActorCriticPolicy, normaliser: ObservationNormaliser, shape: Tensor) -> None:
        super().__init__()
        self.policy = policy
        self.clip = normaliser.clip_obs
        mean = torch.from_numpy(normaliser.statistics.mean)
        scale = 1.0 / np.sqrt(normaliser.statistics.var + normaliser.epsilon)
        # A float32 mean of 5 is off by up to 2e-7, which the scale of an observation that hardly varies makes large.
        self.register_buffer("mean", mean.float())
        self.register_buffer("mean_rest", (mean - mean.float().double()).float())
        self.register_buffer("scale", torch.from_numpy(scale).float())
        self.register_buffer("version_number", torch.tensor([API_VERSION]))
        self.register_buffer("memory_size", torch.tensor([0.0]))
        self.register_buffer("shape", shape)

    def last_layer(self, observations: tuple[Tensor, ...]) -> Tensor:
        observation = torch.cat(observations, dim=1) if len(observations) > 1 else observations[0]
        normalised = ((observation - self.mean - self.mean_rest) * self.scale).clamp(-self.clip, self.clip)
        layer: Tensor = self.policy.action_net(self.policy.mlp_extractor.forward_actor(normalised))
        return layer


class _ContinuousActor(_Actor):
    deviation: Tensor

    def __init__(self, policy: ActorCriticPolicy, normaliser: ObservationNormaliser) -> None:
        super().__init__(policy, normaliser, torch.tensor([float(policy.log_std.numel())]))
        self.register_buffer("deviation", policy.log_std.detach().exp())

    def forward(self, *observations: Tensor) -> tuple[Tensor, ...]:
        mean = self.last_layer(observations)
        sampled = (mean + self.deviation * torch.randn_like(mean)).clamp(-1.0, 1.0)
        return self.version_number, self.memory_size, sampled, self.shape, mean.clamp(-1.0, 1.0)


class _DiscreteActor(_Actor):
    def __init__(self, policy: ActorCriticPolicy, normaliser: ObservationNormaliser, branches: list[int]) -> None:
        super().__init__(policy, normaliser, torch.tensor([branches], dtype=torch.float32))
        self.branches = branches

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        logits = self.last_layer(inputs[:-1]) + (inputs[-1] - 1.0) * BLOCKED
        each = torch.split(logits, self.branches, dim=1)
        sampled = torch.cat([torch.multinomial(branch.softmax(dim=1), 1) for branch in each], dim=1)
        best = torch.cat([branch.argmax(dim=1, keepdim=True) for branch in each], dim=1)
        return self.version_number, self.memory_size, sampled, self.shape, best


def _traced(
    network: nn.Module, inputs: list[Tensor], names: list[str], outputs: list[str], batched: list[str]
) -> bytes:
    with temporary_folder() as folder, warnings.catch_warnings():
        path = folder / "policy.onnx"
        # torch calls this exporter deprecated, but its newer one begins at opset 18.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network.eval(),
            tuple(inputs),
            path,
            opset_version=OPSET,
            dynamo=False,
            input_names=names,
            output_names=outputs,
            dynamic_axes={name: {0: "batch"} for name in batched},
        )
        return path.read_bytes()


def _check(program: bytes, stages: Stages, sizes: list[int], names: list[str], choices: int) -> None:
    """Compares the graph with ``predict`` of Stable-Baselines3 on observations as they come.

    Raises:
        TrainerError: They differ.
    """
    model = onnx.load_from_string(program)
    onnx.checker.check_model(model, full_check=True)
    rms = stages.normaliser.statistics
    drawn = np.random.default_rng(0).standard_normal((CHECKED_ROWS, sum(sizes)))
    observations = (rms.mean + np.sqrt(rms.var) * drawn).astype(np.float32)
    feed = dict(zip(names, np.split(observations, np.cumsum(sizes)[:-1], axis=1), strict=False))
    if choices:
        feed["action_masks"] = np.ones((CHECKED_ROWS, choices), np.float32)
    deterministic = onnx.utils.Extractor(model).extract_model(list(feed), [model.graph.output[-1].name])
    found: Any = next(iter(ReferenceEvaluator(deterministic).run(None, feed)))
    expected, _ = stages.model.predict(np.asarray(stages.normaliser.normalize_obs(observations)), deterministic=True)
    difference = float(np.abs(found - expected.reshape(found.shape)).max())
    if not difference <= TOLERANCE:
        raise TrainerError(f"The exported policy differs from the run's by {difference:g}; it was not written.")


def _spec(folder: RunFolder) -> BehaviorSpec:
    try:
        spec = recorded_spec(folder.read_behavior())
    except (KeyError, TypeError) as error:
        raise TrainerError(
            f"{folder.configuration} does not say what the policy observes and does; continue the run with --resume, "
            "which records it."
        ) from error
    images = [tuple(each.shape) for each in spec.observation_specs if len(each.shape) != 1]
    if images:
        raise TrainerError(
            f"The policy observes pictures (shape {images[0]}), but only policies of vector observations can be "
            "exported."
        )
    return spec
