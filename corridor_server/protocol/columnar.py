"""Agent batches and action lists as columns: bytes to arrays and back in a handful of NumPy operations per message.

The bytes are those that protobuf itself writes. Whatever does not look so, from whichever peer, is left to the protobuf
parser: every reader here then returns None.
"""

from collections.abc import Iterable, Mapping
from functools import cache

import numpy as np

from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from corridor_server.protocol.messages import AgentActionProto
from corridor_server.protocol.row_template import Column, Parts, RowTemplate, repeated
from corridor_server.protocol.wire_bytes import HEADER_OK, MessageWalker, length_delimited, varint

# Field numbers, from a message down to its rows: player to trainer, and trainer to player.
_UNITY_OUTPUT, _RL_OUTPUT, _AGENT_INFOS, _OUTPUT_SIDE_CHANNEL = 2, 1, 2, 3
_UNITY_INPUT, _RL_INPUT, _AGENT_ACTIONS, _INPUT_SIDE_CHANNEL = 3, 1, 1, 5
_KEY, _VALUE = 1, 2  # of a map's entry
# AgentActionProto's fields.
_DEPRECATED, _CONTINUOUS, _DISCRETE = 1, 6, 7
_ONE_BYTE = 0x7F  # the largest choice whose varint is one byte: with more, rows differ in length


def write_output(parts: Iterable[tuple[str, AgentRows, Agents]], side_channel: bytes) -> bytes:
    """A player's message with observations that are numbers.

    Args:
        parts: Each behavior's full name, how its agents' rows look, and its agents in the order in which they are to be
            read.
        side_channel: Bytes beside them.
    """
    rl_output = b"".join(
        length_delimited(
            _AGENT_INFOS, length_delimited(_KEY, name.encode()) + length_delimited(_VALUE, rows.write(agents))
        )
        for name, rows, agents in parts
    )
    if side_channel:
        rl_output += length_delimited(_OUTPUT_SIDE_CHANNEL, side_channel)
    return HEADER_OK + length_delimited(_UNITY_OUTPUT, length_delimited(_RL_OUTPUT, rl_output))


def read_output(data: bytes, behaviors: Mapping[str, AgentRows]) -> tuple[dict[str, Agents], bytes] | None:
    """The agents of every behavior that the message has, and its side-channel bytes.

    Args:
        data: The message.
        behaviors: Those that there are, by their full names.

    Returns:
        None for a message that is to be left to the parser: one of another form, with another behavior, or with one
        behavior twice.
    """
    walker = MessageWalker(data)
    walker.expect(HEADER_OK)
    walker.enter_last(_UNITY_OUTPUT)
    walker.enter_last(_RL_OUTPUT)
    found: dict[str, Agents] = {}
    while walker.at(_AGENT_INFOS):
        name, start, end = _enter_entry(walker, _AGENT_INFOS)
        rows = behaviors.get(name)
        if walker.failed or rows is None or name in found:
            return None
        agents = rows.read(data, start, end)
        if agents is None:
            return None
        found[name] = agents
    beside = walker.take(_OUTPUT_SIDE_CHANNEL) if walker.at(_OUTPUT_SIDE_CHANNEL) else b""
    return None if walker.failed or walker.offset != len(data) else (found, beside)


def _enter_entry(walker: MessageWalker, number: int) -> tuple[str, int, int]:
    """Passes over a map's entry; returns its key, and where its value starts and ends."""
    entry_end = walker.enter(number)
    key = walker.take(_KEY)
    end = walker.enter(_VALUE)
    start, walker.offset = walker.offset, end
    walker.failed |= end != entry_end
    try:
        return key.decode(), start, end
    except UnicodeDecodeError:
        walker.failed = True
        return "", start, end


def write_step(actions: Mapping[str, ActionBatch], side_channel: bytes) -> bytes:
    """A trainer's STEP, with the new fields and the deprecated one, as ``mlagents_envs`` writes it.

    Args:
        actions: Of each behavior, by its full name, in the order in which its agents asked; none for one whose agents
            didn't.
        side_channel: Bytes beside them.
    """
    rl_input = b""
    for behavior, batch in actions.items():
        entry = length_delimited(_KEY, behavior.encode()) + length_delimited(_VALUE, _action_rows(batch))
        rl_input += length_delimited(_AGENT_ACTIONS, entry)
    if side_channel:
        rl_input += length_delimited(_INPUT_SIDE_CHANNEL, side_channel)
    return HEADER_OK + length_delimited(_UNITY_INPUT, length_delimited(_RL_INPUT, rl_input))


def _action_rows(batch: ActionBatch) -> bytes:
    continuous, discrete = batch
    size, branches = continuous.shape[1], discrete.shape[1]
    one_byte_each = not discrete.size or 0 <= discrete.min() <= discrete.max() <= _ONE_BYTE
    if size + branches == 0 or not one_byte_each:
        return b"".join(_action_row(*row) for row in zip(continuous.tolist(), discrete.tolist(), strict=True))
    template = _action_template(size, branches, deprecated=True)
    rows = template.blank(len(continuous))
    rows["deprecated"][:, :size] = continuous
    rows["deprecated"][:, size:] = discrete
    if size:
        rows["continuous"] = continuous
    if branches:
        rows["discrete"] = discrete
    return rows.tobytes()


def _action_row(numbers: list[float], choices: list[int]) -> bytes:
    action = AgentActionProto(
        vector_actions_deprecated=[*numbers, *choices], continuous_actions=numbers, discrete_actions=choices
    )
    return length_delimited(1, action.SerializeToString())


def read_step(data: bytes, behaviors: Mapping[str, Behavior]) -> tuple[dict[str, ActionBatch], bytes] | None:
    """The actions and side-channel bytes of a STEP, as ``mlagents_envs`` or ``write_step`` writes it.

    Args:
        data: The message.
        behaviors: Those that there are, by their full names.

    Returns:
        None for any other message, and for one without actions, with another behavior, or with one twice.
    """
    walker = MessageWalker(data)
    walker.expect(HEADER_OK)
    walker.enter_last(_UNITY_INPUT)
    walker.enter_last(_RL_INPUT)
    found: dict[str, ActionBatch] = {}
    while walker.at(_AGENT_ACTIONS):
        name, start, end = _enter_entry(walker, _AGENT_ACTIONS)
        behavior = behaviors.get(name)
        if walker.failed or behavior is None or name in found:
            return None
        batch = _read_actions(data, start, end, behavior)
        if batch is None:
            return None
        found[name] = batch
    beside = walker.take(_INPUT_SIDE_CHANNEL) if walker.at(_INPUT_SIDE_CHANNEL) else b""
    return None if walker.failed or walker.offset != len(data) or not found else (found, beside)


def _read_actions(data: bytes, start: int, end: int, behavior: Behavior) -> ActionBatch | None:
    size, branches = behavior.continuous_actions, len(behavior.discrete_branches)
    for deprecated in (True, False):
        rows = _action_template(size, branches, deprecated).all(data, start, end)
        if rows is not None:
            continuous = rows["continuous"].copy() if size else np.empty((len(rows), 0), np.float32)
            discrete = rows["discrete"].astype(np.int32) if branches else np.empty((len(rows), 0), np.int32)
            one_byte_each = not discrete.size or discrete.max() <= _ONE_BYTE
            return ActionBatch(continuous, discrete) if one_byte_each else None
    return None


@cache
def _action_template(size: int, branches: int, deprecated: bool) -> RowTemplate:
    def packed(number: int, column: Column, count: int, width: int) -> Parts:
        return [varint(number << 3 | 2) + varint(count * width), column] if count else []

    both = size + branches if deprecated else 0
    parts = packed(_DEPRECATED, Column("deprecated", "<f4", (both,)), both, 4)
    parts += packed(_CONTINUOUS, Column("continuous", "<f4", (size,)), size, 4)
    parts += packed(_DISCRETE, Column("discrete", "u1", (branches,)), branches, 1)
    return repeated(parts)
