"""Gymnasium's observation spaces as sensors: which part goes where, and batches of observations as arrays."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import concatenate, create_empty_array
from numpy.typing import NDArray

from corridor_server.protocol.agents import Sensor
from corridor_server.simulations.finite_numbers import check_finite, float32
from corridor_server.simulations.simulation import MOST_NUMBERS, SimulationError

ACTION_MASK = "action_mask"  # what environments call it: 1 for a choice that is allowed
WHOLE = "observation"  # the sensor's name where there is one
_BYTE = 255

Path = tuple[str | int, ...]


@dataclass(frozen=True)
class _Part:
    """A part of an observation that is one sensor's."""

    path: Path
    sensor: Sensor
    read: Callable[[NDArray[Any]], NDArray[Any]]


class ObservationSensors:
    """How observations of one space travel.

    A vector, buffer of vectors or picture (height, width, channels) is a Box of as many dimensions; only a uint8
    picture with all of 0 to 255 stays bytes. Discrete parts are one-hot. Parts of a Dict or Tuple are a sensor each,
    but a Dict's ``action_mask`` is none, be it an array or a Dict or Tuple of one for each branch.

    Args:
        space: Of one agent's observation.
        owner: Whose it is, for errors.

    Raises:
        SimulationError: A part can't be carried.
    """

    def __init__(self, space: spaces.Space[Any], owner: str) -> None:
        found = dict(_leaves(space, ()))
        self._masks = [path for path in found if path[:1] == (ACTION_MASK,)]
        self._parts = [_part(path, leaf, owner) for path, leaf in found.items() if path not in self._masks]
        if not self._parts:
            raise SimulationError(f"{owner} observes nothing, but at least one vector or picture was expected.")
        self.sensors = tuple(part.sensor for part in self._parts)

    def read(self, batch: Any, ids: NDArray[np.int32]) -> tuple[NDArray[Any], ...]:
        """Observations as an array per sensor.

        Args:
            batch: Of them, as Gymnasium's vector environments have it.
            ids: The agents'.

        Raises:
            SimulationError: One is NaN, infinite or no float32.
        """
        return tuple(self._read(part, _at(batch, part.path), ids) for part in self._parts)

    def mask(self, batch: Any) -> NDArray[Any] | None:
        """Which choices the observations allow, (n, choices); None if they don't say."""
        each = [np.asarray(_at(batch, path)) for path in self._masks]
        if len(each) > 1:
            return np.concatenate([part.reshape(len(part), -1) for part in each], axis=1)
        return each[0] if each else None

    def _read(self, part: _Part, given: NDArray[Any], ids: NDArray[np.int32]) -> NDArray[Any]:
        values = part.read(given)
        if values.dtype == np.float32:
            check_finite(values, part.sensor.name, ids, given)
        return values


def batched(space: spaces.Space[Any], observations: Sequence[Any]) -> Any:
    """A batch of observations, as Gymnasium's vector environments have it, of the same space.

    Raises:
        ValueError: A part of one has another shape than the space, or numbers that the space's type can't hold.
    """
    count = len(observations)
    if space.shape is not None:  # no Dict or Tuple; one array is a third of the time of ``concatenate``
        with suppress(ValueError):  # they differ in their shapes
            batch = np.array(observations)
            if (batch.shape, batch.dtype) == ((count, *space.shape), space.dtype):
                return batch
    for observation in observations:
        check_parts(space, observation)
    into: Any = create_empty_array(space, count)
    with np.errstate(over="ignore", under="ignore"):
        return concatenate(space, observations, into)


def check_parts(space: spaces.Space[Any], observation: Any) -> None:
    """Refuses an observation of which a part has another shape than the space, or numbers that its type can't hold.

    Raises:
        ValueError: It has.
    """
    for path, part in _leaves(space, ()):
        values = np.asarray(_at(observation, path))
        if values.shape != part.shape:
            raise ValueError(f"{_named(path)} of shape {values.shape} came, but {part.shape} was expected")
        if part.dtype is None or values.dtype == part.dtype:
            continue
        if not np.can_cast(values.dtype, part.dtype, "same_kind"):
            raise ValueError(f"{_named(path)} of {values.dtype} came, but {part.dtype} was expected")
        if part.dtype.kind in "iu":
            for number in values[values.astype(part.dtype) != values].ravel()[:1]:
                raise ValueError(f"{_named(path)} has {number}, which {part.dtype} can't hold")


def _leaves(space: spaces.Space[Any], path: Path) -> Iterator[tuple[Path, spaces.Space[Any]]]:
    parts: Any = ()
    if isinstance(space, spaces.Dict):
        parts = space.spaces.items()
    elif isinstance(space, spaces.Tuple):
        parts = enumerate(space.spaces)
    else:
        yield path, space
    for key, part in parts:
        yield from _leaves(part, (*path, key))


def _at(batch: Any, path: Path) -> Any:
    for key in path:
        batch = batch[key]
    return batch


def _named(path: Path) -> str:
    return "/".join(map(str, path)) or WHOLE


def _part(path: Path, space: spaces.Space[Any], owner: str) -> _Part:
    name = _named(path)

    def refused(why: str) -> SimulationError:
        return SimulationError(
            f"{owner} observes {name} as {type(space).__name__}, which can't be carried: {why}; change or leave it out "
            "with a wrapper."
        )

    match space:
        case spaces.Box():
            shape = space.shape or (1,)
            if len(shape) > 3:
                raise refused(f"it has {len(shape)} dimensions, and an observation at most 3")
            if space.dtype is None or space.dtype.kind not in "fiub":
                raise refused(f"its numbers are {space.dtype}")
            read = _bytes if _is_picture_of_bytes(space) else _floats(shape)
        case spaces.Discrete():
            shape, read = (int(space.n),), _one_hot(name, np.array([int(space.n)]), np.array([int(space.start)]))
        case spaces.MultiDiscrete():
            sizes, starts = space.nvec.ravel().astype(np.int64), space.start.ravel().astype(np.int64)
            shape, read = (int(sizes.sum()),), _one_hot(name, sizes, starts)
        case spaces.MultiBinary():
            shape = (math.prod(space.shape),)
            read = _floats(shape)
        case _:
            raise refused("only Box, Discrete, MultiDiscrete and MultiBinary, and Dict and Tuple of them, can")
    if not 0 < math.prod(shape) <= MOST_NUMBERS:
        raise refused(f"it is {math.prod(shape)} numbers, and 1 to {MOST_NUMBERS} were expected")
    return _Part(path, Sensor.of(name, shape), read)


def _is_picture_of_bytes(space: spaces.Box) -> bool:
    whole_range = bool((space.low == 0).all() and (space.high == _BYTE).all())
    return len(space.shape) == 3 and space.dtype == np.uint8 and whole_range


def _bytes(values: NDArray[Any]) -> NDArray[Any]:
    return np.array(values, np.uint8)


def _floats(shape: tuple[int, ...]) -> Callable[[NDArray[Any]], NDArray[Any]]:
    def read(values: NDArray[Any]) -> NDArray[Any]:
        return float32(values).reshape(len(values), *shape)

    return read


def _one_hot(name: str, sizes: NDArray[np.int64], starts: NDArray[np.int64]) -> Callable[[NDArray[Any]], NDArray[Any]]:
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])

    def read(values: NDArray[Any]) -> NDArray[Any]:
        count = len(values)
        choices = np.asarray(values).astype(np.int64).reshape(count, -1) - starts
        for row, which in np.argwhere((choices < 0) | (choices >= sizes))[:1].tolist():  # it would be another's one
            low = int(starts[which])
            raise SimulationError(
                f"The environment gave {name} = {low + int(choices[row, which])}, but {low} to "
                f"{low + int(sizes[which]) - 1} were expected."
            )
        ones = np.zeros((count, int(sizes.sum())), np.float32)
        ones[np.arange(count)[:, None], choices + first] = 1
        return ones

    return read
