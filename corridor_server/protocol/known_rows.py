"""Rows that have the same agents and fields as those of an earlier message: most messages of agents in lockstep."""

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents

REWARD, GROUP_REWARD, FIRST_OBSERVATION, VARYING = 1, 2, 3, 255  # marks of bytes that vary; others don't


class KnownRows:
    """Reads and writes rows that differ from earlier ones in nothing but rewards and observations.

    Args:
        rows: The earlier ones, as protobuf writes them.
        agents: What they are: all decide, and no choice of theirs is forbidden.
        marks: A byte for each of theirs: 0 for a constant, ``REWARD`` and so on for a value's first byte, ``VARYING``
            for its others.
    """

    def __init__(self, rows: bytes, agents: Agents, marks: NDArray[np.uint8]) -> None:
        self._ids, self._groups = agents.ids.copy(), agents.group_ids.copy()
        self._branches = [mask.shape[1] for mask in agents.masks]
        self._mask = np.where(marks == 0, 0xFF, 0).astype(np.uint8)
        self._constants = (np.frombuffer(rows, np.uint8) & self._mask).tobytes()
        columns = enumerate((agents.rewards, agents.group_rewards, *agents.observations), REWARD)
        self._columns = [_KnownColumn(marks == mark, mark < FIRST_OBSERVATION, values) for mark, values in columns]

    def read(self, data: bytes, start: int) -> Agents | None:
        """The agents in as many bytes from ``start`` on; None if something else differs."""
        rows = np.frombuffer(data, np.uint8, len(self._mask), start)
        if (rows & self._mask).tobytes() != self._constants:
            return None
        count = len(self._ids)
        rewards, group_rewards, *observations = [column.read(data, start, len(rows)) for column in self._columns]
        done, interrupted = np.zeros((2, count), np.bool_)
        masks = tuple(np.zeros((count, choices), np.bool_) for choices in self._branches)
        ids, groups = self._ids.copy(), self._groups.copy()
        return Agents(ids, rewards, done, interrupted, tuple(observations), groups, group_rewards, masks)

    def write(self, agents: Agents) -> bytes | None:
        """The rows' bytes; None if these agents differ in something else."""
        if agents.masks or np.count_nonzero(agents.done) or np.count_nonzero(agents.interrupted):
            return None
        if agents.ids.tobytes() != self._ids.tobytes() or agents.group_ids.tobytes() != self._groups.tobytes():
            return None
        data = bytearray(self._constants)
        columns = (agents.rewards, agents.group_rewards, *agents.observations)
        written = [column.write(data, values) for column, values in zip(self._columns, columns, strict=True)]
        return bytes(data) if all(written) else None


class _KnownColumn:
    """Where a column's values are among the rows' bytes, for those rows that have one."""

    def __init__(self, marked: NDArray[np.bool_], optional: bool, values: NDArray[np.float32]) -> None:
        self._starts = marked.nonzero()[0]
        self._shape = values.shape
        self._optional = optional  # rows without the field have 0, by the bits
        self._present = None if len(self._starts) == len(values) else values.view(np.int32) != 0
        self._bytes = values[:1].nbytes
        self._window = np.dtype(f"V{self._bytes}")

    def _windows(self, data: bytes | bytearray, start: int, length: int) -> NDArray[np.void]:
        return np.ndarray((length - self._bytes + 1,), self._window, data, start, (1,))

    def write(self, data: bytearray, values: NDArray[np.float32]) -> bool:
        """Returns whether the same rows have the field."""
        if self._optional:
            bits = values.view(np.int32)
            if np.count_nonzero(bits) != len(self._starts):
                return False
            if self._present is not None:
                if not np.array_equal(bits != 0, self._present):
                    return False
                values = values[self._present]
        if len(self._starts):
            contiguous = np.ascontiguousarray(values).reshape(-1)
            self._windows(data, 0, len(data))[self._starts] = contiguous.view(self._window)
        return True

    def read(self, data: bytes, start: int, length: int) -> NDArray[np.float32]:
        if not len(self._starts):
            return np.zeros(self._shape, np.float32)
        found = self._windows(data, start, length)[self._starts].view(np.float32)
        if self._present is None:
            return found.reshape(self._shape)
        values = np.zeros(self._shape, np.float32)
        values[self._present] = found
        return values
