"""ML-Agents side channels: bytes that travel beside agents and actions, and what they mean.

A buffer is a run of [16-byte GUID, little-endian][int32 length][payload]; a string is [int32 length][UTF-8 bytes], a
list of floats is [int32 count][float32 each]; everything is little-endian.
"""

import hashlib
import struct
import uuid
from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform, Value

ENGINE_CONFIGURATION = uuid.UUID("e951342c-4f7e-11ea-b238-784f4387d1f7")
ENVIRONMENT_PARAMETERS = uuid.UUID("534c891e-810f-11ea-a9d0-822485860400")
STATISTICS = uuid.UUID("a1d8f7b7-cec8-50f9-b78b-d3e165a78520")
TRAINING_ANALYTICS = uuid.UUID("b664a4a9-d86f-5a5f-95cb-e8353a7e8356")
# Our own: an empty message asks for the areas' state, which comes with the answer; one with a state puts it back, and
# an empty answer says that this can't be done.
AREA_STATE = uuid.UUID("5c0d1a3e-9b1f-4f7e-8a86-6f2f3c7d2b10")

OF_ANY_LENGTH = np.dtype([("byte", np.uint8)])  # rows of a state that is as long as it gets
# Setting -> its values' formats. A player without graphics or a clock has nothing to configure.
ENGINE_SETTINGS = {
    0: ("resolution", "<2i"),
    1: ("quality level", "<i"),
    2: ("time scale", "<f"),
    3: ("target frame rate", "<i"),
    4: ("capture frame rate", "<i"),
}
FLOAT, SAMPLER = 0, 1
UNIFORM, GAUSSIAN, MULTI_RANGE_UNIFORM = 0, 1, 2
AVERAGE, HISTOGRAM = 0, 3


class SideChannelError(ValueError):
    """A side-channel buffer or message that does not follow its layout."""


def split(buffer: bytes) -> Iterator[tuple[uuid.UUID, bytes]]:
    """Yields each message's channel and payload.

    Raises:
        SideChannelError: The buffer ends inside a message; the channel is named where it was read.
    """
    offset = 0
    while offset < len(buffer):
        if len(buffer) - offset < 20:
            raise SideChannelError(
                f"The side-channel buffer ends after {len(buffer) - offset} of a message header's 20 bytes."
            )
        channel = uuid.UUID(bytes_le=buffer[offset : offset + 16])
        (length,) = struct.unpack_from("<i", buffer, offset + 16)
        offset += 20
        if not 0 <= length <= len(buffer) - offset:
            raise SideChannelError(
                f"Side channel {channel} announces {length} bytes, but {len(buffer) - offset} are left in the buffer."
            )
        yield channel, buffer[offset : offset + length]
        offset += length


def message(channel: uuid.UUID, payload: bytes) -> bytes:
    """One message, as ``split`` reads it."""
    return channel.bytes_le + struct.pack("<i", len(payload)) + payload


def read_environment_parameter(payload: bytes) -> tuple[str, Value]:
    """Reads a parameter's name and its value or sampler.

    Raises:
        SideChannelError: The payload is too short or holds an unknown kind.
    """
    reader = _PayloadReader(payload)
    name = reader.string()
    kind = reader.int32()
    if kind == FLOAT:
        return name, reader.float32()
    if kind != SAMPLER:
        raise SideChannelError(
            f"Environment parameter {name!r} has type {kind}; 0 (float) or 1 (sampler) was expected."
        )
    seed, sampler = reader.int32(), reader.int32()
    if sampler == UNIFORM:
        return name, Uniform(seed, reader.float32(), reader.float32())
    if sampler == GAUSSIAN:
        return name, Gaussian(seed, reader.float32(), reader.float32())
    if sampler == MULTI_RANGE_UNIFORM:
        ends = reader.floats()
        if not ends or len(ends) % 2:
            raise SideChannelError(f"Environment parameter {name!r} has {len(ends)} range ends; pairs were expected.")
        return name, MultiRangeUniform(seed, tuple(zip(ends[::2], ends[1::2], strict=True)))
    raise SideChannelError(f"Environment parameter {name!r} has sampler {sampler}; 0, 1 or 2 was expected.")


def read_engine_setting(payload: bytes) -> str:
    """Reads an engine configuration message as text for the log.

    Raises:
        SideChannelError: The payload is too short or holds an unknown setting.
    """
    reader = _PayloadReader(payload)
    setting = reader.int32()
    if setting not in ENGINE_SETTINGS:
        raise SideChannelError(f"Engine setting {setting} is not known; 0 to 4 was expected.")
    name, layout = ENGINE_SETTINGS[setting]
    return f"{name} {' x '.join(f'{value:g}' for value in reader.unpack(layout))}"


def read_statistic(payload: bytes) -> tuple[str, float, int]:
    """Reads a statistic's name, value and way of aggregation.

    Raises:
        SideChannelError: The payload is too short, or the way is an unknown one.
    """
    reader = _PayloadReader(payload)
    name, value, aggregation = reader.string(), reader.float32(), reader.int32()
    if not AVERAGE <= aggregation <= HISTOGRAM:
        raise SideChannelError(f"Statistic {name!r} has aggregation {aggregation}; 0 to {HISTOGRAM} was expected.")
    return name, value, aggregation


def write_statistics(statistics: Mapping[str, NDArray[np.float64]]) -> bytes:
    """Statistics of episodes that ended, by name, (n,) each: one episode after another, in the order of the rows."""
    messages = []
    for values in zip(*statistics.values(), strict=True):
        for name, value in zip(statistics, values, strict=True):
            key = name.encode()
            payload = struct.pack("<i", len(key)) + key + struct.pack("<fi", value, AVERAGE)
            messages.append(message(STATISTICS, payload))
    return b"".join(messages)


def write_state(rows: NDArray[np.void]) -> bytes:
    """The message with the areas' state, a row each: a digest of its columns' names and types, then the rows."""
    return message(AREA_STATE, _layout(rows.dtype) + rows.tobytes())


def read_state(payload: bytes, now: NDArray[np.void]) -> NDArray[np.void]:
    """A state to put back, in the layout of ``now``, the areas' present one.

    Raises:
        SideChannelError: It is another corridor's, or has numbers that are not finite.
    """
    layout = _layout(now.dtype)
    if now.dtype == OF_ANY_LENGTH and payload[: len(layout)] == layout:
        return np.frombuffer(payload, now.dtype, offset=len(layout))
    if payload[: len(layout)] != layout or len(payload) != len(layout) + now.nbytes:
        raise SideChannelError(
            f"The saved state of the areas has {len(payload)} bytes, but {len(layout) + now.nbytes} of a certain form "
            f"were expected for {len(now)} areas; it was saved with other settings or by another version."
        )
    rows = np.frombuffer(payload, now.dtype, offset=len(layout))
    for name in now.dtype.names or ():
        if rows[name].dtype.kind == "f" and not np.isfinite(rows[name]).all():
            raise SideChannelError(f"The saved state of the areas has a {name!r} that is NaN or infinite.")
    return rows


@lru_cache(maxsize=4)
def _layout(columns: np.dtype[np.void]) -> bytes:
    return hashlib.sha256(repr(columns.descr).encode()).digest()


class _PayloadReader:
    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._offset = 0

    def unpack(self, layout: str) -> tuple[float, ...]:
        size = struct.calcsize(layout)
        if len(self._payload) - self._offset < size:
            raise SideChannelError(
                f"A side-channel message has {len(self._payload)} bytes; at least {self._offset + size} were expected."
            )
        values = struct.unpack_from(layout, self._payload, self._offset)
        self._offset += size
        return values

    def int32(self) -> int:
        return int(self.unpack("<i")[0])

    def float32(self) -> float:
        return float(self.unpack("<f")[0])

    def floats(self) -> tuple[float, ...]:
        return self.unpack(f"<{self._length(4)}f")

    def string(self) -> str:
        length = self._length(1)
        (raw,) = struct.unpack_from(f"{length}s", self._payload, self._offset)
        self._offset += length
        try:
            return str(raw, "utf-8")
        except UnicodeDecodeError as error:
            raise SideChannelError(f"A side-channel message holds a string that is not UTF-8 ({error}).") from error

    def _length(self, item_size: int) -> int:
        count = self.int32()
        if not 0 <= count * item_size <= len(self._payload) - self._offset:
            raise SideChannelError(
                f"A side-channel message announces {count} items, but "
                f"{len(self._payload) - self._offset} bytes are left."
            )
        return count
