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
        sensors: Names of the vector observations, in the order of ``Agents.observations``.
        discrete_branches: How many choices each branch of an action has; none without discrete actions.
    """

    name: str
    continuous_actions: int
    sensors: tuple[str, ...]
    discrete_branches: tuple[int, ...] = ()


@dataclass(frozen=True)
class Agents:
    """Agents of one behavior, a row each: in a message of ours, those that ended stand before those that decide.

    Attributes:
        ids: An agent's own for its life, over all its episodes; from 0; (n,) int32.
        rewards: Since the agent's last batch, (n,) float32.
        done: Whose episode ended, with its last observation and reward, (n,) bool.
        interrupted: Which of those a step limit cut, (n,) bool.
        observations: One per sensor, (n, *shape) float32; a vector's are (n, size).
        group_ids: The groups that agents play in, (n,) int32; 0 for an agent on its own.
        group_rewards: What the agent's group got since its last batch, apart from ``rewards``, (n,) float32.
        masks: One per discrete branch, (n, choices) bool, True for a choice that is forbidden; empty if none is.
        images: (n, height, width, 3) uint8; None without a camera.
    """

    ids: NDArray[np.int32]
    rewards: NDArray[np.float32]
    done: NDArray[np.bool_]
    interrupted: NDArray[np.bool_]
    observations: tuple[NDArray[np.float32], ...]
    group_ids: NDArray[np.int32]
    group_rewards: NDArray[np.float32]
    masks: tuple[NDArray[np.bool_], ...] = ()
    images: NDArray[np.uint8] | None = None

    @classmethod
    def ungrouped(
        cls,
        ids: NDArray[np.int32],
        rewards: NDArray[np.float32],
        done: NDArray[np.bool_],
        interrupted: NDArray[np.bool_],
        observations: tuple[NDArray[np.float32], ...],
        images: NDArray[np.uint8] | None = None,
    ) -> "Agents":
        """Agents each on its own, whose choices are all allowed."""
        groups, group_rewards = np.zeros(len(ids), np.int32), np.zeros(len(ids), np.float32)
        return cls(ids, rewards, done, interrupted, observations, groups, group_rewards, images=images)

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
        return Agents(
            self.ids[rows],
            self.rewards[rows],
            self.done[rows],
            self.interrupted[rows],
            tuple(each[rows] for each in self.observations),
            self.group_ids[rows],
            self.group_rewards[rows],
            tuple(each[rows] for each in self.masks),
            None if self.images is None else self.images[rows],
        )
