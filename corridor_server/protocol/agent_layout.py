"""What an agent's row in a message can look like: which fields it has, in which bytes they stand."""

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

from corridor_server.protocol.agents import Sensor
from corridor_server.protocol.row_template import Column, Parts, RowTemplate, example, repeated
from corridor_server.protocol.varints import LONGEST, varint_size
from corridor_server.protocol.wire_bytes import length_delimited, varint

# Tags of AgentInfoProto's fields.
_REWARD, _DONE, _INTERRUPTED, _ID, _MASK, _GROUP, _GROUP_REWARD = 0x3D, 0x40, 0x48, 0x50, 0x5A, 0x70, 0x7D


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
        self._observations: Parts = []
        for number, sensor in enumerate(sensors):
            self._observations += _observation(number, sensor)
        self._observation_bytes = len(example(self._observations))
        self._rows: dict[Layout, AgentRow] = {}

    def _row(self, layout: Layout) -> AgentRow:
        row = self._rows.get(layout)
        if row is None:
            parts = [part for field in self.fields(layout) for part in field]
            row = self._rows[layout] = AgentRow(repeated(parts), layout)
        return row

    def fields(self, layout: Layout) -> list[Parts]:
        """A row's fields, in order; an empty one for each that the layout doesn't have."""
        reward: Parts = [bytes((_REWARD,)), Column("reward", "<f4")]
        identity: Parts = [bytes((_ID,)), Column("id", "u1", (layout.id_bytes,), varint=True)]
        mask: Parts = [self._mask_start, Column("mask", "u1", (self.choices,))]
        group: Parts = [bytes((_GROUP,)), Column("group", "u1", (layout.group_bytes,), varint=True)]
        group_reward: Parts = [bytes((_GROUP_REWARD,)), Column("group_reward", "<f4")]
        return [
            reward if layout.reward else [],
            [bytes((_DONE, 1))] if layout.done else [],
            [bytes((_INTERRUPTED, 1))] if layout.interrupted else [],
            identity if layout.id_bytes else [],
            mask if layout.masked else [],
            self._observations,
            group if layout.group_bytes else [],
            group_reward if layout.group_reward else [],
        ]

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


def _observation(number: int, sensor: Sensor) -> Parts:
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
