"""Protobuf's numbers of varying length, many at a time: only those from 0 to the largest int32, as ids are."""

import numpy as np
from numpy.typing import NDArray

LONGEST, LARGEST = 5, 2**31 - 1  # bytes, and value
_SHORTEST_OF = np.array([1, 2**7, 2**14, 2**21, 2**28], np.int32)  # the smallest number of 1, 2, ... bytes; 0 has none


def byte_counts(numbers: NDArray[np.int32]) -> NDArray[np.intp]:
    """How many bytes each number is written with; none for 0, which protobuf leaves out."""
    return np.searchsorted(_SHORTEST_OF, numbers, side="right")


def varint_size(data: bytes, start: int) -> int:
    """How many bytes the varint at ``start`` has; an IndexError if the data ends in it."""
    end = start
    while data[end] > 0x7F:
        end += 1
    return end + 1 - start


def number_in(varint_bytes: bytes) -> int:
    """What one varint stands for."""
    value = 0
    for index, byte in enumerate(varint_bytes):
        value |= (byte & 0x7F) << 7 * index
    return value


def is_varint(data: bytes) -> bool:
    """Whether all these bytes are one varint: the last alone has its highest bit not set."""
    return data[-1] < 0x80 and (len(data) == 1 or min(data[:-1]) > 0x7F)


def numbers_in(groups: NDArray[np.uint8]) -> NDArray[np.int32] | None:
    """What varints of one length stand for, (n, bytes); None if one is larger than an int32."""
    last = groups.shape[1] - 1
    values = groups[:, last].astype(np.int32)
    if last == LONGEST - 1 and values.max() > LARGEST >> 7 * last:
        return None
    for index in range(last - 1, -1, -1):
        values = values << 7 | groups[:, index] & 0x7F
    return values
