"""The codec: agent batches to protocol messages, action messages to arrays. It knows nothing of rewards or sockets."""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.areas import Agents, Batch
from corridor_server.messages import API_VERSION, AgentInfoProto, UnityMessageProto
from corridor_server.world import ACTION_SIZE

BEHAVIOR = "Corridor?team=0"
OK, STOP = 200, 400
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


class WireError(ValueError):
    """A message from the trainer that can't be used."""


def hello(package_version: str) -> Any:
    """The player's first message (RL_INITIALIZATION_OUTPUT)."""
    message = UnityMessageProto()
    message.header.status = OK
    output = message.unity_output.rl_initialization_output
    output.name = "Corridor"
    output.communication_version = API_VERSION
    output.package_version = package_version
    output.capabilities.baseRLCapabilities = True
    output.capabilities.concatenatedPngObservations = True
    output.capabilities.compressedChannelMapping = True
    output.capabilities.hybridActions = True
    output.capabilities.trainingAnalytics = True
    output.capabilities.multiAgentGroups = True
    return message


def acknowledgement() -> Any:
    """An empty message with status 200; the reply to it is the first command."""
    message = UnityMessageProto()
    message.header.status = OK
    return message


def farewell() -> Any:
    """Tells the trainer that the player stops by itself."""
    message = UnityMessageProto()
    message.header.status = STOP
    return message


def output(batch: Batch, side_channel: bytes, introduce: bool, camera: Camera | None = None) -> Any:
    """A batch of agents, ended ones first.

    Args:
        batch: Agents.
        side_channel: Bytes for the trainer's side channels.
        introduce: Whether the behavior's parameters come along, as they do the first time that it has agents.
        camera: How the batch's pictures travel, if it has any.
    """
    message = UnityMessageProto()
    message.header.status = OK
    rl_output = message.unity_output.rl_output
    infos = rl_output.agentInfos[BEHAVIOR].value
    infos.extend(_agent_infos(batch.ended, camera))
    for info, interrupted in zip(infos, batch.interrupted.tolist(), strict=True):
        info.done = True
        info.max_step_reached = interrupted
    infos.extend(_agent_infos(batch.deciding, camera))
    rl_output.side_channel = side_channel
    if introduce:
        brain = message.unity_output.rl_initialization_output.brain_parameters.add()
        brain.brain_name = BEHAVIOR
        brain.is_training = True
        brain.action_spec.num_continuous_actions = ACTION_SIZE
        brain.vector_action_size_deprecated.append(ACTION_SIZE)
        brain.vector_action_space_type_deprecated = CONTINUOUS
    return message


def actions(rl_input: Any, count: int) -> NDArray[np.float32]:
    """The actions for the agents that asked for a decision, in the order in which they were sent.

    Args:
        rl_input: UnityRLInputProto; older trainers fill ``vector_actions_deprecated`` only.
        count: Number of agents that asked.

    Returns:
        (count, 2) float32, as received: clipping to [-1, 1] is the world's.

    Raises:
        WireError: Another number of actions or action size than asked for, or NaN or Inf among them.
    """
    received = rl_input.agent_actions[BEHAVIOR].value if BEHAVIOR in rl_input.agent_actions else ()
    if len(received) != count:
        raise WireError(
            f"The trainer sent {len(received)} actions for behavior {BEHAVIOR}, but {count} agents asked for one."
        )
    rows = [action.continuous_actions or action.vector_actions_deprecated for action in received]
    for row in rows:
        if len(row) != ACTION_SIZE:
            raise WireError(f"An action has {len(row)} continuous values, but {ACTION_SIZE} were expected.")
    result = np.array(rows, dtype=np.float32).reshape(count, ACTION_SIZE)
    finite = np.isfinite(result).all(axis=1)
    if not finite.all():
        row_number = int(np.flatnonzero(~finite)[0])
        raise WireError(
            f"Action {row_number} is {result[row_number].tolist()}, but finite numbers in [-1, 1] were expected; "
            "look for a diverged policy."
        )
    return result


def _agent_infos(agents: Agents, camera: Camera | None) -> list[Any]:
    infos = []
    size = agents.observations.shape[1]
    rows = zip(agents.ids.tolist(), agents.rewards.tolist(), agents.observations.tolist(), strict=True)
    for row, (agent_id, reward, floats) in enumerate(rows):
        info = AgentInfoProto(id=agent_id, reward=reward)
        if agents.images is not None:  # sensors go by name, and C stands before V
            _add_picture(info, agents.images[row], camera or Camera())
        observation = info.observations.add(
            name=f"VectorSensor_size{size}", shape=[size], dimension_properties=[NO_PROPERTY]
        )
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
