"""Random streams of training areas, whose states can be written down and taken up again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

WORDS = 6  # of 64 bits: PCG64's state and increment, two each, and the half of a word that it may have kept
LOW = 2**64 - 1


def area_generator(seed: int, area: int) -> np.random.Generator:
    """The random stream of one area: depends on seed and area only, not on how many areas there are.

    Args:
        seed: Any whole number from 0, kept whole; or a negative one of those that the protocol carries, an int32.
        area: Its number.

    Raises:
        ValueError: The seed is neither.
    """
    if seed < -(2**31):
        raise ValueError(f"The seed is {seed}, but a whole number from {-(2**31)} up was expected.")
    entropy = seed if seed >= 0 else seed + 2**32
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy, spawn_key=(area,))))


class Streams:
    """One random stream per area.

    Args:
        seed: Of them all.
        areas: The areas' numbers.
    """

    def __init__(self, seed: int, areas: Sequence[int]) -> None:
        self._generators = [area_generator(seed, area) for area in areas]
        self._words = np.zeros((len(self._generators), WORDS), np.uint64)
        self._moved = np.ones(len(self._generators), np.bool_)

    def __getitem__(self, row: int) -> np.random.Generator:
        """The generator of the area in this row, to draw from."""
        self._moved[row] = True
        return self._generators[row]

    def words(self) -> NDArray[np.uint64]:
        """Every stream's state, (A, 6)."""
        for row in np.flatnonzero(self._moved):  # few since the last time: a stream is drawn from once per episode
            state = self._generators[row].bit_generator.state
            numbers = state["state"]["state"], state["state"]["inc"]
            halves = [half for number in numbers for half in (number >> 64, number & LOW)]
            self._words[row] = [*halves, state["has_uint32"], state["uinteger"]]
        self._moved[:] = False
        return self._words

    def restore(self, words: NDArray[np.uint64]) -> None:
        """Takes up states that ``words`` gave, (A, 6)."""
        for generator, (*halves, kept, half) in zip(self._generators, words.tolist(), strict=True):
            generator.bit_generator.state = {
                "bit_generator": "PCG64",
                "state": {"state": halves[0] << 64 | halves[1], "inc": halves[2] << 64 | halves[3]},
                "has_uint32": kept,
                "uinteger": half,
            }
        self._moved[:] = True
