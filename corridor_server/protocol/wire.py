"""The codec: agent batches to a message's bytes, a trainer's bytes to a command. It knows no rewards and no sockets.

Batches of vector observations and plain STEP messages go by ``columnar``; everything else goes by the protobuf parser.
"""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from corridor_server.protocol import columnar
from corridor_server.protocol.agents import Agents, Behavior
from corridor_server.protocol.messages import (
    ACADEMY,
    API_VERSION,
    OK,
    QUIT,
    RESET,
    STEP,
    STOP,
    AgentInfoProto,
    UnityMessageProto,
)

CONTINUOUS = 1  # SpaceTypeProto
# DimensionProperty: neither translation-equivariant nor of variable size; translation-equivariant, as pictures are.
NO_PROPERTY, TRANSLATIONAL_EQUIVARIANCE = 1, 2
PNG = 1  # CompressionTypeProto


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
    """

    number: int
    side_channel: bytes = b""
    actions: NDArray[np.float32] | None = None


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
        return columnar.write_output(behavior.name, behavior.sensors[0], agents, side_channel)
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
            for, NaN or Inf.
    """
    size = behavior.continuous_actions
    plain = None if count is None else columnar.read_step(data, behavior.name, size)
    if plain is not None and count is not None:
        return Command(STEP, plain[1], _checked(plain[0], behavior, count))
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
    rows = [action.continuous_actions or action.vector_actions_deprecated for action in received]
    for row in rows:
        if len(row) != size:
            raise WireError(f"An action has {len(row)} continuous values, but {size} were expected.")
    actions = np.array(rows, dtype=np.float32).reshape(len(rows), size)
    return Command(STEP, rl_input.side_channel, _checked(actions, behavior, count))


def _checked(actions: NDArray[np.float32], behavior: Behavior, count: int) -> NDArray[np.float32]:
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
    return actions


def _parse(data: bytes) -> Any:
    try:
        return UnityMessageProto.FromString(data)
    except DecodeError as error:
        raise WireError(
            f"The trainer sent {len(data)} bytes that are not a protocol message; is it an ML-Agents trainer?"
        ) from error


def _ends(message: Any) -> bool:
    return bool(message.header.status != OK or message.unity_input.rl_input.command == QUIT)


def _bytes(message: Any) -> bytes:
    data: bytes = message.SerializeToString()
    return data


def _agent_infos(behavior: Behavior, agents: Agents, camera: Camera | None) -> list[Any]:
    infos = []
    size = agents.observations[0].shape[1]
    columns = (agents.ids, agents.rewards, agents.done, agents.interrupted, agents.observations[0])
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for row, (agent_id, reward, done, interrupted, floats) in enumerate(rows):
        info = AgentInfoProto(id=agent_id, reward=reward, done=done, max_step_reached=interrupted)
        if agents.images is not None:  # sensors go by name, and C stands before V
            _add_picture(info, agents.images[row], camera or Camera())
        observation = info.observations.add(name=behavior.sensors[0], shape=[size], dimension_properties=[NO_PROPERTY])
        observation.float_data.data.extend(floats)
        infos.append(info)
    return infos


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
