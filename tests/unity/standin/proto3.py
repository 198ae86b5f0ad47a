"""protobuf's wire format by hand, as C# writes it: a field is a tag and a value; false, 0 and empty are left out."""

import struct

Fields = dict[int, list]


def varint(number: int) -> bytes:
    number &= 2**64 - 1
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    out.append(number)
    return bytes(out)


def integer(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(int(value)) if value else b""


def real(field: int, value: float) -> bytes:
    return varint(field << 3 | 5) + struct.pack("<f", value) if value else b""


def block(field: int, payload: bytes) -> bytes:
    """A message within a message: unlike the others it is written even if it is empty."""
    return varint(field << 3 | 2) + varint(len(payload)) + payload


def text(field: int, value: str) -> bytes:
    return block(field, value.encode()) if value else b""


def reals(field: int, values: list[float]) -> bytes:
    return block(field, struct.pack(f"<{len(values)}f", *values)) if values else b""


def integers(field: int, values: list[int]) -> bytes:
    return block(field, b"".join(varint(value) for value in values)) if values else b""


def _varint_at(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at


def read(data: bytes) -> Fields:
    """Field number -> its values in order; varints as numbers, everything else as bytes."""
    found: Fields = {}
    at = 0
    while at < len(data):
        tag, at = _varint_at(data, at)
        if tag & 7 == 0:
            value, at = _varint_at(data, at)
        else:
            length = {1: 8, 5: 4}.get(tag & 7)
            if length is None:
                length, at = _varint_at(data, at)
            value, at = data[at : at + length], at + length
        found.setdefault(tag >> 3, []).append(value)
    return found


def inner(message: Fields, *path: int) -> Fields:
    """The message at the end of a path of fields; no fields if it is not there."""
    for field in path:
        message = read(message.get(field, [b""])[-1])
    return message


def read_reals(message: Fields, field: int) -> list[float]:
    """A repeated float, packed or not."""
    return [value for part in message.get(field, []) for (value,) in struct.iter_unpack("<f", part)]


def read_integers(message: Fields, field: int) -> list[int]:
    """A repeated int32, packed or not."""
    values = []
    for part in message.get(field, []):
        if isinstance(part, int):
            values.append(part)
            continue
        at = 0
        while at < len(part):
            value, at = _varint_at(part, at)
            values.append(value)
    return values
