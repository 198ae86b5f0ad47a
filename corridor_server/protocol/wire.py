"""The codec: agent batches to a message's bytes, a trainer's bytes to a command. It knows no rewards and no sockets.

Batches of vector observations and plain STEP messages go by ``columnar``; everything else goes by the protobuf parser.
"""

import struct
import zlib
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from corridor_server.protocol import columnar
from corridor_server.protocol.agent_layout import Sensor
from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents, Behavior
from corridor_server.protocol.messages import (
    ACADEMY,
    API_VERSION,
    OK,
    PNG,
    QUIT,
    RESET,
    STEP,
    STOP,
    AgentInfoProto,
    UnityMessageProto,
    mistyped_field,
)

CONTINUOUS = 1  # SpaceTypeProto
# DimensionProperty: neither translation-equivariant nor of variable size; translation-equivariant, as pictures are; of
# variable size, as buffers are.
NO_PROPERTY, TRANSLATIONAL_EQUIVARIANCE, VARIABLE_SIZE = 1, 2, 4


@dataclass(frozen=True)
class Camera:
    """How pictures travel.

    Attributes:
        compressed: As PNG; otherwise as floats from 0 to 1.
        channels_first: Shape (3, height, width), as clients from mlagents-envs 1.0 on expect it; (height, width, 3) for
            older ones. The protocol's version is the same.
    """

    compressed: bool = True
    channels_first: bool = False


@dataclass(frozen=True)
class Command:
    """A trainer's reply, once the session has begun.

    Attributes:
        number: STEP, RESET or QUIT; QUIT also for a status other than 200.
        side_channel: Bytes for the side channels, to be applied first.
        actions: Of a STEP, (n, continuous actions) float32 for the agents that asked, as received: clipping is the
            world's.
        discrete: Of the same STEP, the choice in each discrete branch, (n, branches) int32.
    """

    number: int
    side_channel: bytes = b""
    actions: NDArray[np.float32] | None = None
    discrete: NDArray[np.int32] | None = None


class WireError(ValueError):
    """A message from the trainer that can't be used."""


def hello(package_version: str) -> bytes:
    """The player's first message (RL_INITIALIZATION_OUTPUT): from which package it is, and what it can do or takes."""
    message = UnityMessageProto()
    message.header.status = OK
    output = message.unity_output.rl_initialization_output
    output.name = ACADEMY
    output.communication_version = API_VERSION
    output.package_version = package_version
    output.capabilities.baseRLCapabilities = True
    output.capabilities.concatenatedPngObservations = True
    output.capabilities.compressedChannelMapping = True
    output.capabilities.hybridActions = True
    output.capabilities.trainingAnalytics = True
    output.capabilities.variableLengthObservation = True
    output.capabilities.multiAgentGroups = True
    return _bytes(message)


def acknowledgement() -> bytes:
    """An empty message with status 200; the reply to it is the first command."""
    message = UnityMessageProto()
    message.header.status = OK
    return _bytes(message)


def farewell() -> bytes:
    """Tells the trainer that the player stops by itself."""
    message = UnityMessageProto()
    message.header.status = STOP
    return _bytes(message)


def output(
    behavior: Behavior,
    agents: Agents,
    side_channel: bytes,
    introduce: bool,
    camera: Camera | None = None,
    hybrid_actions: bool = True,
) -> bytes:
    """A batch of agents.

    Args:
        behavior: Theirs.
        agents: In the order in which they are to be read.
        side_channel: Bytes for the trainer's side channels.
        introduce: Whether the behavior's parameters come along, as they do the first time that it has agents.
        camera: How the agents' pictures travel, if they have any.
        hybrid_actions: Whether the trainer knows hybrid actions. One that does not reads the deprecated fields instead
            of the behavior's action spec.
    """
    if not introduce and agents.images is None:
        shapes = tuple(each.shape[1:] for each in agents.observations)
        rows = _agent_rows(behavior.sensors, shapes, behavior.discrete_branches)
        return columnar.write_output(behavior.name, rows, agents, side_channel)
    message = UnityMessageProto()
    message.header.status = OK
    rl_output = message.unity_output.rl_output
    rl_output.agentInfos[behavior.name].value.extend(_agent_infos(behavior, agents, camera))
    rl_output.side_channel = side_channel
    if introduce:
        brain = message.unity_output.rl_initialization_output.brain_parameters.add()
        brain.brain_name = behavior.name
        brain.is_training = True
        brain.action_spec.num_continuous_actions = behavior.continuous_actions
        brain.action_spec.num_discrete_actions = len(behavior.discrete_branches)
        brain.action_spec.discrete_branch_sizes.extend(behavior.discrete_branches)
        if not hybrid_actions:
            brain.vector_action_size_deprecated.append(behavior.continuous_actions)
            brain.vector_action_space_type_deprecated = CONTINUOUS
    return _bytes(message)


def parameters(data: bytes) -> Any | None:
    """What the trainer answers to ``hello``, UnityRLInitializationInputProto; None if it ends the session instead.

    Raises:
        WireError: The bytes are no message.
    """
    message = _parse(data)
    return None if _ends(message) else message.unity_input.rl_initialization_input


def command(data: bytes, behavior: Behavior, count: int | None) -> Command:
    """Reads a trainer's reply.

    Args:
        data: Its bytes.
        behavior: Of the agents.
        count: Number of agents that asked for a decision; None before there are any, when no actions are read.

    Raises:
        WireError: No message, an unknown command, or actions that can't be used: another number or size than asked
            for, NaN or Inf, a choice that there is not.
    """
    size, branches = behavior.continuous_actions, behavior.discrete_branches
    plain = None if count is None else columnar.read_step(data, behavior.name, size, branches)
    if plain is not None and count is not None:
        return Command(STEP, plain[1], *_checked(plain[0], behavior, count))
    message = _parse(data)
    if _ends(message):
        return Command(QUIT)
    rl_input = message.unity_input.rl_input
    if rl_input.command == RESET:
        return Command(RESET, rl_input.side_channel)
    if rl_input.command != STEP:
        raise WireError(f"The trainer sent command {rl_input.command}; STEP, RESET or QUIT was expected.")
    if count is None:
        return Command(STEP, rl_input.side_channel)
    received = rl_input.agent_actions[behavior.name].value if behavior.name in rl_input.agent_actions else ()
    # Trainers from before version 1.3 of the protocol fill the deprecated field only.
    both = [_halves(action, behavior) for action in received]
    for row, (numbers, choices) in enumerate(both):
        if len(numbers) != size:
            raise WireError(f"Action {row} has {len(numbers)} continuous values, but {size} were expected.")
        if len(choices) != len(branches):
            raise WireError(f"Action {row} has {len(choices)} discrete choices, but {len(branches)} were expected.")
    continuous = np.array([numbers for numbers, _ in both], np.float32).reshape(len(both), size)
    discrete = np.array([choices for _, choices in both], np.int32).reshape(len(both), len(branches))
    batch = columnar.ActionBatch(continuous, discrete)
    return Command(STEP, rl_input.side_channel, *_checked(batch, behavior, count))


def _halves(action: Any, behavior: Behavior) -> tuple[Any, Any]:
    """An AgentActionProto's continuous and discrete part."""
    old, size = action.vector_actions_deprecated, behavior.continuous_actions
    if not behavior.discrete_branches:
        return action.continuous_actions or old, ()
    return action.continuous_actions or old[:size], action.discrete_actions or [int(each) for each in old[size:]]


def _checked(batch: columnar.ActionBatch, behavior: Behavior, count: int) -> columnar.ActionBatch:
    actions, discrete = batch
    if len(actions) != count:
        raise WireError(
            f"The trainer sent {len(actions)} actions for behavior {behavior.name}, but {count} agents asked for one."
        )
    finite = np.isfinite(actions).all(axis=1)
    if not finite.all():
        row = int(np.flatnonzero(~finite)[0])
        raise WireError(
            f"Action {row} is {actions[row].tolist()}, but finite numbers in [-1, 1] were expected; "
            "look for a diverged policy."
        )
    if behavior.discrete_branches:
        unknown = np.argwhere((discrete < 0) | (discrete >= behavior.discrete_branches))
        if len(unknown):
            row, branch = unknown[0].tolist()
            raise WireError(
                f"Action {row} chooses {discrete[row, branch]} in branch {branch}, but 0 to "
                f"{behavior.discrete_branches[branch] - 1} were expected."
            )
    return batch


def _parse(data: bytes) -> Any:
    try:
        message = UnityMessageProto.FromString(data)
    except DecodeError as error:
        raise WireError(
            f"The trainer sent {len(data)} bytes that are not a protocol message; is it an ML-Agents trainer?"
        ) from error
    mistyped = mistyped_field(message)
    if mistyped is not None:
        raise WireError(f"The trainer sent {mistyped} as another type than the protocol's.")
    return message


def _ends(message: Any) -> bool:
    return bool(message.header.status != OK or message.unity_input.rl_input.command == QUIT)


def _bytes(message: Any) -> bytes:
    data: bytes = message.SerializeToString()
    return data


def _agent_infos(behavior: Behavior, agents: Agents, camera: Camera | None) -> list[Any]:
    infos = []
    columns = (agents.ids, agents.rewards, agents.done, agents.interrupted, agents.group_ids, agents.group_rewards)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (agent_id, reward, done, interrupted, group, group_reward) in enumerate(rows):
        info = AgentInfoProto(id=agent_id, reward=reward, done=done, max_step_reached=interrupted)
        info.group_id, info.group_reward = group, group_reward
        for mask in agents.masks:
            info.action_mask.extend(mask[row].tolist())
        if agents.images is not None:  # sensors go by name, and C stands before V
            _add_picture(info, agents.images[row], camera or Camera())
        for name, values in zip(behavior.sensors, agents.observations, strict=True):
            shape = values.shape[1:]
            observation = info.observations.add(name=name, shape=shape, dimension_properties=_properties(shape))
            observation.float_data.data.extend(values[row].ravel().tolist())
        infos.append(info)
    return infos


def _properties(shape: tuple[int, ...]) -> tuple[int, ...]:
    return (NO_PROPERTY,) if len(shape) == 1 else (VARIABLE_SIZE, NO_PROPERTY)


@cache
def _agent_rows(names: tuple[str, ...], shapes: tuple[tuple[int, ...], ...], branches: tuple[int, ...]) -> AgentRows:
    sensors = (Sensor(name, shape, _properties(shape)) for name, shape in zip(names, shapes, strict=True))
    return AgentRows(tuple(sensors), branches)


def _add_picture(info: Any, image: NDArray[np.uint8], camera: Camera) -> None:
    channel, side = NO_PROPERTY, TRANSLATIONAL_EQUIVARIANCE
    ordered = image.transpose(2, 0, 1) if camera.channels_first else image
    properties = [channel, side, side] if camera.channels_first else [side, side, channel]
    observation = info.observations.add(
        name="CameraSensor", shape=ordered.shape, dimension_properties=properties, compressed_channel_mapping=[0, 1, 2]
    )
    if camera.compressed:
        observation.compression_type = PNG
        observation.compressed_data = png(image)
    else:
        observation.float_data.data.extend((ordered.astype(np.float32) / np.float32(255)).ravel().tolist())


def png(image: NDArray[np.uint8]) -> bytes:
    """An RGB picture, (height, width, 3), as a PNG file: without Pillow, which the player does without."""
    height, width, _ = image.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), image.reshape(height, -1)], axis=1)  # filter 0: none

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits, RGB
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(lines.tobytes()))
        + chunk(b"IEND", b"")
    )
