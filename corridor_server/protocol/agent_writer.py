"""Agents to a message's bytes, the same that protobuf writes: rows of every field, less those that a row hasn't."""

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agent_layout import AgentLayouts, Layout
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.row_template import FIELD_1, RowTemplate, example
from corridor_server.protocol.varints import LONGEST, byte_counts
from corridor_server.protocol.wire_bytes import varint

_KEYS = 2**11  # of layouts: see ``_keys``
_PREFIX = 1 + 4  # bytes of a row's tag and length, at most: a message has 256 MiB


class AgentWriter:
    """Writes the agents of one behavior.

    Args:
        layouts: Of its rows.
    """

    def __init__(self, layouts: AgentLayouts) -> None:
        self._layouts = layouts
        fields = layouts.fields(Layout(True, True, True, LONGEST, layouts.choices > 0, LONGEST, True))
        self._widths = [_PREFIX, *(len(example(field)) for field in fields)]
        self._whole = RowTemplate([bytes(_PREFIX), *(part for field in fields for part in field)])
        # By a layout's index: its rows' constant bytes, and which of all bytes its rows have.
        self._constants = np.empty((0, self._whole.size), np.uint8)
        self._present = np.empty((0, self._whole.size), np.bool_)
        self._index = np.full(_KEYS, -1, np.intp)

    def write(self, agents: Agents) -> bytes:
        """The rows' bytes.

        Args:
            agents: Ids and group ids are not negative; masks are written if there are any.
        """
        if not len(agents):
            return b""
        index = self._indices(agents)
        raw = self._constants.take(index, axis=0)  # several times as fast as indexing
        self._fill(raw.reshape(-1).view(self._whole.dtype), agents)
        return raw[self._present.take(index, axis=0)].tobytes()

    def _indices(self, agents: Agents) -> NDArray[np.intp]:
        """Of the agents' layouts."""
        keys = _keys(agents)
        index = self._index[keys]
        if index.min() < 0:
            for key in set(keys[index < 0].tolist()):
                self._learn(key)
            index = self._index[keys]
        return index

    def _fill(self, rows: NDArray[np.void], agents: Agents) -> None:
        rows["reward"] = agents.rewards
        _add_numbers(rows["id"], agents.ids)
        if agents.masks:
            rows["mask"] = np.concatenate(agents.masks, axis=1)
        for name, values in zip(self._layouts.shapes, agents.observations, strict=True):
            rows[name] = values
        if np.count_nonzero(agents.group_ids):
            _add_numbers(rows["group"], agents.group_ids)
        rows["group_reward"] = agents.group_rewards

    def _learn(self, key: int) -> None:
        """Takes up a layout."""
        fields = [example(field) for field in self._layouts.fields(_layout(key))]
        fields.insert(0, FIELD_1 + varint(sum(map(len, fields))))
        pairs = list(zip(fields, self._widths, strict=True))
        constants = b"".join(field.ljust(width, b"\0") for field, width in pairs)
        present = b"".join((b"\1" * len(field)).ljust(width, b"\0") for field, width in pairs)
        self._index[key] = len(self._constants)
        self._constants = np.vstack([self._constants, np.frombuffer(constants, np.uint8)])
        self._present = np.vstack([self._present, np.frombuffer(present, np.bool_)])


def _add_numbers(groups: NDArray[np.uint8], numbers: NDArray[np.int32]) -> None:
    """Writes numbers' seven bits each into varints whose highest bits are there already."""
    groups[:, 0] |= (numbers & 0x7F).astype(np.uint8)
    for index in range(1, LONGEST):
        rest = numbers >> 7 * index
        if not np.count_nonzero(rest):
            break
        groups[:, index] |= (rest & 0x7F).astype(np.uint8)


def _keys(agents: Agents) -> NDArray[np.intp]:
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
