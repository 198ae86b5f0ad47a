"""Eq. 10's observation by name: where each of its numbers stands, for the world that writes them and all readers.

The learner's own part comes first: p, V, p_g, d_g, sw_ind. Then each of the K opponents has a block (eq. 8): p_op,
d_op, V_op. Positions and distances are in half-lengths of the corridor, velocities in half-lengths per second, sw_ind
is 0 or 1; pairs are (x, z).
"""

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Number = TypeVar("Number", bound="np.generic")

POSITION = slice(0, 2)  # p
VELOCITY = slice(2, 4)  # V
GOAL = slice(4, 6)  # p_g
GOAL_DISTANCE = 6  # d_g
SWITCH = 7  # sw_ind
OWN_SIZE = 8

# In an opponent's block.
OPPONENT_POSITION = slice(0, 2)  # p_op
OPPONENT_DISTANCE = 2  # d_op
OPPONENT_VELOCITY = slice(3, 5)  # V_op
OPPONENT_SIZE = 5


def size(opponents: int) -> int:
    """Number of floats in an observation of K opponents."""
    return OWN_SIZE + OPPONENT_SIZE * opponents


def is_size(floats: int) -> bool:
    """Whether an observation of so many floats can be eq. 10's, with one opponent or more."""
    return floats >= size(1) and (floats - OWN_SIZE) % OPPONENT_SIZE == 0


def opponents(floats: int) -> int:
    """Number of opponents in an observation of so many floats: the inverse of ``size``."""
    return (floats - OWN_SIZE) // OPPONENT_SIZE


def opponent_blocks(observations: "NDArray[Number]") -> "NDArray[Number]":
    """The opponents' part of observations (..., 8 + 5K), as a view (..., K, 5)."""
    *leading, floats = observations.shape
    return observations[..., OWN_SIZE:].reshape(*leading, opponents(floats), OPPONENT_SIZE)
