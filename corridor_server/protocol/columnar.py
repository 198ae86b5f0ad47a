"""Agent batches and action lists as columns: bytes to arrays and back in a handful of NumPy operations per message.

The bytes are those that protobuf itself writes. Whatever does not look so, from whichever peer, is left to the protobuf
parser: every reader here then returns None.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents
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


class ActionBatch(NamedTuple):
    """What agents of one behavior shall do, a row each.

    Attributes:
        continuous: (n, size) float32.
        discrete: The choice in each branch, (n, branches) int32.
    """

    continuous: NDArray[np.float32]
    discrete: NDArray[np.int32]


def write_output(behavior: str, rows: AgentRows, agents: Agents, side_channel: bytes) -> bytes:
    """A player's message with vector observations.

    Args:
        behavior: The behavior's full name.
        rows: Of its agents.
        agents: In the order in which they are to be read; pictures of theirs don't travel this way.
        side_channel: Bytes beside them.
    """
    entry = length_delimited(_KEY, behavior.encode()) + length_delimited(_VALUE, rows.write(agents))
    rl_output = length_delimited(_AGENT_INFOS, entry)
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


def read_step(data: bytes, behavior: str, size: int, branches: Sequence[int] = ()) -> tuple[ActionBatch, bytes] | None:
    """The actions and side-channel bytes of a STEP for one behavior, as ``mlagents_envs`` or ``write_step`` writes it.

    Args:
        data: The message.
        behavior: The behavior's full name.
        size: How many continuous numbers an action has.
        branches: How many choices each of its discrete branches has.

    Returns:
        None for any other message.
    """
    walker = MessageWalker(data)
    walker.expect(HEADER_OK)
    walker.enter_last(_UNITY_INPUT)
    walker.enter_last(_RL_INPUT)
    name, start, end = _enter_entry(walker, _AGENT_ACTIONS)
    beside = walker.take(_INPUT_SIDE_CHANNEL) if walker.at(_INPUT_SIDE_CHANNEL) else b""
    if walker.failed or walker.offset != len(data) or name != behavior:
        return None
    for deprecated in (True, False):
        rows = _action_template(size, len(branches), deprecated).all(data, start, end)
        if rows is not None:
            continuous = rows["continuous"].copy() if size else np.empty((len(rows), 0), np.float32)
            discrete = rows["discrete"].astype(np.int32) if branches else np.empty((len(rows), 0), np.int32)
            one_byte_each = not discrete.size or discrete.max() <= _ONE_BYTE
            return (ActionBatch(continuous, discrete), beside) if one_byte_each else None
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
