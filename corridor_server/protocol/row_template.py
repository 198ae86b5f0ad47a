"""Rows of one length in a protobuf message, as a structured array: constant bytes, with columns of values between."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.wire_bytes import varint

FIELD_1 = b"\x0a"


class Column(NamedTuple):
    """Bytes of a row that hold a value.

    Attributes:
        name: The column's.
        kind: The dtype of its numbers.
        shape: How many they are; a single number for ``()``.
    """

    name: str
    kind: str
    shape: tuple[int, ...] = ()


class RowTemplate:
    """A repeated field 1 whose entries all have this layout.

    Args:
        parts: What an entry is made of: constant bytes, and columns.

    Attributes:
        size: Bytes per row, tag and length included.
        dtype: Of a row, with the columns only.
        names: Of the columns.
        prefix: The tag and length that each row begins with.
    """

    def __init__(self, parts: Sequence[bytes | Column]) -> None:
        sizes = [len(part) if isinstance(part, bytes) else _size(part) for part in parts]
        prefix = FIELD_1 + varint(sum(sizes))
        columns, example, offset = {}, prefix, len(prefix)
        for part, size in zip(parts, sizes, strict=True):
            if isinstance(part, bytes):
                example += part
            else:
                columns[part.name] = (np.dtype((part.kind, part.shape)), offset)
                example += bytes(size)
            offset += size
        self.size = offset
        self.prefix = prefix
        self.names = tuple(columns)
        formats, offsets = [kind for kind, _ in columns.values()], [at for _, at in columns.values()]
        self.dtype = np.dtype({"names": self.names, "formats": formats, "offsets": offsets, "itemsize": offset})
        varying = np.zeros(1, self.dtype)
        for name in self.names:
            varying[name].view(np.uint8)[...] = 255
        self._mask = ~varying.view(np.uint8)
        self._expected = example  # zero where values go, as under the mask

    def blank(self, count: int) -> NDArray[np.void]:
        """Rows whose columns are to be filled in."""
        return np.frombuffer(bytearray(self._expected) * count, self.dtype)

    def mismatches(self, rows: NDArray[np.uint8]) -> NDArray[np.bool_] | None:
        """Which of the rows, (n, size) bytes, have another constant byte; None if none has."""
        constants = rows & self._mask
        if constants.tobytes() == self._expected * len(rows):  # as bytes: several times as fast as NumPy's comparison
            return None
        differs: NDArray[np.bool_] = (constants != np.frombuffer(self._expected, np.uint8)).any(axis=1)
        return differs

    def all(self, data: bytes, start: int, end: int) -> NDArray[np.void] | None:
        """The rows from start to end, if that is what they are."""
        count, rest = divmod(end - start, self.size)
        if rest:
            return None
        raw = np.frombuffer(data, np.uint8, count * self.size, start)
        return raw.view(self.dtype) if self.mismatches(raw.reshape(count, self.size)) is None else None


def _size(column: Column) -> int:
    return np.dtype((column.kind, column.shape)).itemsize
