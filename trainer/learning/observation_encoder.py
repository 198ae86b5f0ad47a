"""One vector of features out of everything that an agent observes: vectors, pictures, buffers and goal signals."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from corridor_server.protocol.agents import VARIABLE_SIZE, Behavior, Sensor
from trainer.errors import TrainerError
from trainer.learning.picture_encoder import EncoderType, PictureEncoder, channel_axis

ConditioningType = Literal["hyper", "none"]
GOAL_SIGNAL = 1  # ObservationTypeProto
EMBEDDING, HEADS = 128, 4  # of attention, as in ML-Agents
PADDING = -1e9  # instead of minus infinity, which gives NaN where a buffer has nothing but padding


def observation_space(behavior: Behavior) -> spaces.Dict:
    """What an agent observes, as ``obs_0``, ``obs_1``, ... in the sensors' order, float32.

    With discrete branches there is ``action_masks`` beside it, (sum of the branches,), 1 for what may be chosen.
    """
    each: dict[str, spaces.Space[np.ndarray]] = {}
    for number, sensor in enumerate(behavior.sensors):
        low, high = (-np.inf, np.inf) if channel_axis(sensor) is None else (0.0, 1.0)
        each[f"obs_{number}"] = spaces.Box(low, high, sensor.shape, np.float32)
    if behavior.discrete_branches:
        each["action_masks"] = spaces.Box(0.0, 1.0, (sum(behavior.discrete_branches),), np.float32)
    return spaces.Dict(each)


def sees_vectors_only(behavior: Behavior, goal_conditioning_type: ConditioningType) -> bool:
    """Whether the encoder has nothing to learn: what agents observe is put into one row as it is."""
    vectors = all(channel_axis(sensor) is None and not _is_buffer(sensor) for sensor in behavior.sensors)
    has_goal = any(sensor.kind == GOAL_SIGNAL for sensor in behavior.sensors)
    return vectors and not (has_goal and goal_conditioning_type == "hyper")


class ObservationEncoder(BaseFeaturesExtractor):
    """Features of a dictionary of observations, for any policy of Stable-Baselines3.

    - A vector is taken as it is, and so is whatever is neither picture nor buffer, as one row.
    - A picture goes through a ``PictureEncoder``.
    - A buffer, two dimensions of which the first is of variable size, goes through an ``EntityEncoder``, which sees
      vectors and pictures beside it.
    - Goal signals are observations like others. With ``hyper`` they also condition the features: everything goes
      through one layer of ``hidden_units``, and each of its units is scaled and shifted by what the goal makes of it.
      ML-Agents has a network that makes all weights of that layer out of the goal; ours makes the diagonal of that
      matrix and a bias, a hundredth of the work, behind weights that all goals share.

    Args:
        observation_space: With ``obs_0``, ``obs_1``, ...; see ``observation_space``.
        sensors: In that order.
        hidden_units: How many features a picture has, and the layer that goals condition.
        vis_encode_type: The network for pictures.
        goal_conditioning_type: What goal signals do.

    Raises:
        TrainerError: A picture is too small for this network, or there is nothing to see.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        sensors: tuple[Sensor, ...],
        *,
        hidden_units: int = 128,
        vis_encode_type: EncoderType = "simple",
        goal_conditioning_type: ConditioningType = "hyper",
    ) -> None:
        sizes = [_features(sensor, hidden_units) for sensor in sensors]
        goals = [number for number, sensor in enumerate(sensors) if sensor.kind == GOAL_SIGNAL]
        hyper = bool(goals) and goal_conditioning_type == "hyper"
        if not sum(sizes):
            raise TrainerError(
                "The behavior's agents observe nothing, but at least one number was expected; add a sensor that sees "
                "something."
            )
        super().__init__(observation_space, hidden_units if hyper else sum(sizes))
        self._entity_places = [number for number, sensor in enumerate(sensors) if _is_buffer(sensor)]
        self._other_places = [number for number in range(len(sensors)) if number not in self._entity_places]
        self._goal_places = goals if hyper else []
        beside = sum(sizes[number] for number in self._other_places)
        self.sensor_encoders = nn.ModuleList()
        for number, sensor in enumerate(sensors):
            if number in self._entity_places:
                self.sensor_encoders.append(EntityEncoder(sensor.shape[1], beside))
            elif channel_axis(sensor) is not None:
                self.sensor_encoders.append(PictureEncoder(sensor, hidden_units, vis_encode_type))
            else:
                self.sensor_encoders.append(nn.Flatten())
        if hyper:
            self.conditioned = nn.Sequential(nn.Linear(sum(sizes), hidden_units), nn.Tanh())
            self.conditioning = nn.Linear(sum(sizes[number] for number in goals), 2 * hidden_units)

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Features, (n, features_dim), of ``obs_0``, ``obs_1``, ..., each (n, *shape) float32."""
        return self.encode([observations[f"obs_{number}"] for number in range(len(self.sensor_encoders))])

    def encode(self, observations: Sequence[Tensor]) -> Tensor:
        """Features, (n, features_dim), of observations in the sensors' order, each (n, *shape) float32."""
        parts: dict[int, Tensor] = {}
        for number in self._other_places:
            parts[number] = self.sensor_encoders[number](observations[number])
        beside = _joined(list(parts.values())) if parts else None
        for number in self._entity_places:
            parts[number] = self.sensor_encoders[number](observations[number], beside)
        features = _joined(list(parts.values()))
        if not self._goal_places:
            return features
        scale, shift = self.conditioning(_joined([parts[number] for number in self._goal_places])).chunk(2, dim=1)
        conditioned: Tensor = self.conditioned(features) * (1.0 + scale) + shift
        return conditioned


class EntityEncoder(nn.Module):
    """Features of a buffer: an embedding of every entity, residual self-attention, and the mean over the entities.

    Rows of zeros are padding, whose number changes nothing; a buffer of nothing else gives zeros.

    Args:
        size: Length of an entity.
        beside: How many features of the agent itself each entity is seen with.
    """

    def __init__(self, size: int, beside: int) -> None:
        super().__init__()
        self.embed_entity = nn.Linear(size, EMBEDDING)
        self.embed_self = nn.Linear(beside, EMBEDDING, bias=False) if beside else None
        self.before, self.after = nn.LayerNorm(EMBEDDING), nn.LayerNorm(EMBEDDING)
        self.query_key_value = nn.Linear(EMBEDDING, 3 * EMBEDDING)
        self.output = nn.Linear(EMBEDDING, EMBEDDING)

    def forward(self, entities: Tensor, beside: Tensor | None) -> Tensor:
        """Features, (n, EMBEDDING), of entities, (n, rows, size), each seen with (n, beside)."""
        real = entities.abs().amax(dim=2).gt(0.0)  # ONNX compares floats for equality from opset 11 on
        embedded: Tensor = self.embed_entity(entities)
        if self.embed_self is not None:
            embedded = embedded + self.embed_self(beside).unsqueeze(1)
        embedded = self.before(nn.functional.silu(embedded))
        rows = entities.shape[1]
        query, key, value = (
            part.reshape(-1, rows, HEADS, EMBEDDING // HEADS).transpose(1, 2)
            for part in self.query_key_value(embedded).chunk(3, dim=2)
        )
        scores = query @ key.transpose(2, 3) / math.sqrt(EMBEDDING // HEADS)
        scores = scores.masked_fill(~real[:, None, None, :], PADDING)
        attended = (scores.softmax(dim=3) @ value).transpose(1, 2).reshape(-1, rows, EMBEDDING)
        encoded = self.after(self.output(attended) + embedded)
        weights = real.to(encoded.dtype).unsqueeze(2)
        mean: Tensor = (encoded * weights).sum(dim=1) / weights.sum(dim=1).clamp(min=1.0)
        return mean


def _is_buffer(sensor: Sensor) -> bool:
    return len(sensor.shape) == 2 and sensor.dimension_properties[:1] == (VARIABLE_SIZE,)


def _features(sensor: Sensor, hidden_units: int) -> int:
    if _is_buffer(sensor):
        return EMBEDDING
    return math.prod(sensor.shape) if channel_axis(sensor) is None else hidden_units


def _joined(parts: list[Tensor]) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
