"""Pictures as they travel: PNG files or floats, channels first or last, as the trainer's client reads them."""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Sensor

_PER_FILE = 3  # channels of a PNG file


@dataclass(frozen=True)
class PictureForm:
    """How pictures travel.

    Attributes:
        compressed: As PNG where they are bytes; otherwise as floats from 0 to 1.
        channels_first: Shape (channels, height, width), as clients from mlagents-envs 1.0 on expect it; (height, width,
            channels) for older ones. The protocol's version is the same.
        mapped: Whether the client reads several PNG files and which channel is which; otherwise only pictures of three
            channels are compressed.
    """

    compressed: bool = True
    channels_first: bool = False
    mapped: bool = True

    def compresses(self, values: NDArray[Any]) -> bool:
        """Whether an observation of a batch travels as PNG: only whole bytes can."""
        as_client_can = self.mapped or values.shape[-1] == _PER_FILE
        return self.compressed and values.dtype == np.uint8 and as_client_can

    def sensor(self, sensor: Sensor) -> Sensor:
        """How an observation is described to the client; anything but a picture as it is."""
        if len(sensor.shape) != 3 or not self.channels_first:
            return sensor
        return sensor._replace(shape=_first(sensor.shape), dimension_properties=_first(sensor.dimension_properties))

    def floats(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """A batch's observation as numbers, in the client's order: a byte's are from 0 to 1."""
        numbers = values.astype(np.float32) / np.float32(255) if values.dtype == np.uint8 else values
        return numbers.transpose(0, 3, 1, 2) if numbers.ndim == 4 and self.channels_first else numbers


def channel_mapping(channels: int) -> list[int]:
    """Which of a picture's channels each one of its PNG files' is; -1 for one that only fills the last file up."""
    return [*range(channels), *[-1] * (-channels % _PER_FILE)]


def png_files(picture: NDArray[np.uint8]) -> bytes:
    """A picture, (height, width, channels), as PNG files of three channels each, one after another."""
    filled = np.pad(picture, ((0, 0), (0, 0), (0, -picture.shape[2] % _PER_FILE)))
    return b"".join(_png(filled[:, :, at : at + _PER_FILE]) for at in range(0, filled.shape[2], _PER_FILE))


def _first(of_last: tuple[int, ...]) -> tuple[int, ...]:
    return of_last[-1], *of_last[:-1]


def _png(image: NDArray[np.uint8]) -> bytes:
    """An RGB picture, (height, width, 3), as a PNG file: without Pillow, which the player does without."""
    height, width, _ = image.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), image.reshape(height, -1)], axis=1)  # filter 0: none

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits, RGB
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(lines.tobytes()))
        + chunk(b"IEND", b"")
    )
