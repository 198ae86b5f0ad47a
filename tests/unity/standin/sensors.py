"""What agents see, as ObservationProtos: vectors, goals, buffers and pictures."""

import struct
import zlib

from standin.proto3 import block, integer, integers, reals, text
from standin.spec import Sensor
from standin.worlds import World

NONE, TRANSLATIONAL, VARIABLE_SIZE = 1, 2, 4  # dimension properties
PNG, GOAL_SIGNAL = 1, 1


def observations(sensors: tuple[Sensor, ...], world: World) -> bytes:
    """Fields 13 of an AgentInfoProto, one for each sensor; vectors share out what the world shows among them."""
    seen, at, out = world.seen(), 0, b""
    for number, sensor in enumerate(sensors):
        name = sensor.name or f"{sensor.kind}{number}"
        if sensor.kind == "vector":
            values = [seen[(at + place) % len(seen)] for place in range(sensor.size)]
            at += sensor.size
            out += block(13, _floats([sensor.size], values, [NONE]) + text(8, name))
        elif sensor.kind == "goal":
            values = goal(sensor.size, world)
            out += block(13, _floats([sensor.size], values, [NONE]) + integer(7, GOAL_SIGNAL) + text(8, name))
        elif sensor.kind == "buffer":
            shape, values = [sensor.rows, sensor.size], entities(sensor.rows, sensor.size, world)
            out += block(13, _floats(shape, values, [VARIABLE_SIZE, NONE]) + text(8, name))
        elif sensor.kind == "picture":
            out += block(13, _picture(sensor, world) + text(8, name))
        else:
            raise ValueError(f"sensor {name}: no such kind, {sensor.kind}")
    return out


def _floats(shape: list[int], values: list[float], dimensions: list[int]) -> bytes:
    return integers(1, shape) + block(4, reals(1, values)) + integers(6, dimensions)


def goal(size: int, world: World) -> list[float]:
    """One-hot: in which part of the line the target is."""
    place = min(int((world.aim() + 1) / 2 * size), size - 1)
    return [float(each == place) for each in range(size)]


def entities(rows: int, size: int, world: World) -> list[float]:
    """As many rows as the episode is old, from none up to all and again; the rest is padded with zeros."""
    there = world.age % (rows + 1)
    values = [world.aim() - world.place() + row for row in range(there) for _ in range(size)]
    return values + [0.0] * ((rows - there) * size)


def pixels(shape: tuple[int, ...], world: World) -> list[list[list[int]]]:
    """(C, H, W) bytes: a column in channel 0 where the agent is, and in the last one where its target is."""
    channels, height, width = shape
    own, aim = (round((place + 1) / 2 * (width - 1)) for place in (world.place(), world.aim()))
    picture = [[[0] * width for _ in range(height)] for _ in range(channels)]
    for row in range(height):
        picture[0][row][own] = 255 - row
        picture[-1][row][aim] = 128 + row
    return picture


def _picture(sensor: Sensor, world: World) -> bytes:
    channels, height, width = sensor.shape
    picture = pixels(sensor.shape, world)
    dimensions = integers(6, [NONE, TRANSLATIONAL, TRANSLATIONAL])
    shape = integers(1, list(sensor.shape))
    if not sensor.png:
        values = [value / 255 for channel in picture for row in channel for value in row]
        return shape + block(4, reals(1, values)) + dimensions
    if channels == 1:
        mapping, groups = [0, 0, 0], [[picture[0]] * 3]
    else:  # three channels to a PNG, the last one filled up with black
        black = [[0] * width for _ in range(height)]
        padded = picture + [black] * (-channels % 3)
        mapping = [] if channels == 3 else [*range(channels), *[-1] * (-channels % 3)]
        groups = [padded[first : first + 3] for first in range(0, len(padded), 3)]
    data = b"".join(png(group) for group in groups)
    return shape + integer(2, PNG) + block(3, data) + integers(5, mapping) + dimensions


def png(channels: list[list[list[int]]]) -> bytes:
    """Three channels (H, W) as an RGB image."""
    red, green, blue = channels
    rows = b""
    for line in zip(red, green, blue, strict=True):
        rows += b"\0" + bytes(value for pixel in zip(*line, strict=True) for value in pixel)
    header = struct.pack(">IIBBBBB", len(red[0]), len(red), 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
