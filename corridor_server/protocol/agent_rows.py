"""Agents as they stand in a message, and as arrays: bytes to columns and back, the same bytes that protobuf writes.

Protobuf leaves out what is false, 0 or empty and shortens numbers, so that rows differ in length: by which fields are
there, and by how many bytes an id has. But they have few such layouts, mostly in long runs, and each layout is a
structured array. Whatever doesn't look so, from whichever peer, is left to the protobuf parser.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents
from corridor_server.protocol.row_template import Column, RowTemplate
from corridor_server.protocol.wire_bytes import length_delimited, varint

# Tags of AgentInfoProto's fields.
_REWARD, _DONE, _INTERRUPTED, _ID, _MASK, _GROUP, _GROUP_REWARD = 0x3D, 0x40, 0x48, 0x50, 0x5A, 0x70, 0x7D
_FEW = 8  # runs of rows of one layout that are written one after the other
_LOOK_AHEAD = 1024  # rows at a time in which a reader looks for more of one length
_SHORTEST_OF = np.array(
    [1, 2**7, 2**14, 2**21, 2**28], np.int32
)  # the smallest number with 1, 2, ... bytes; 0 has none

_LONGEST = 5  # bytes of a number that is not negative
_VARINTS = ("id", "group")
_NUMBERS = {
    "id": np.int32,
    "reward": np.float32,
    "done": np.bool_,
    "interrupted": np.bool_,
    "group": np.int32,
    "group_reward": np.float32,
}
Columns = dict[str, NDArray[Any]]


class Sensor(NamedTuple):
    """A vector observation, or a buffer of vectors, as it describes itself in every message.

    Attributes:
        name: Its name.
        shape: Of its numbers.
        dimension_properties: One per dimension (DimensionProperty), or none.
        kind: ObservationTypeProto: 0, or 1 for a goal signal.
    """

    name: str
    shape: tuple[int, ...]
    dimension_properties: tuple[int, ...]
    kind: int = 0


class _Layout(NamedTuple):
    """Which fields a row has."""

    reward: bool
    done: bool
    interrupted: bool
    id_bytes: int
    masked: bool
    group_bytes: int
    group_reward: bool


@dataclass(frozen=True)
class _Row:
    template: RowTemplate
    layout: _Layout


class _Piece(NamedTuple):
    """Rows of one size, one after the other.

    Attributes:
        first: The first one's number.
        start: Where it starts in the message.
        rows: How many there are.
    """

    first: int
    start: int
    rows: int


class AgentRows:
    """Reads and writes the agents of one behavior.

    Args:
        sensors: Of every agent, in their order.
        branches: How many choices each discrete branch has.
    """

    def __init__(self, sensors: tuple[Sensor, ...], branches: tuple[int, ...] = ()) -> None:
        self._shapes = {_observation_name(number): sensor.shape for number, sensor in enumerate(sensors)}
        ends = itertools.accumulate(branches)
        self._of_branches = [slice(end - size, end) for size, end in zip(branches, ends, strict=True)]
        self._choices = sum(branches)
        self._mask_start = bytes((_MASK,)) + varint(self._choices)
        self._observations: list[bytes | Column] = []
        for number, sensor in enumerate(sensors):
            self._observations += _observation(number, sensor)
        self._observation_bytes = sum(
            len(part) if isinstance(part, bytes) else 4 * math.prod(part.shape) for part in self._observations
        )
        self._rows: dict[_Layout, _Row] = {}
        self._of_keys: dict[int, _Row] = {}

    def _row(self, layout: _Layout) -> _Row:
        row = self._rows.get(layout)
        if row is None:
            row = self._rows[layout] = _Row(RowTemplate(self._parts(layout)), layout)
        return row

    def _parts(self, layout: _Layout) -> list[bytes | Column]:
        parts: list[bytes | Column] = []
        if layout.reward:
            parts += [bytes((_REWARD,)), Column("reward", "<f4")]
        if layout.done:
            parts.append(bytes((_DONE, 1)))
        if layout.interrupted:
            parts.append(bytes((_INTERRUPTED, 1)))
        if layout.id_bytes:
            parts += [bytes((_ID,)), Column("id", "u1", (layout.id_bytes,))]
        if layout.masked:
            parts += [self._mask_start, Column("mask", "u1", (self._choices,))]
        parts += self._observations
        if layout.group_bytes:
            parts += [bytes((_GROUP,)), Column("group", "u1", (layout.group_bytes,))]
        if layout.group_reward:
            parts += [bytes((_GROUP_REWARD,)), Column("group_reward", "<f4")]
        return parts

    def write(self, agents: Agents) -> bytes:
        """The rows' bytes.

        Args:
            agents: Ids and group ids are not negative; masks are written if there are any.
        """
        if not len(agents):
            return b""
        keys = _layout_keys(agents)
        borders = (np.flatnonzero(keys[1:] != keys[:-1]) + 1).tolist()
        if len(borders) > _FEW:
            return self._scattered(keys, agents)
        runs = zip([0, *borders], [*borders, len(keys)], strict=True)
        return b"".join([self._filled(int(keys[start]), agents, slice(start, end), end - start) for start, end in runs])

    def _scattered(self, keys: NDArray[np.intp], agents: Agents) -> bytes:
        """Layout by layout, for rows whose layouts come in no order."""
        places = [(keys == key).nonzero()[0] for key in np.flatnonzero(np.bincount(keys))]
        filled = [self._filled(int(keys[place[0]]), agents, place, len(place)) for place in places]
        lengths = np.empty(len(agents), np.intp)
        for place, rows in zip(places, filled, strict=True):
            lengths[place] = len(rows) // len(place)
        starts = lengths.cumsum() - lengths
        data = bytearray(int(lengths.sum()))
        for place, rows in zip(places, filled, strict=True):
            size = len(rows) // len(place)
            _windows(data, size)[starts[place]] = np.frombuffer(rows, f"V{size}")
        return bytes(data)

    def _filled(self, key: int, agents: Agents, place: Any, count: int) -> bytes:
        """Rows of one layout."""
        row = self._of_keys.get(key)
        if row is None:
            row = self._of_keys[key] = self._row(_layout(key))
        rows, layout = row.template.blank(count), row.layout
        if layout.reward:
            rows["reward"] = agents.rewards[place]
        if layout.id_bytes:
            _put_varints(rows["id"], agents.ids[place])
        if layout.masked:
            rows["mask"] = np.concatenate([mask[place] for mask in agents.masks], axis=1)
        for name, values in zip(self._shapes, agents.observations, strict=True):
            rows[name] = values[place]
        if layout.group_bytes:
            _put_varints(rows["group"], agents.group_ids[place])
        if layout.group_reward:
            rows["group_reward"] = agents.group_rewards[place]
        return rows.tobytes()

    def read(self, data: bytes, start: int, end: int) -> Agents | None:
        """The agents whose rows lie from start to end; None if they are not of this form."""
        pieces = _pieces(data, start, end)
        if pieces is None:
            return None
        count = sum(piece.rows for of_size in pieces.values() for piece in of_size)
        columns: Columns = {name: np.zeros(count, kind) for name, kind in _NUMBERS.items()}
        columns["mask"] = np.zeros((count, self._choices), np.uint8)
        for name, shape in self._shapes.items():
            columns[name] = np.empty((count, *shape), np.float32)
        fits = all(self._read_size(data, size, of_size, columns) for size, of_size in pieces.items())
        return self._agents(columns) if fits else None

    def _read_size(self, data: bytes, size: int, pieces: list[_Piece], columns: Columns) -> bool:
        """Takes rows of one size into the columns, layout by layout; returns whether they are of this form."""
        places: Any = slice(pieces[0].first, pieces[0].first + pieces[0].rows)
        if len(pieces) == 1:
            raw = np.frombuffer(data, np.uint8, pieces[0].rows * size, pieces[0].start).reshape(-1, size)
        else:
            places, starts = _joined(pieces, size)
            raw = _windows(data, size)[starts].view(np.uint8).reshape(-1, size)
        while True:
            row = self._row_like(raw[0].tobytes())
            others = None if row is None else row.template.mismatches(raw)
            if row is None or (others is not None and others[0]):
                return False
            if others is None:
                return _take(row, raw, columns, places)
            places = np.arange(len(columns["id"]))[places]
            if not _take(row, raw[~others], columns, places[~others]):
                return False
            raw, places = raw[others], places[others]

    def _row_like(self, row: bytes) -> _Row | None:
        """The layout that a row has, going by its tags; None if there is none of its length."""
        try:
            offset = 1 + _varint_bytes(row, 1)
            reward = row[offset] == _REWARD
            offset += 5 * reward
            done = row[offset] == _DONE
            offset += 2 * done
            interrupted = row[offset] == _INTERRUPTED
            offset += 2 * interrupted
            id_bytes = _varint_bytes(row, offset + 1) if row[offset] == _ID else 0
            offset += id_bytes + (id_bytes > 0)
            masked = self._choices > 0 and row.startswith(self._mask_start, offset)
            offset += masked * (len(self._mask_start) + self._choices) + self._observation_bytes
            group_bytes = _varint_bytes(row, offset + 1) if offset < len(row) and row[offset] == _GROUP else 0
            offset += group_bytes + (group_bytes > 0)
        except IndexError:
            return None
        if id_bytes > _LONGEST or group_bytes > _LONGEST:
            return None
        found = self._row(_Layout(reward, done, interrupted, id_bytes, masked, group_bytes, offset < len(row)))
        return found if found.template.size == len(row) else None

    def _agents(self, columns: Columns) -> Agents | None:
        """None if a mask isn't made of 0 and 1."""
        mask = columns["mask"]
        if mask.size and mask.max() > 1:
            return None
        return Agents(
            columns["id"],
            columns["reward"],
            columns["done"],
            columns["interrupted"],
            tuple(columns[name] for name in self._shapes),
            columns["group"],
            columns["group_reward"],
            tuple(mask[:, branch].astype(np.bool_) for branch in self._of_branches),
        )


def _take(row: _Row, raw: NDArray[np.uint8], columns: Columns, places: Any) -> bool:
    """Puts rows of one layout, (n, size) bytes, into the columns; returns whether they hold numbers that can be."""
    rows = raw.reshape(-1).view(row.template.dtype)
    for name in row.template.names:
        values: NDArray[Any] | None = rows[name]
        if name in _VARINTS:
            values = _numbers(rows[name])
            if values is None:
                return False
        columns[name][places] = values
    if row.layout.done:
        columns["done"][places] = True
    if row.layout.interrupted:
        columns["interrupted"][places] = True
    return True


def _pieces(data: bytes, start: int, end: int) -> dict[int, list[_Piece]] | None:
    """Where the rows of each size lie, going by their lengths; None if they don't end at ``end``."""
    pieces: dict[int, list[_Piece]] = {}
    row, previous = 0, 0
    try:
        while start < end:
            prefix = 1 + _varint_bytes(data, start + 1)
            size = prefix + (data[start + 1] if prefix == 2 else _number(data[start + 1 : start + prefix]))
            count = 1
            if size == previous:
                stop = min(end, start + _LOOK_AHEAD * size)
                count = min(_repeats(data[index:stop:size]) for index in range(start + 1, start + prefix))
            of_size = pieces.setdefault(size, [])
            if of_size and of_size[-1].first + of_size[-1].rows == row:
                last = of_size.pop()
                of_size.append(_Piece(last.first, last.start, last.rows + count))
            else:
                of_size.append(_Piece(row, start, count))
            row, start, previous = row + count, start + count * size, size
    except IndexError:
        return None
    return pieces if start == end else None


def _repeats(values: bytes) -> int:
    """How often the first byte comes before another one does."""
    return len(values) - len(values.lstrip(values[:1]))


def _joined(pieces: list[_Piece], size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Each row's number, and where it starts."""
    first, starts, counts = np.array(pieces, np.intp).T
    within = np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)
    return np.repeat(first, counts) + within, np.repeat(starts, counts) + within * size


def _observation_name(number: int) -> str:
    return f"observation {number}"


def _observation(number: int, sensor: Sensor) -> list[bytes | Column]:
    """An agent's field 13, an ObservationProto of uncompressed numbers."""
    size = 4 * math.prod(sensor.shape)
    floats = Column(_observation_name(number), "<f4", sensor.shape)
    before = length_delimited(1, b"".join(varint(each) for each in sensor.shape))
    data_start = b"\x0a" + varint(size)
    before += b"\x22" + varint(len(data_start) + size) + data_start
    properties = b"".join(varint(each) for each in sensor.dimension_properties)
    after = length_delimited(6, properties) if properties else b""
    after += b"\x38" + varint(sensor.kind) if sensor.kind else b""
    after += length_delimited(8, sensor.name.encode()) if sensor.name else b""
    return [b"\x6a" + varint(len(before) + size + len(after)) + before, floats, after]


def _layout_keys(agents: Agents) -> NDArray[np.intp]:
    """A number per agent for its row's layout: see ``_layout``."""
    keys = np.searchsorted(_SHORTEST_OF, agents.ids, side="right") << 4  # how many bytes the id has
    keys += agents.rewards.view(np.int32) != 0  # protobuf goes by the bits: -0.0 is written
    if agents.masks:
        keys += 8
    for weight, flags in ((2, agents.done), (4, agents.interrupted)):
        if np.count_nonzero(flags):
            keys += weight * flags
    if np.count_nonzero(agents.group_ids):
        keys += np.searchsorted(_SHORTEST_OF, agents.group_ids, side="right") << 7
    group_rewards = agents.group_rewards.view(np.int32)
    if np.count_nonzero(group_rewards):
        keys += (group_rewards != 0).astype(np.intp) << 10
    return keys


def _layout(key: int) -> _Layout:
    return _Layout(
        reward=bool(key & 1),
        done=bool(key & 2),
        interrupted=bool(key & 4),
        masked=bool(key & 8),
        id_bytes=key >> 4 & 7,
        group_bytes=key >> 7 & 7,
        group_reward=bool(key >> 10 & 1),
    )


def _windows(data: bytes | bytearray, size: int) -> NDArray[np.void]:
    """Every run of ``size`` bytes, by where it starts."""
    return np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))


def _put_varints(groups: NDArray[np.uint8], numbers: NDArray[np.int32]) -> None:
    """Writes numbers as varints of as many bytes as ``groups`` has columns, which is how many they need."""
    last = groups.shape[1] - 1
    for index in range(last):
        groups[:, index] = numbers >> 7 * index & 0x7F | 0x80
    groups[:, last] = numbers >> 7 * last


def _varint_bytes(data: bytes, start: int) -> int:
    """How many bytes the varint at ``start`` has; an IndexError if the data ends in it."""
    end = start
    while data[end] > 0x7F:
        end += 1
    return end + 1 - start


def _number(varint_bytes: bytes) -> int:
    value = 0
    for index, byte in enumerate(varint_bytes):
        value |= (byte & 0x7F) << 7 * index
    return value


def _numbers(groups: NDArray[np.uint8]) -> NDArray[np.int32] | None:
    """What varints of one length stand for; None if one is longer or shorter, or stands for no int32 from 0 on."""
    last = groups.shape[1] - 1
    highest = groups[:, last]
    if not highest.tobytes().isascii() or (last == _LONGEST - 1 and highest.max() > 7):
        return None
    values = highest.astype(np.int32)
    for index in range(last - 1, -1, -1):
        if groups[:, index].min() < 0x80:
            return None
        values = values << 7 | groups[:, index] & 0x7F
    return values
