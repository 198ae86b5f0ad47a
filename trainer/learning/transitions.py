"""What agents saw, did and got, as a learner takes it, and advantages along their trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Indices = NDArray[np.intp]
_FIRST_CAPACITY = 1024


class Observed(NamedTuple):
    """What agents observe, a row each, as a policy takes it.

    Attributes:
        observations: One per sensor, (n, *shape) float32.
        allowed: Choices of all branches that may be taken, (n, choices) bool; None where all may.
    """

    observations: tuple[Singles, ...]
    allowed: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.observations[0])


def joined(parts: Sequence[Observed]) -> Observed:
    """What several groups of agents observe, one after another; where only some have masks, the others may do all."""
    if len(parts) == 1:
        return parts[0]
    observations = tuple(np.concatenate(each) for each in zip(*(part.observations for part in parts), strict=True))
    choices = [part.allowed.shape[1] for part in parts if part.allowed is not None]
    if not choices:
        return Observed(observations)
    masks = [np.ones((len(part), choices[0]), np.bool_) if part.allowed is None else part.allowed for part in parts]
    return Observed(observations, np.concatenate(masks))


class Decided(NamedTuple):
    """What a policy chose, a row each.

    Attributes:
        continuous: (n, size) float32, before clipping.
        discrete: (n, branches) int64.
        log_probs: (n,) float32.
    """

    continuous: Singles
    discrete: NDArray[np.int64]
    log_probs: Singles

    def rows(self, part: slice) -> "Decided":
        """Some of them."""
        return Decided(self.continuous[part], self.discrete[part], self.log_probs[part])


@dataclass(frozen=True)
class Transitions:
    """Closed transitions, in the order in which they began.

    Attributes:
        observations: Every observation that is among them once, of each sensor (m, *shape) float32: most of what was
            seen then was acted on next.
        seen: Where what the agents saw is in them, (n,).
        next_seen: Where what they saw then is, (n,); at an episode's end its own last observation.
        allowed: Choices that they had, (n, choices) bool; None where all were allowed.
        decided: What they did.
        rewards: Of the environment, an agent's own and its group's, (n,) float32.
        previous: The transition before in the same trajectory, (n,); -1 where one begins.
        episodes: A number for each agent's episode, (n,).
        terminated: Whether the episode ended with it and nothing was to follow, (n,) bool: no time limit cut it.
    """

    observations: tuple[Singles, ...]
    seen: Indices
    next_seen: Indices
    allowed: NDArray[np.bool_] | None
    decided: Decided
    rewards: Singles
    previous: Indices
    episodes: Indices
    terminated: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def observed(self) -> tuple[Singles, ...]:
        """What the agents saw, of each sensor (n, *shape); copies."""
        return tuple(each[self.seen] for each in self.observations)

    @property
    def next_observed(self) -> tuple[Singles, ...]:
        """What they saw then, of each sensor (n, *shape); copies."""
        return tuple(each[self.next_seen] for each in self.observations)


class EndedEpisode(NamedTuple):
    """An episode that ended.

    Attributes:
        number: As in ``Transitions.episodes``.
        total: Its rewards' sum.
        length: Its transitions.
    """

    number: int
    total: float
    length: int


def advantages(
    previous: Indices, rewards: Singles, values: Singles, next_values: Singles, gamma: float, lambd: float
) -> Singles:
    """Generalised advantage estimation along every trajectory, (n,) float32.

    Args:
        previous: Of each transition the one before; see ``Transitions``.
        rewards: (n,).
        values: Of what was seen, (n,).
        next_values: Of what was seen then, (n,); 0 where nothing more is to come.
        gamma: Discount factor.
        lambd: Lambda.
    """
    deltas = rewards + gamma * next_values - values
    estimates, factor = deltas.astype(np.float64).tolist(), gamma * lambd
    for index, before in zip(range(len(estimates) - 1, -1, -1), reversed(previous.tolist()), strict=True):
        if before >= 0:
            estimates[before] += factor * estimates[index]
    return np.array(estimates, np.float32)


class Rows:
    """An array that grows by rows.

    Args:
        shape: Of a row.
        dtype: Of its numbers.
    """

    def __init__(self, shape: Sequence[int], dtype: Any = np.float32) -> None:
        self.shape = tuple(shape)
        self.values = np.empty((_FIRST_CAPACITY if np.prod(shape, dtype=int) < 1000 else 16, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def used(self) -> NDArray[Any]:
        """What was appended; a view."""
        return self.values[: self._count]

    def append(self, rows: NDArray[Any]) -> None:
        """Adds these."""
        end = self._count + len(rows)
        if end > len(self.values):
            grown = np.empty((max(end, 2 * len(self.values)), *self.shape), self.values.dtype)
            grown[: self._count] = self.used
            self.values = grown
        self.values[self._count : end] = rows
        self._count = end

    def fill(self, rows: NDArray[Any]) -> None:
        """Begins with these."""
        self._count = 0
        self.append(rows)

    def keep(self, rows: Indices) -> None:
        """Leaves these rows, in this order."""
        self.values[: len(rows)] = self.values[rows]
        self._count = len(rows)
