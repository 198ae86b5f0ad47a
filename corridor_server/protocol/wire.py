"""The codec: agent batches to a message's bytes, a trainer's bytes to a command. It knows no rewards and no sockets.

Batches of vector observations and plain STEP messages go by ``columnar``; everything else goes by the protobuf parser.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from corridor_server.protocol import columnar
from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
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
from corridor_server.protocol.visual_observations import PictureForm, channel_mapping, png_files

DISCRETE, CONTINUOUS = 0, 1  # SpaceTypeProto


@dataclass(frozen=True)
class Command:
    """A trainer's reply, once the session has begun.

    Attributes:
        number: STEP, RESET or QUIT; QUIT also for a status other than 200.
        side_channel: Bytes for the side channels, to be applied first.
        actions: Of a STEP, for each behavior's agents that asked, as received: clipping is the simulation's. None for
            another command, and before anybody asked.
    """

    number: int
    side_channel: bytes = b""
    actions: Mapping[str, ActionBatch] | None = None


class WireError(ValueError):
    """A message from the trainer that can't be used, or agents that can't be sent."""


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
    parts: Sequence[tuple[Behavior, Agents]],
    side_channel: bytes,
    introduced: Collection[str],
    form: PictureForm | None = None,
    hybrid_actions: bool = True,
) -> bytes:
    """What the agents of every behavior that has some ask or end with.

    Args:
        parts: The behaviors and their agents, in the order in which they are to be read.
        side_channel: Bytes for the trainer's side channels.
        introduced: Names of behaviors whose parameters came along before, as they do the first time that one has
            agents.
        form: How pictures travel.
        hybrid_actions: Whether the trainer knows hybrid actions. One that does not reads the deprecated fields instead
            of a behavior's action spec.

    Raises:
        WireError: There are not as many of everything as agents, or an observation has not its sensor's shape.
    """
    form = form or PictureForm()
    for behavior, agents in parts:
        _check_sizes(behavior, agents)
    new = [behavior for behavior, _ in parts if behavior.name not in introduced]
    if not new and not any(form.compresses(each) for _, agents in parts for each in agents.observations):
        return columnar.write_output(
            [(behavior.name, _agent_rows(behavior, form), _with_floats(agents, form)) for behavior, agents in parts],
            side_channel,
        )
    message = UnityMessageProto()
    message.header.status = OK
    rl_output = message.unity_output.rl_output
    for behavior, agents in parts:
        rl_output.agentInfos[behavior.name].value.extend(_agent_infos(behavior, agents, form))
    rl_output.side_channel = side_channel
    for behavior in new:
        brain = message.unity_output.rl_initialization_output.brain_parameters.add()
        brain.brain_name = behavior.name
        brain.is_training = True
        brain.action_spec.num_continuous_actions = behavior.continuous_actions
        brain.action_spec.num_discrete_actions = len(behavior.discrete_branches)
        brain.action_spec.discrete_branch_sizes.extend(behavior.discrete_branches)
        if not hybrid_actions:  # one kind, the continuous ones where there are both
            continuous = behavior.continuous_actions
            brain.vector_action_size_deprecated.extend([continuous] if continuous else behavior.discrete_branches)
            brain.vector_action_space_type_deprecated = CONTINUOUS if continuous else DISCRETE
    return _bytes(message)


def parameters(data: bytes) -> Any | None:
    """What the trainer answers to ``hello``, UnityRLInitializationInputProto; None if it ends the session instead.

    Raises:
        WireError: The bytes are no message.
    """
    message = _parse(data)
    return None if _ends(message) else message.unity_input.rl_initialization_input


def command(data: bytes, behaviors: Mapping[str, Behavior], asked: Mapping[str, int] | None) -> Command:
    """Reads a trainer's reply.

    Args:
        data: Its bytes.
        behaviors: Of the agents, by their full names.
        asked: How many agents of each behavior asked for a decision; None before there are any, when no actions are
            read.

    Raises:
        WireError: No message, an unknown command, or actions that can't be used: another number or size than asked
            for, NaN or Inf, a choice that there is not.
    """
    plain = None if asked is None else columnar.read_step(data, behaviors)
    if plain is not None and asked is not None:
        return Command(STEP, plain[1], _checked(plain[0], behaviors, asked))
    message = _parse(data)
    if _ends(message):
        return Command(QUIT)
    rl_input = message.unity_input.rl_input
    if rl_input.command == RESET:
        return Command(RESET, rl_input.side_channel)
    if rl_input.command != STEP:
        raise WireError(f"The trainer sent command {rl_input.command}; STEP, RESET or QUIT was expected.")
    if asked is None:
        return Command(STEP, rl_input.side_channel)
    actions = {
        name: _batch(rl_input.agent_actions[name].value, behavior)
        for name, behavior in behaviors.items()
        if name in rl_input.agent_actions
    }
    return Command(STEP, rl_input.side_channel, _checked(actions, behaviors, asked))


def _batch(received: Sequence[Any], behavior: Behavior) -> ActionBatch:
    """AgentActionProtos as arrays; trainers from before version 1.3 of the protocol fill the deprecated field only."""
    size, branches = behavior.continuous_actions, behavior.discrete_branches
    both = [_halves(action, behavior) for action in received]
    for row, (numbers, choices) in enumerate(both):
        if len(numbers) != size:
            raise WireError(f"Action {row} has {len(numbers)} continuous values, but {size} were expected.")
        if len(choices) != len(branches):
            raise WireError(f"Action {row} has {len(choices)} discrete choices, but {len(branches)} were expected.")
        for branch, (choice, count) in enumerate(zip(choices, branches, strict=True)):
            if not 0 <= choice < count or choice != int(choice):  # the deprecated ones are floats
                raise _unknown_choice(row, choice, branch, count)
    continuous = np.array([numbers for numbers, _ in both], np.float32).reshape(len(both), size)
    discrete = np.array([choices for _, choices in both], np.int32).reshape(len(both), len(branches))
    return ActionBatch(continuous, discrete)


def _halves(action: Any, behavior: Behavior) -> tuple[Any, Any]:
    """An AgentActionProto's continuous and discrete part."""
    old, size = action.vector_actions_deprecated, behavior.continuous_actions
    if not behavior.discrete_branches:
        return action.continuous_actions or old, ()
    return action.continuous_actions or old[:size], action.discrete_actions or old[size:]


def _checked(
    actions: Mapping[str, ActionBatch], behaviors: Mapping[str, Behavior], asked: Mapping[str, int]
) -> Mapping[str, ActionBatch]:
    for name, behavior in behaviors.items():
        count, batch = asked.get(name, 0), actions.get(name)
        received = 0 if batch is None else len(batch.continuous)
        if received != count:
            raise WireError(
                f"The trainer sent {received} actions for behavior {name}, but {count} agents asked for one."
            )
        if batch is not None:
            _check_values(batch, behavior)
    return actions


def _check_values(batch: ActionBatch, behavior: Behavior) -> None:
    finite = np.isfinite(batch.continuous)
    if np.count_nonzero(finite) < finite.size:
        row = int(np.argwhere(~finite)[0, 0])
        raise WireError(
            f"Action {row} is {batch.continuous[row].tolist()}, but finite numbers in [-1, 1] were expected; "
            "look for a diverged policy."
        )
    if behavior.discrete_branches:
        unknown = (batch.discrete < 0) | (batch.discrete >= behavior.discrete_branches)
        if np.count_nonzero(unknown):
            row, branch = np.argwhere(unknown)[0].tolist()
            raise _unknown_choice(row, batch.discrete[row, branch], branch, behavior.discrete_branches[branch])


def _unknown_choice(row: int, choice: float, branch: int, count: int) -> WireError:
    return WireError(f"Action {row} chooses {choice:g} in branch {branch}, but 0 to {count - 1} were expected.")


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


def _check_sizes(behavior: Behavior, agents: Agents) -> None:
    """Refuses what a simulation can have wrong: as many rows of everything as ids, observations as the sensors say."""
    count = len(agents)
    for name in ("rewards", "done", "interrupted", "group_ids", "group_rewards"):
        if len(getattr(agents, name)) != count:
            raise WireError(f"{len(getattr(agents, name))} {name} came for {count} agents of {behavior.name}.")
    if len(agents.observations) != len(behavior.sensors):
        raise WireError(
            f"{len(agents.observations)} observations came for agents of {behavior.name}, which has "
            f"{len(behavior.sensors)} sensors."
        )
    for sensor, values in zip(behavior.sensors, agents.observations, strict=True):
        if values.shape != (count, *sensor.shape):
            raise WireError(
                f"An observation {sensor.name} of shape {values.shape} came for agents of {behavior.name}, but "
                f"{(count, *sensor.shape)} was expected."
            )


def _agent_infos(behavior: Behavior, agents: Agents, form: PictureForm) -> list[Any]:
    infos = []
    columns = (agents.ids, agents.rewards, agents.done, agents.interrupted, agents.group_ids, agents.group_rewards)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    sensors = [form.sensor(sensor) for sensor in behavior.sensors]
    observations = [each if form.compresses(each) else form.floats(each) for each in agents.observations]
    for row, (agent_id, reward, done, interrupted, group, group_reward) in enumerate(rows):
        info = AgentInfoProto(id=agent_id, reward=reward, done=done, max_step_reached=interrupted)
        info.group_id, info.group_reward = group, group_reward
        for mask in agents.masks:
            info.action_mask.extend(mask[row].tolist())
        for sensor, values in zip(sensors, observations, strict=True):
            observation = info.observations.add(
                name=sensor.name,
                shape=sensor.shape,
                dimension_properties=sensor.dimension_properties,
                observation_type=sensor.kind,
            )
            if values.dtype == np.uint8:
                observation.compression_type = PNG
                observation.compressed_data = png_files(values[row])
                observation.compressed_channel_mapping.extend(channel_mapping(values.shape[-1]))
            else:
                observation.float_data.data.extend(values[row].ravel().tolist())
        infos.append(info)
    return infos


@cache
def _agent_rows(behavior: Behavior, form: PictureForm) -> AgentRows:
    return AgentRows(tuple(form.sensor(sensor) for sensor in behavior.sensors), behavior.discrete_branches)


def _with_floats(agents: Agents, form: PictureForm) -> Agents:
    if all(values.ndim < 4 for values in agents.observations):
        return agents
    return replace(agents, observations=tuple(form.floats(values) for values in agents.observations))
