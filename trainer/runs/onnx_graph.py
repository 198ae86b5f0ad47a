"""A policy as the ONNX graph that Unity's inference reads: names, order, shapes and types of ``mlagents-learn``'s own.

Inputs, float32, are ``obs_0``, ``obs_1``, ... in the sensors' order: a vector [batch, n], a buffer [batch, most, n],
and a picture [batch, channels, height, width] from 0 to 1, whichever order of its axes it was trained in; and, with
discrete actions, ``action_masks`` [batch, all branches], 1 for what may be chosen.

Outputs, in this order, are ``version_number`` [1] = 3 and ``memory_size`` [1] = 0; with continuous actions
``continuous_actions`` [batch, size] (sampled), ``continuous_action_output_shape`` [1] and
``deterministic_continuous_actions`` [batch, size]; then, with discrete ones, the same three with ``discrete``, the
actions int64 [batch, branches] and the shape [1, branches]. Normalisation of observations and clipping of actions are
inside. All of it is opset 9, attention and convolutions too.
"""

import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from corridor_server.protocol.agents import Behavior
from trainer.learning.normaliser import OBSERVATION_CLIP
from trainer.learning.picture_encoder import channel_axis
from trainer.signals import temporary_folder

OPSET = 9  # ML-Agents' own, which every version of Unity's inference reads
API_VERSION = 3.0  # ModelApiVersion.MLAgents2_0
BLOCKED = 1e8
MASKS = "action_masks"


class Scaling(NamedTuple):
    """How a vector observation is normalised: less its mean, over its deviation, limited to +-10.

    Attributes:
        mean: (size,) float64.
        deviation: (size,) float64, above 0.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


class LimitedActor(nn.Module):
    """An actor whose continuous actions are drawn about means, with the same deviations everywhere, and limited.

    Args:
        network: Makes of observations the means, and then the choices' logits, (n, continuous actions + all branches).
        log_std: Logarithms of the standard deviations, (continuous actions,).
    """

    deviation: Tensor

    def __init__(self, network: nn.Module, log_std: Tensor) -> None:
        super().__init__()
        self.network, self.size = network, len(log_std)
        self.register_buffer("deviation", log_std.detach().exp())

    def forward(self, observations: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Drawn actions, the most likely ones, (n, continuous actions) each, and logits, (n, all branches)."""
        outputs: Tensor = self.network(observations)
        if not self.size:
            return outputs, outputs, outputs
        means = outputs[:, : self.size]
        sampled = means + self.deviation * torch.randn_like(means)
        return sampled.clamp(-1.0, 1.0), means.clamp(-1.0, 1.0), outputs[:, self.size :]


class SquashedActor(nn.Module):
    """An actor whose continuous actions are the tanh of what is drawn about means: SAC's.

    Args:
        network: Makes of observations the means and the logarithms of the standard deviations, (n, continuous actions)
            each.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, observations: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Drawn actions, the most likely ones, (n, continuous actions) each, and something in place of logits."""
        means, log_std = self.network(observations)
        return (means + log_std.exp() * torch.randn_like(means)).tanh(), means.tanh(), means


def graph_of(behavior: Behavior, actor: LimitedActor | SquashedActor, scalings: Mapping[int, Scaling]) -> bytes:
    """A policy as a serialised ONNX model.

    Args:
        behavior: What agents observe and do.
        actor: Makes of a list of observations, each (n, *shape) float32 and normalised, continuous actions that are
            drawn, the most likely ones, and the choices' logits; what the behavior has none of may be anything.
        scalings: Of the observations that are normalised, by their place.
    """
    names = [f"obs_{place}" for place in range(len(behavior.sensors))]
    inputs = [torch.zeros(1, *_unity_shape(behavior, place)) for place in range(len(behavior.sensors))]
    outputs, batched = ["version_number", "memory_size"], list(names)
    for kind, does in (("continuous", behavior.continuous_actions), ("discrete", behavior.discrete_branches)):
        if does:
            actions = [f"{kind}_actions", f"deterministic_{kind}_actions"]
            outputs += [actions[0], f"{kind}_action_output_shape", actions[1]]
            batched += actions
    if behavior.discrete_branches:
        inputs.append(torch.ones(1, sum(behavior.discrete_branches)))
        names.append(MASKS)
        batched.append(MASKS)
    network = _Graph(behavior, actor, scalings).eval()
    with temporary_folder() as folder, warnings.catch_warnings():
        path = folder / "policy.onnx"
        # torch calls this exporter deprecated, but its newer one begins at opset 18.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network,
            tuple(inputs),
            path,
            opset_version=OPSET,
            dynamo=False,
            input_names=names,
            output_names=outputs,
            dynamic_axes={name: {0: "batch"} for name in batched},
        )
        return path.read_bytes()


def _unity_shape(behavior: Behavior, place: int) -> tuple[int, ...]:
    sensor = behavior.sensors[place]
    channel = channel_axis(sensor)
    if channel is None:
        return sensor.shape
    return (sensor.shape[channel], *(size for axis, size in enumerate(sensor.shape) if axis != channel))


class _Graph(nn.Module):
    version_number: Tensor
    memory_size: Tensor
    continuous_shape: Tensor
    discrete_shape: Tensor

    def __init__(self, behavior: Behavior, actor: nn.Module, scalings: Mapping[int, Scaling]) -> None:
        super().__init__()
        self.actor = actor
        self.size, self.branches = behavior.continuous_actions, list(behavior.discrete_branches)
        self.prepare = nn.ModuleList()
        for place, sensor in enumerate(behavior.sensors):
            channel = channel_axis(sensor)
            if place in scalings:
                self.prepare.append(_Scaled(scalings[place]))
            else:
                self.prepare.append(nn.Identity() if channel is None else _InTheSensorsOrder(channel))
        self.register_buffer("version_number", torch.tensor([API_VERSION]))
        self.register_buffer("memory_size", torch.tensor([0.0]))
        self.register_buffer("continuous_shape", torch.tensor([float(self.size)]))
        self.register_buffer("discrete_shape", torch.tensor([self.branches], dtype=torch.float32))

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        observations = [prepare(values) for prepare, values in zip(self.prepare, inputs, strict=False)]
        sampled, likely, logits = self.actor(observations)
        found = [self.version_number, self.memory_size]
        if self.size:
            found += [sampled, self.continuous_shape, likely]
        if self.branches:
            allowed = inputs[-1]
            logits = logits * allowed + (allowed - 1.0) * BLOCKED
            each = torch.split(logits, self.branches, dim=1)
            choices = torch.cat([torch.multinomial(branch.softmax(dim=1), 1) for branch in each], dim=1)
            best = torch.cat([branch.argmax(dim=1, keepdim=True) for branch in each], dim=1)
            found += [choices, self.discrete_shape, best]
        return tuple(found)


class _Scaled(nn.Module):
    mean: Tensor
    mean_rest: Tensor
    scale: Tensor

    def __init__(self, scaling: Scaling) -> None:
        super().__init__()
        mean = torch.from_numpy(scaling.mean)
        # A float32 mean of 5 is off by up to 2e-7, which the scale of an observation that hardly varies makes large.
        self.register_buffer("mean", mean.float())
        self.register_buffer("mean_rest", (mean - mean.float().double()).float())
        self.register_buffer("scale", torch.from_numpy(1.0 / scaling.deviation).float())

    def forward(self, vectors: Tensor) -> Tensor:
        scaled = (vectors - self.mean - self.mean_rest) * self.scale
        return scaled.clamp(-OBSERVATION_CLIP, OBSERVATION_CLIP)


class _InTheSensorsOrder(nn.Module):
    """Pictures with their channels first, as Unity's inference gives them, in the order they were trained in."""

    def __init__(self, channel: int) -> None:
        super().__init__()
        self.channel_dimension = channel + 1

    def forward(self, pictures: Tensor) -> Tensor:
        return pictures.movedim(1, self.channel_dimension)
