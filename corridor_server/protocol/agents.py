"""A batch of agents, in the one form that it has from a simulation to a trainer's decisions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Behavior:
    """What a trainer is told of agents that one policy plays.

    Attributes:
        name: With its team, such as ``Corridor?team=0``.
        continuous_actions: How many numbers an action has.
        observation: The vector observation's name.
    """

    name: str
    continuous_actions: int
    observation: str


@dataclass(frozen=True)
class Agents:
    """Agents of one behavior, a row each: in a message of ours, those that ended stand before those that decide.

    Attributes:
        ids: An agent's own for its life, over all its episodes; from 0; (n,) int32.
        rewards: Since the agent's last batch, (n,) float32.
        done: Whose episode ended, with its last observation and reward, (n,) bool.
        interrupted: Which of those a step limit cut, (n,) bool.
        observations: (n, size) float32.
        images: (n, height, width, 3) uint8; None without a camera.
    """

    ids: NDArray[np.int32]
    rewards: NDArray[np.float32]
    done: NDArray[np.bool_]
    interrupted: NDArray[np.bool_]
    observations: NDArray[np.float32]
    images: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def ended(self) -> "Agents":
        """Those whose episode ended; a view, where they stand first."""
        return self._part(done=True)

    @property
    def deciding(self) -> "Agents":
        """Those that ask for an action; a view, where they stand last."""
        return self._part(done=False)

    def _part(self, done: bool) -> "Agents":
        ended = np.count_nonzero(self.done)
        if ended == (len(self) if done else 0):
            return self
        if not ended or self.done[:ended].all():
            return self._rows(slice(0, ended) if done else slice(ended, None))
        return self._rows((self.done == done).nonzero()[0])  # a peer's message may have them in any order

    def _rows(self, rows: Any) -> "Agents":
        images = None if self.images is None else self.images[rows]
        return Agents(
            self.ids[rows],
            self.rewards[rows],
            self.done[rows],
            self.interrupted[rows],
            self.observations[rows],
            images,
        )
