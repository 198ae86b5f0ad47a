"""Agents as they stand in a message, and as arrays: bytes to columns and back, the same bytes that protobuf writes.

Protobuf leaves out what is false, 0 or empty and shortens numbers, so that rows differ in length: by which fields are
there, and by how many bytes an id has. But they have few such layouts, mostly in long runs, and each layout is a
structured array. Whatever doesn't look so, from whichever peer, is left to the protobuf parser.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agent_columns import AgentColumns
from corridor_server.protocol.agent_layout import AgentLayouts, AgentRow, Layout, Sensor, layout_keys
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.varints import number_in, put_numbers, varint_size
from corridor_server.protocol.wire_bytes import varint

_FEW = 12  # runs of rows of one layout that are written one after the other
_SHORT_RUN = 6  # rows that are quicker read one by one
_SMALLEST = 4  # bytes of a row that has an observation, and more
_LOOK_AHEAD = 1024  # rows at a time in which a reader looks for more of one length


class AgentRows:
    """Reads and writes the agents of one behavior.

    Args:
        sensors: Of every agent, in their order.
        branches: How many choices each discrete branch has.
    """

    def __init__(self, sensors: tuple[Sensor, ...], branches: tuple[int, ...] = ()) -> None:
        self._layouts = AgentLayouts(sensors, branches)
        self._last_read: dict[int, AgentRow] = {}

    def write(self, agents: Agents) -> bytes:
        """The rows' bytes.

        Args:
            agents: Ids and group ids are not negative; masks are written if there are any.
        """
        if not len(agents):
            return b""
        keys = layout_keys(agents)
        borders = [1 + border for border in (keys[1:] != keys[:-1]).nonzero()[0].tolist()]
        if len(borders) > _FEW:
            return self._scattered(keys, agents)
        runs = zip([0, *borders], [*borders, len(keys)], strict=True)
        return b"".join([self._run(int(keys[start]), agents, start, end) for start, end in runs])

    def _run(self, key: int, agents: Agents, start: int, end: int) -> bytes:
        """Rows of one layout, one after the other."""
        if end - start > 1:
            return self._filled(key, agents, slice(start, end), end - start)
        return self._layouts.of_key(key).template.joined(self._values(self._layouts.of_key(key).layout, agents, start))

    def _values(self, layout: Layout, agents: Agents, at: int) -> list[bytes]:
        """The columns' bytes of one agent's row."""
        values = [agents.rewards[at].tobytes()] if layout.reward else []
        if layout.id_bytes:
            values.append(varint(int(agents.ids[at])))
        if layout.masked:
            values.append(b"".join([mask[at].tobytes() for mask in agents.masks]))
        values += [each[at].tobytes() for each in agents.observations]
        if layout.group_bytes:
            values.append(varint(int(agents.group_ids[at])))
        if layout.group_reward:
            values.append(agents.group_rewards[at].tobytes())
        return values

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
        row = self._layouts.of_key(key)
        rows, layout = row.template.blank(count), row.layout
        if layout.reward:
            rows["reward"] = agents.rewards[place]
        if layout.id_bytes:
            put_numbers(rows["id"], agents.ids[place])
        if layout.masked:
            rows["mask"] = np.concatenate([mask[place] for mask in agents.masks], axis=1)
        for name, values in zip(self._layouts.shapes, agents.observations, strict=True):
            rows[name] = values[place]
        if layout.group_bytes:
            put_numbers(rows["group"], agents.group_ids[place])
        if layout.group_reward:
            rows["group_reward"] = agents.group_rewards[place]
        return rows.tobytes()

    def read(self, data: bytes, start: int, end: int) -> Agents | None:
        """The agents whose rows lie from start to end; None if they are not of this form."""
        pieces = _pieces(data, start, end)
        if pieces is None:
            return None
        count = sum(rows for of_size in pieces.values() for _, _, rows in of_size)
        columns = AgentColumns(count, self._layouts.shapes, self._layouts.choices)
        for size, of_size in pieces.items():
            first, begin, rows = of_size[0]
            places: Sequence[int] = range(first, first + rows)
            buffer = data
            if len(of_size) > 1:  # copying is cheaper than reading each piece by itself
                buffer, begin = b"".join([data[at : at + size * many] for _, at, many in of_size]), 0
                places = [place for first, _, many in of_size for place in range(first, first + many)]
            if not self._read_size(buffer, begin, size, places, columns):
                return None
        return columns.agents(self._layouts.branches)

    def _read_size(self, data: bytes, start: int, size: int, places: Sequence[int], columns: AgentColumns) -> bool:
        """Puts rows of one size, one after the other, into their places; returns whether they are of this form."""
        done, alone = 0, 0
        while done < len(places):
            at, left = start + done * size, len(places) - done
            found = self._row_at(data, at, size)
            if found is None:
                return False
            row, values = found
            if left < _SHORT_RUN or alone:
                fits, taken, alone = columns.put(places[done], row, values), 1, max(alone - 1, 0)
            else:
                rows = row.template.run(data, at, min(left, _LOOK_AHEAD))
                taken = len(rows)
                fits = columns.put_run(_index(places[done : done + taken]), row, rows)
                alone = _SHORT_RUN if taken < _SHORT_RUN else 0  # not to look far ahead again and again in vain
            if not fits:
                return False
            done += taken
        return True

    def _row_at(self, data: bytes, start: int, size: int) -> tuple[AgentRow, tuple[bytes, ...]] | None:
        """The layout and the columns' bytes of the row at ``start``; None if it is not of this form."""
        if size < _SMALLEST:
            return None
        # Mostly, rows of one size that begin with one tag have one layout.
        likely = size << 8 | data[start + (2 if size < 0x82 else 3)]
        row = self._last_read.get(likely)
        values = None if row is None else row.template.row(data, start)
        if row is None or values is None:
            row = self._layouts.like(data[start : start + size])
            values = None if row is None else row.template.row(data, start)
            if row is None or values is None:
                return None
            self._last_read[likely] = row
        return row, values


def _pieces(data: bytes, start: int, end: int) -> dict[int, list[tuple[int, int, int]]] | None:
    """By size, rows that lie one after the other, going by their lengths: the first one's number and start, how many.

    None if they don't end at ``end``.
    """
    pieces: dict[int, list[tuple[int, int, int]]] = {}
    row, previous = 0, 0
    try:
        while start < end:
            prefix, size = 2, 2 + data[start + 1]
            if size > 0x81:
                prefix = 1 + varint_size(data, start + 1)
                size = prefix + number_in(data[start + 1 : start + prefix])
            of_size, count = pieces.setdefault(size, []), 1
            if size == previous:
                stop = min(end, start + _LOOK_AHEAD * size)
                count = min([_repeats(data[index:stop:size]) for index in range(start + 1, start + prefix)])
                first, begin, rows = of_size.pop()
                of_size.append((first, begin, rows + count))
            else:
                of_size.append((row, start, 1))
            row, start, previous = row + count, start + count * size, size
    except IndexError:
        return None
    return pieces if start == end else None


def _repeats(values: bytes) -> int:
    """How often the first byte comes before another one does."""
    return len(values) - len(values.lstrip(values[:1]))


def _index(places: Sequence[int]) -> Any:
    return slice(places.start, places.stop) if isinstance(places, range) else np.array(places, np.intp)


def _windows(data: bytes | bytearray, size: int) -> NDArray[np.void]:
    """Every run of ``size`` bytes, by where it starts."""
    return np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
