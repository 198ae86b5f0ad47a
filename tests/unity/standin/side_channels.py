"""The side channels of a Unity player: a run of [GUID][length][payload], little-endian."""

import itertools
import random
import struct
import uuid
from collections.abc import Callable, Iterator


def _guid(text: str) -> bytes:
    return uuid.UUID(text).bytes_le


ENGINE = _guid("e951342c-4f7e-11ea-b238-784f4387d1f7")
PARAMETERS = _guid("534c891e-810f-11ea-a9d0-822485860400")
STATISTICS = _guid("a1d8f7b7-cec8-50f9-b78b-d3e165a78520")
ANALYTICS = _guid("b664a4a9-d86f-5a5f-95cb-e8353a7e8356")
ENGINE_SETTINGS = {
    0: ("resolution", "<ii"), 1: ("quality", "<i"), 2: ("time scale", "<f"), 3: ("frame rate", "<i"),
    4: ("capture frame rate", "<i"),
}  # fmt: skip


def statistic(name: str, value: float) -> bytes:
    """A number for the trainer's board, averaged there."""
    payload = struct.pack("<i", len(name)) + name.encode() + struct.pack("<fi", value, 0)
    return STATISTICS + struct.pack("<i", len(payload)) + payload


def _split(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at < len(data):
        channel, (length,) = data[at : at + 16], struct.unpack_from("<i", data, at + 16)
        at += 20 + length
        if length < 0 or at > len(data):
            raise ValueError(f"channel {uuid.UUID(bytes_le=channel)}: {length} bytes were announced, fewer came")
        yield channel, data[at - length : at]


class SideChannels:
    """What came in: environment parameters are kept, everything is told to the log."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._parameters: dict[str, Iterator[float]] = {}

    def parameter(self, name: str, default: float) -> float:
        """The value, or the sampler's next one: a sampler draws whenever the scene reads it."""
        return next(self._parameters[name]) if name in self._parameters else default

    def names(self) -> list[str]:
        """The parameters that were given."""
        return list(self._parameters)

    def listen(self, data: bytes) -> None:
        """Takes the bytes of one message; bytes that are cut off are an exception in the log, and the game goes on."""
        try:
            for channel, payload in _split(data):
                self._take(channel, payload)
        except (ValueError, struct.error) as error:
            self._say(f"exception: {error}")

    def _take(self, channel: bytes, payload: bytes) -> None:
        if channel == ENGINE:
            (kind,) = struct.unpack_from("<i", payload)
            name, layout = ENGINE_SETTINGS[kind]
            values = struct.unpack_from(layout, payload, 4)
            self._say(f"{name} {' '.join(f'{max(value, 1) if kind == 2 else value:g}' for value in values)}")
        elif channel == PARAMETERS:
            (size,) = struct.unpack_from("<i", payload)
            name = payload[4 : 4 + size].decode()
            self._parameters[name] = self._source(name, payload[4 + size :])
        elif channel != ANALYTICS:
            self._say(f"unknown channel {uuid.UUID(bytes_le=channel)}")

    def _source(self, name: str, payload: bytes) -> Iterator[float]:
        (kind,) = struct.unpack_from("<i", payload)
        if kind == 0:
            (value,) = struct.unpack_from("<f", payload, 4)
            self._say(f"parameter {name}: {value:g}")
            return itertools.repeat(value)
        seed, sampler = struct.unpack_from("<ii", payload, 4)
        self._say(f"parameter {name}: sampler {sampler}, seed {seed}")
        stream = random.Random(seed)
        if sampler == 2:
            (count,) = struct.unpack_from("<i", payload, 12)
            numbers = struct.unpack_from(f"<{count}f", payload, 16)
            pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
            widths = [high - low for low, high in pairs]
            return (stream.uniform(*stream.choices(pairs, widths)[0]) for _ in itertools.count())
        first, second = struct.unpack_from("<ff", payload, 12)
        return ((stream.gauss if sampler == 1 else stream.uniform)(first, second) for _ in itertools.count())
