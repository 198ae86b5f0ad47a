"""Rows of one length in a protobuf message, as a structured array: constant bytes, with columns of values between."""

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.varints import is_varint
from corridor_server.protocol.wire_bytes import varint

FIELD_1 = b"\x0a"


class Column(NamedTuple):
    """Bytes of a row that hold a value.

    Attributes:
        name: The column's.
        kind: The dtype of its numbers.
        shape: How many they are; a single number for ``()``.
        varint: Whether they are the bytes of one varint, whose highest bits are then constant: set but in the last.
    """

    name: str
    kind: str
    shape: tuple[int, ...] = ()
    varint: bool = False


Parts = list[bytes | Column]


def example(parts: Parts) -> bytes:
    """The bytes of these parts, with 0 for all values."""
    return b"".join(part if isinstance(part, bytes) else _blank(part) for part in parts)


def _blank(column: Column) -> bytes:
    size = np.dtype((column.kind, column.shape)).itemsize
    return b"\x80" * (size - 1) + b"\0" if column.varint else bytes(size)


class RowTemplate:
    """Rows that all have this layout.

    Args:
        parts: What a row is made of: constant bytes, of which some stand before every column, and columns.

    Attributes:
        size: Bytes per row.
        dtype: Of a row, with the columns only.
        names: Of the columns.
    """

    def __init__(self, parts: Parts) -> None:
        columns, offset = {}, 0
        constants, layout = [b""], ""
        for part in parts:
            size = len(example([part]))
            if isinstance(part, bytes):
                constants[-1] += part
            else:
                columns[part.name] = (np.dtype((part.kind, part.shape)), offset)
                layout += f"{len(constants[-1])}s{size}s"
                constants.append(b"")
            offset += size
        self.size = offset
        self.names = tuple(columns)
        formats, offsets = [kind for kind, _ in columns.values()], [at for _, at in columns.values()]
        self.dtype = np.dtype({"names": self.names, "formats": formats, "offsets": offsets, "itemsize": offset})
        varying = np.zeros(1, self.dtype)
        varints = {part.name for part in parts if isinstance(part, Column) and part.varint}
        for name in self.names:
            varying[name].view(np.uint8)[...] = 0x7F if name in varints else 0xFF
        self._mask = ~varying.view(np.uint8)  # of as many rows as were read at once
        self._expected = example(parts)  # zero where values go, as under the mask
        self._varints = [index for index, name in enumerate(self.names) if name in varints]
        self._constants = tuple(constants)
        self._struct = struct.Struct(f"{layout}{len(constants[-1])}s")

    def blank(self, count: int) -> NDArray[np.void]:
        """Rows whose columns are to be filled in."""
        return np.frombuffer(bytearray(self._expected) * count, self.dtype)

    def row(self, data: bytes, start: int) -> tuple[bytes, ...] | None:
        """The columns' bytes of the row at ``start``, which lies inside the data; None if it has another layout."""
        fields = self._struct.unpack_from(data, start)
        values = fields[1::2]
        if fields[::2] != self._constants or not all(is_varint(values[index]) for index in self._varints):
            return None
        return values

    def run(self, data: bytes, start: int, count: int) -> NDArray[np.void]:
        """Those of ``count`` rows at ``start`` that come before the first one with another constant byte."""
        rows = np.frombuffer(data, self.dtype, count, start)
        if len(self._mask) < count * self.size:
            self._mask = np.tile(self._mask[: self.size], count)
        constants = (rows.view(np.uint8) & self._mask[: count * self.size]).tobytes()
        expected = self._expected * count
        if constants == expected:  # as bytes: several times as fast as NumPy's comparison
            return rows
        differs = np.frombuffer(constants, np.uint8) != np.frombuffer(expected, np.uint8)
        return rows[: int(differs.argmax()) // self.size]

    def all(self, data: bytes, start: int, end: int) -> NDArray[np.void] | None:
        """The rows from start to end, if that is what they are."""
        count, rest = divmod(end - start, self.size)
        rows = None if rest else self.run(data, start, count)
        return rows if rows is not None and len(rows) == count else None


def repeated(parts: Parts) -> RowTemplate:
    """Rows that are entries of a repeated field 1: each with its tag and length before it."""
    return RowTemplate([FIELD_1 + varint(len(example(parts))), *parts])
