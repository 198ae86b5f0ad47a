"""Agents as they stand in a message, and as arrays: bytes to columns and back, the same bytes that protobuf writes.

Protobuf leaves out what is false, 0 or empty and shortens numbers, so that rows differ in length: by which fields are
there, and by how many bytes an id has. But they have few such layouts, mostly in long runs, and each layout is a
structured array. Whatever doesn't look so, from whichever peer, is left to the protobuf parser.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from corridor_server.protocol.agent_columns import AgentColumns
from corridor_server.protocol.agent_layout import AgentLayouts, AgentRow
from corridor_server.protocol.agent_writer import AgentWriter
from corridor_server.protocol.agents import Agents, Sensor
from corridor_server.protocol.varints import number_in, varint_size

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
        self._writer = AgentWriter(self._layouts)
        self._last_read: dict[int, AgentRow] = {}

    def write(self, agents: Agents) -> bytes:
        """The rows' bytes.

        Args:
            agents: Ids and group ids are not negative; masks are written if there are any.
        """
        return self._writer.write(agents)

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
