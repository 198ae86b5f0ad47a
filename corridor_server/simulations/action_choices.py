"""Gymnasium's action spaces as continuous numbers and discrete branches, and a trainer's actions back."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch
from corridor_server.simulations.simulation import MOST_CHOICES, SimulationError

Read = Callable[[ActionBatch], Any]  # the batched action that a trainer's are


class ActionChoices:
    """How actions of one space travel.

    A Box's numbers are continuous: -1 and 1 are its bounds, and a number without bounds is itself. Discrete,
    MultiDiscrete and MultiBinary are branches. Of a Dict or Tuple, all of both are.

    Args:
        space: Of one agent's action.
        owner: Whose it is, for errors.

    Attributes:
        continuous: How many numbers.
        branches: How many choices each branch has.

    Raises:
        SimulationError: A part can't be carried.
    """

    def __init__(self, space: spaces.Space[Any], owner: str) -> None:
        self.continuous = 0
        self.branches: tuple[int, ...] = ()
        self._owner = owner
        self._read = self._reader(space, "the action")
        if self.continuous + len(self.branches) == 0:
            raise SimulationError(f"{owner} does nothing: an action of at least one number or choice was expected.")
        if self.continuous + sum(self.branches) > MOST_CHOICES:
            raise SimulationError(
                f"{owner} has {self.continuous} numbers and {sum(self.branches)} choices in an action, but at most "
                f"{MOST_CHOICES} can be carried."
            )

    def read(self, actions: ActionBatch) -> Any:
        """The actions as a vector environment's ``step`` takes them: a batch of the space's."""
        return self._read(actions)

    def allowed(self, said: Sequence[Any]) -> NDArray[np.bool_]:
        """What agents may choose, (n, choices of all branches), of the masks in their infos.

        Args:
            said: 1 for a choice that is allowed, in an array or in one per branch; None says nothing, and allows all.

        Raises:
            SimulationError: One has another number of choices.
        """
        allowed = np.ones((len(said), sum(self.branches)), np.bool_)
        for row, given in enumerate(said):
            if given is not None:
                mask = np.hstack(given)
                self.check_mask(mask)
                allowed[row] = mask
        return allowed

    def forbidden(
        self, allowed: NDArray[Any], ids: NDArray[np.int32], ended: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], ...]:
        """Masks as they travel, an array per branch, of those that environments give.

        Args:
            allowed: 1 for a choice that is allowed, (n, choices of all branches).
            ids: The agents'.
            ended: Who chooses no more, and is forbidden nothing.

        Raises:
            SimulationError: It has another number of choices, or allows an agent none of a branch.
        """
        for mask in allowed[:1]:
            self.check_mask(mask)
        forbidden = (allowed == 0) & ~ended[:, None]
        masks = tuple(np.split(forbidden, np.cumsum(self.branches)[:-1].tolist(), axis=1))
        for branch, mask in enumerate(masks):
            for row in np.flatnonzero(mask.all(axis=1))[:1]:
                raise SimulationError(
                    f"The environment gave agent {ids[row]} an action_mask that forbids all choices of branch "
                    f"{branch}, but at least one that is allowed was expected: no policy can answer it."
                )
        return masks

    def check_mask(self, allowed: NDArray[Any]) -> None:
        """Refuses one agent's mask of another number of choices.

        Raises:
            SimulationError: It has another one.
        """
        if allowed.shape != (sum(self.branches),):
            raise SimulationError(
                f"The environment gave an action_mask of shape {allowed.shape}, but one value for each of its "
                f"{sum(self.branches)} choices was expected."
            )

    def _reader(self, space: spaces.Space[Any], name: str) -> Read:
        match space:
            case spaces.Dict():
                by_key = {key: self._reader(part, f"{name}[{key!r}]") for key, part in space.spaces.items()}
                return lambda actions: {key: read(actions) for key, read in by_key.items()}
            case spaces.Tuple():
                in_order = [self._reader(part, f"{name}[{index}]") for index, part in enumerate(space.spaces)]
                return lambda actions: tuple(read(actions) for read in in_order)
            case spaces.Box() if space.dtype is not None and space.dtype.kind == "f":
                return self._numbers(space)
            case spaces.Discrete():
                choice = self._choices((int(space.n),))
                return lambda actions: choice(actions)[:, 0].astype(space.dtype) + space.start
            case spaces.MultiDiscrete():
                choices = self._choices(tuple(space.nvec.ravel().tolist()))
                return lambda actions: choices(actions).reshape(-1, *space.shape).astype(space.dtype) + space.start
            case spaces.MultiBinary():
                flags = self._choices((2,) * int(np.prod(space.shape)))
                return lambda actions: flags(actions).reshape(-1, *space.shape).astype(space.dtype)
        of_what = f" of {space.dtype}" if isinstance(space, spaces.Box) else ""
        raise SimulationError(
            f"{self._owner} has {name} as {type(space).__name__}{of_what}, which can't be carried: only Box of floats, "
            "Discrete, MultiDiscrete and MultiBinary, and Dict and Tuple of them, can; change it with a wrapper."
        )

    def _numbers(self, space: spaces.Box) -> Read:
        mine = slice(self.continuous, self.continuous + int(np.prod(space.shape)))
        self.continuous = mine.stop
        low, high = space.low.ravel().astype(np.float64), space.high.ravel().astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            width = high - low
            bounded = np.isfinite(width)  # float64's largest are no bounds, either
            middle, half = np.where(bounded, low + width / 2, 0.0), np.where(bounded, width / 2, 1.0)

        def read(actions: ActionBatch) -> NDArray[Any]:
            numbers = actions.continuous[:, mine].astype(np.float64)
            within = np.where(bounded, np.clip(numbers, -1, 1), numbers)
            scaled: NDArray[Any] = np.clip(middle + half * within, low, high).astype(space.dtype)
            return scaled.reshape(-1, *space.shape)

        return read

    def _choices(self, sizes: tuple[int, ...]) -> Callable[[ActionBatch], NDArray[np.int32]]:
        mine = slice(len(self.branches), len(self.branches) + len(sizes))
        self.branches = (*self.branches, *sizes)
        return lambda actions: actions.discrete[:, mine]
