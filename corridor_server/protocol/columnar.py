"""Agent batches and action lists as columns: bytes to arrays and back in a handful of NumPy operations per message.

A message's repeated part is a run of rows of one length, so it can be seen as a structured array. The rows' constant
bytes come from protobuf itself, which serialises one example; reading is an equality test of those bytes. Whatever does
not look exactly so, from whichever peer, is left to the protobuf parser: every reader here then returns None.

Ids are written as varints of five bytes, which all protobuf parsers read, so that every row has the same length.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents
from corridor_server.protocol.messages import AgentActionProto, AgentInfoProto

LARGEST_ID = 2**31 - 1
HEADER_OK = b"\x0a\x03\x08\xc8\x01"  # UnityMessageProto.header { status: 200 }
# Tags of length-delimited fields, (number << 3) | 2.
FIELD_1, FIELD_2, FIELD_3, FIELD_5 = b"\x0a", b"\x12", b"\x1a", b"\x2a"
# An id's five groups of seven bits, lowest first: all but the last are marked as continued, the last has three bits.
_SHIFTS = np.array([0, 7, 14, 21, 28], np.int32)
_CONTINUED = np.array([0x80, 0x80, 0x80, 0x80, 0], np.uint8)
_GROUP_LIMITS = np.array([0x7F, 0x7F, 0x7F, 0x7F, 7], np.uint8)
# An example's values, found again in its bytes: where each column lies.
_REWARD = np.float32(1.2345e-33).tobytes()


class _Rows:
    """Rows of one length in a repeated field 1, of which some columns vary."""

    def __init__(self, example: bytes, columns: dict[str, tuple[str, int]]) -> None:
        row = FIELD_1 + varint(len(example)) + example
        shift = len(row) - len(example)
        names = list(columns)
        self.dtype = np.dtype(
            {
                "names": names,
                "formats": [columns[name][0] for name in names],
                "offsets": [columns[name][1] + shift for name in names],
                "itemsize": len(row),
            }
        )
        self.template = np.frombuffer(row, np.uint8)
        varying = np.zeros(1, self.dtype)
        for name in names:
            varying[name].view(np.uint8)[...] = 255
        self.constant = np.flatnonzero(varying.view(np.uint8) == 0)
        self._expected = self.template[self.constant]

    def empty(self, count: int) -> NDArray[np.void]:
        """Rows to fill in."""
        raw = np.empty((count, len(self.template)), np.uint8)
        raw[:] = self.template
        return raw.reshape(-1).view(self.dtype)

    def read(self, data: bytes, start: int, end: int) -> NDArray[np.void] | None:
        """The rows from start to end, if that is what they are."""
        count, rest = divmod(end - start, len(self.template))
        if rest:
            return None
        rows = np.frombuffer(data, self.dtype, count, start)
        raw = rows.view(np.uint8).reshape(count, len(self.template))
        return rows if (raw[:, self.constant] == self._expected).all() else None


@cache
def _agent_rows(size: int, name: str) -> _Rows:
    floats = np.full(size, 1.2345e-30, np.float32)
    info = AgentInfoProto(reward=np.float32(1.2345e-33), done=True, max_step_reached=True, id=LARGEST_ID)
    observation = info.observations.add(name=name, shape=[size], dimension_properties=[1])
    observation.float_data.data.extend(floats.tolist())
    example = info.SerializeToString()
    reward = example.index(_REWARD)  # then, in the order of field numbers: done, max_step_reached, id
    done, interrupted, identity = reward + 5, reward + 7, reward + 9
    at = example.index(floats.tobytes())
    columns = {"reward": ("<f4", reward), "done": ("u1", done), "interrupted": ("u1", interrupted)}
    return _Rows(example, columns | {"id": ("(5,)u1", identity), "observation": (f"({size},)<f4", at)})


@cache
def _action_rows(size: int, deprecated: bool) -> _Rows:
    old, new = np.full(size, 1.25e-30, np.float32), np.full(size, 1.75e-30, np.float32)
    action = AgentActionProto(continuous_actions=new.tolist())
    if deprecated:
        action.vector_actions_deprecated.extend(old.tolist())
    example = action.SerializeToString()
    columns = {"action": (f"({size},)<f4", example.index(new.tobytes()))}
    if deprecated:
        columns["deprecated"] = (f"({size},)<f4", example.index(old.tobytes()))
    return _Rows(example, columns)


def varint(value: int) -> bytes:
    """A non-negative number as protobuf writes it."""
    result = bytearray()
    while value > 0x7F:
        result.append(value & 0x7F | 0x80)
        value >>= 7
    result.append(value)
    return bytes(result)


def _field(tag: bytes, payload: bytes) -> bytes:
    return tag + varint(len(payload)) + payload


def write_output(behavior: str, name: str, agents: Agents, side_channel: bytes) -> bytes:
    """A player's message with one vector observation per agent.

    Args:
        behavior: The behavior's full name.
        name: The observation's.
        agents: In the order in which they are to be read; pictures of theirs don't travel this way.
        side_channel: Bytes beside them.
    """
    layout = _agent_rows(agents.observations[0].shape[1], name)
    rows = layout.empty(len(agents.ids))
    rows["reward"] = agents.rewards
    rows["done"] = agents.done
    rows["interrupted"] = agents.interrupted
    rows["observation"] = agents.observations[0]
    rows["id"] = (agents.ids[:, None] >> _SHIFTS) & 0x7F | _CONTINUED
    entry = _field(FIELD_1, behavior.encode()) + _field(FIELD_2, rows.tobytes())
    rl_output = _field(FIELD_2, entry) + (_field(FIELD_3, side_channel) if side_channel else b"")
    return HEADER_OK + _field(FIELD_2, _field(FIELD_1, rl_output))


def read_output(data: bytes, behavior: str, name: str, size: int) -> tuple[Agents, bytes] | None:
    """The agents and side-channel bytes of a message that ``write_output`` might have written; None for any other."""
    found = _find_rows(data, FIELD_2, FIELD_2, FIELD_3, behavior)
    rows = None if found is None else _agent_rows(size, name).read(data, *found[:2])
    if found is None or rows is None:
        return None
    groups, done, interrupted = rows["id"], rows["done"], rows["interrupted"]
    if len(rows) and (((groups ^ _CONTINUED) > _GROUP_LIMITS).any() or max(done.max(), interrupted.max()) > 1):
        return None
    ids = ((groups & 0x7F) << _SHIFTS).sum(axis=1, dtype=np.int32)
    reward, observation = rows["reward"].copy(), rows["observation"].copy()
    agents = Agents.ungrouped(ids, reward, done.astype(np.bool_), interrupted.astype(np.bool_), (observation,))
    return agents, found[2]


def write_step(behavior: str, actions: NDArray[np.float32], side_channel: bytes) -> bytes:
    """A trainer's STEP with continuous actions, (n, size), in the new and the deprecated field."""
    layout = _action_rows(actions.shape[1], deprecated=True)
    rows = layout.empty(len(actions))
    rows["action"] = actions
    rows["deprecated"] = actions
    entry = _field(FIELD_1, behavior.encode()) + _field(FIELD_2, rows.tobytes())
    rl_input = _field(FIELD_1, entry) + (_field(FIELD_5, side_channel) if side_channel else b"")
    return HEADER_OK + _field(FIELD_3, _field(FIELD_1, rl_input))


def read_step(data: bytes, behavior: str, size: int) -> tuple[NDArray[np.float32], bytes] | None:
    """The actions and side-channel bytes of a STEP as ``mlagents_envs`` or ``write_step`` writes it; None otherwise."""
    found = _find_rows(data, FIELD_3, FIELD_1, FIELD_5, behavior)
    if found is None:
        return None
    for deprecated in (True, False):
        rows = _action_rows(size, deprecated).read(data, *found[:2])
        if rows is not None:
            return rows["action"].copy(), found[2]
    return None


def _find_rows(
    data: bytes, direction: bytes, rows_by_behavior: bytes, side_channel: bytes, behavior: str
) -> tuple[int, int, bytes] | None:
    """Where a message's rows start and end, and its side-channel bytes; None if it holds anything else.

    Both directions have one form: header, then {direction {field 1 {map {behavior: rows}, side channel}}}.
    """
    reader = _MessageWalker(data)
    reader.expect(HEADER_OK)
    reader.enter(direction)
    reader.enter(FIELD_1)
    entry_end = reader.enter(rows_by_behavior, inside=False)
    key = reader.take(FIELD_1)
    end = reader.enter(FIELD_2, inside=False)
    start, reader.offset = reader.offset, end
    beside = reader.take(side_channel) if not reader.failed and end < len(data) else b""
    if reader.failed or end != entry_end or reader.offset != len(data) or key != behavior.encode():
        return None
    return start, end, beside


class _MessageWalker:
    """Walks through a message that is expected to have one form; ``failed`` if it has another."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.offset = 0
        self.failed = False

    def expect(self, constant: bytes) -> None:
        """Passes over bytes that have to be these."""
        self.failed |= not self._data.startswith(constant, self.offset)
        self.offset += len(constant)

    def enter(self, tag: bytes, inside: bool = True) -> int:
        """Passes over a tag and a length; returns where the field ends: at the message's end, if it lies inside."""
        self.expect(tag)
        length, shift = 0, 0
        while self.offset < len(self._data) and shift < 35:
            byte = self._data[self.offset]
            self.offset += 1
            length |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
        else:
            self.failed = True
        end = self.offset + length
        self.failed |= end != len(self._data) if inside else end > len(self._data)
        return end

    def take(self, tag: bytes) -> bytes:
        """The content of a field."""
        end = self.enter(tag, inside=False)
        content = self._data[self.offset : end]
        self.offset = end
        return content
