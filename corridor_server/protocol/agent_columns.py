"""Agents that are being read from a message, as columns that are being filled."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agent_layout import AgentRow
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.varints import LARGEST, number_in, numbers_in

_VARINTS = ("id", "group")


class AgentColumns:
    """Agents that are being read, row by row and run by run.

    Args:
        count: How many there will be.
        shapes: Of the observations, by their columns' names.
        choices: Of all discrete branches together.
    """

    def __init__(self, count: int, shapes: dict[str, tuple[int, ...]], choices: int) -> None:
        self._ids, self._groups = np.zeros(count, np.int32), np.zeros(count, np.int32)
        self._done, self._interrupted = np.zeros((2, count), np.bool_)
        self._observations = {name: np.empty((count, *shape), np.float32) for name, shape in shapes.items()}
        self._values: dict[str, NDArray[Any]] = {
            "reward": np.zeros(count, np.float32),
            "group_reward": np.zeros(count, np.float32),
            "mask": np.zeros((count, choices), np.uint8),
            **self._observations,
        }
        self._views: dict[str, memoryview] = {}

    def put(self, at: int, row: AgentRow, values: tuple[bytes, ...]) -> bool:
        """Takes up one row, as number ``at``; returns whether its numbers can be what they say."""
        for name, value in zip(row.template.names, values, strict=True):
            if name in _VARINTS:
                number = number_in(value)
                if number > LARGEST:
                    return False
                (self._ids if name == "id" else self._groups)[at] = number
            else:
                width = len(value)
                self._bytes(name)[at * width : (at + 1) * width] = value
        if row.layout.done:
            self._done[at] = True
        if row.layout.interrupted:
            self._interrupted[at] = True
        return True

    def _bytes(self, name: str) -> memoryview:
        """A column's bytes, to be written into: much quicker for one row than an array."""
        view = self._views.get(name)
        if view is None:
            view = self._views[name] = self._values[name].data.cast("B")
        return view

    def put_run(self, places: Any, row: AgentRow, rows: NDArray[np.void]) -> bool:
        """Takes up rows of one layout, as the numbers ``places``; returns whether they can be what they say."""
        for name in row.template.names:
            if name in _VARINTS:
                numbers = numbers_in(rows[name])
                if numbers is None:
                    return False
                (self._ids if name == "id" else self._groups)[places] = numbers
            else:
                self._values[name][places] = rows[name]
        if row.layout.done:
            self._done[places] = True
        if row.layout.interrupted:
            self._interrupted[places] = True
        return True

    def agents(self, branches: list[slice]) -> Agents | None:
        """All of them; None if a mask isn't made of 0 and 1."""
        mask = self._values["mask"]
        if mask.size and mask.max() > 1:
            return None
        return Agents(
            self._ids,
            self._values["reward"],
            self._done,
            self._interrupted,
            tuple(self._observations.values()),
            self._groups,
            self._values["group_reward"],
            tuple(mask[:, branch].astype(np.bool_) for branch in branches),
        )
