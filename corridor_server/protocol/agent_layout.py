"""What an agent's row in a message can look like: which fields it has, in which bytes they stand."""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents
from corridor_server.protocol.row_template import Column, RowTemplate
from corridor_server.protocol.varints import LONGEST, byte_counts, varint_size
from corridor_server.protocol.wire_bytes import length_delimited, varint

# Tags of AgentInfoProto's fields.
_REWARD, _DONE, _INTERRUPTED, _ID, _MASK, _GROUP, _GROUP_REWARD = 0x3D, 0x40, 0x48, 0x50, 0x5A, 0x70, 0x7D


class Sensor(NamedTuple):
    """A vector observation, or a buffer of vectors, as it describes itself in every message.

    Attributes:
        name: Its name.
        shape: Of its numbers.
        dimension_properties: One per dimension (DimensionProperty), or none.
        kind: ObservationTypeProto: 0, or 1 for a goal signal.
    """

    name: str
    shape: tuple[int, ...]
    dimension_properties: tuple[int, ...]
    kind: int = 0


class Layout(NamedTuple):
    """Which fields a row has."""

    reward: bool
    done: bool
    interrupted: bool
    id_bytes: int
    masked: bool
    group_bytes: int
    group_reward: bool


@dataclass(frozen=True)
class AgentRow:
    """One way that a row can look."""

    template: RowTemplate
    layout: Layout


class AgentLayouts:
    """All the ways that the rows of one behavior's agents can look.

    Args:
        sensors: Of every agent, in their order.
        branches: How many choices each discrete branch has.

    Attributes:
        shapes: Of the observations, by their columns' names.
        branches: Where each branch's choices stand among all.
        choices: Of all branches together.
    """

    def __init__(self, sensors: tuple[Sensor, ...], branches: tuple[int, ...] = ()) -> None:
        self.shapes = {_observation_name(number): sensor.shape for number, sensor in enumerate(sensors)}
        ends = itertools.accumulate(branches)
        self.branches = [slice(end - size, end) for size, end in zip(branches, ends, strict=True)]
        self.choices = sum(branches)
        self._mask_start = bytes((_MASK,)) + varint(self.choices)
        self._observations: list[bytes | Column] = []
        for number, sensor in enumerate(sensors):
            self._observations += _observation(number, sensor)
        self._observation_bytes = sum(
            len(part) if isinstance(part, bytes) else 4 * math.prod(part.shape) for part in self._observations
        )
        self._rows: dict[Layout, AgentRow] = {}
        self._of_keys: dict[int, AgentRow] = {}

    def _row(self, layout: Layout) -> AgentRow:
        row = self._rows.get(layout)
        if row is None:
            row = self._rows[layout] = AgentRow(RowTemplate(self._parts(layout)), layout)
        return row

    def _parts(self, layout: Layout) -> list[bytes | Column]:
        parts: list[bytes | Column] = []
        if layout.reward:
            parts += [bytes((_REWARD,)), Column("reward", "<f4")]
        if layout.done:
            parts.append(bytes((_DONE, 1)))
        if layout.interrupted:
            parts.append(bytes((_INTERRUPTED, 1)))
        if layout.id_bytes:
            parts += [bytes((_ID,)), Column("id", "u1", (layout.id_bytes,), varint=True)]
        if layout.masked:
            parts += [self._mask_start, Column("mask", "u1", (self.choices,))]
        parts += self._observations
        if layout.group_bytes:
            parts += [bytes((_GROUP,)), Column("group", "u1", (layout.group_bytes,), varint=True)]
        if layout.group_reward:
            parts += [bytes((_GROUP_REWARD,)), Column("group_reward", "<f4")]
        return parts

    def of_key(self, key: int) -> AgentRow:
        """That of a row with this one of ``layout_keys``."""
        row = self._of_keys.get(key)
        if row is None:
            row = self._of_keys[key] = self._row(_layout(key))
        return row

    def like(self, row: bytes) -> AgentRow | None:
        """The layout that a row has, going by its tags; None if there is none of its length."""
        try:
            offset = 1 + varint_size(row, 1)
            reward = row[offset] == _REWARD
            offset += 5 * reward
            done = row[offset] == _DONE
            offset += 2 * done
            interrupted = row[offset] == _INTERRUPTED
            offset += 2 * interrupted
            id_bytes = varint_size(row, offset + 1) if row[offset] == _ID else 0
            offset += id_bytes + (id_bytes > 0)
            masked = self.choices > 0 and row.startswith(self._mask_start, offset)
            offset += masked * (len(self._mask_start) + self.choices) + self._observation_bytes
            group_bytes = varint_size(row, offset + 1) if offset < len(row) and row[offset] == _GROUP else 0
            offset += group_bytes + (group_bytes > 0)
        except IndexError:
            return None
        if id_bytes > LONGEST or group_bytes > LONGEST:
            return None
        found = self._row(Layout(reward, done, interrupted, id_bytes, masked, group_bytes, offset < len(row)))
        return found if found.template.size == len(row) else None


def _observation_name(number: int) -> str:
    return f"observation {number}"


def _observation(number: int, sensor: Sensor) -> list[bytes | Column]:
    """An agent's field 13, an ObservationProto of uncompressed numbers."""
    size = 4 * math.prod(sensor.shape)
    floats = Column(_observation_name(number), "<f4", sensor.shape)
    before = length_delimited(1, b"".join(varint(each) for each in sensor.shape))
    data_start = b"\x0a" + varint(size)
    before += b"\x22" + varint(len(data_start) + size) + data_start
    properties = b"".join(varint(each) for each in sensor.dimension_properties)
    after = length_delimited(6, properties) if properties else b""
    after += b"\x38" + varint(sensor.kind) if sensor.kind else b""
    after += length_delimited(8, sensor.name.encode()) if sensor.name else b""
    return [b"\x6a" + varint(len(before) + size + len(after)) + before, floats, after]


def layout_keys(agents: Agents) -> NDArray[np.intp]:
    """A number per agent for its row's layout: see ``_layout``."""
    keys = byte_counts(agents.ids) << 4  # how many bytes the id has
    keys += agents.rewards.view(np.int32) != 0  # protobuf goes by the bits: -0.0 is written
    if agents.masks:
        keys += 8
    for weight, flags in ((2, agents.done), (4, agents.interrupted)):
        if np.count_nonzero(flags):
            keys += weight * flags
    if np.count_nonzero(agents.group_ids):
        keys += byte_counts(agents.group_ids) << 7
    group_rewards = agents.group_rewards.view(np.int32)
    if np.count_nonzero(group_rewards):
        keys += (group_rewards != 0).astype(np.intp) << 10
    return keys


def _layout(key: int) -> Layout:
    return Layout(
        reward=bool(key & 1),
        done=bool(key & 2),
        interrupted=bool(key & 4),
        masked=bool(key & 8),
        id_bytes=key >> 4 & 7,
        group_bytes=key >> 7 & 7,
        group_reward=bool(key >> 10 & 1),
    )
