"""An author's numbers as float32, of which none may be NaN or infinite."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.simulations.simulation import SimulationError


def float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """A copy; what is too large becomes infinite, and what is too small 0, whatever an author has NumPy do then."""
    with np.errstate(over="ignore", under="ignore"):
        return np.array(values, np.float32)


def check_finite(
    values: NDArray[Any],
    what: str,
    ids: NDArray[np.int32],
    given: NDArray[Any] | None = None,
    behavior: str | None = None,
) -> None:
    """Refuses NaN and infinity.

    Args:
        values: A row per agent.
        what: They are, for the error.
        ids: The agents'.
        given: What they were made of, number by number.
        behavior: The agents', for the error, where a simulation of somebody's own has several.

    Raises:
        SimulationError: There is one.
    """
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < finite.size:
        row, *place = np.argwhere(~finite)[0].tolist()
        where = f"[{', '.join(map(str, place))}]" if place else ""
        number = float((values if given is None else np.reshape(given, values.shape))[row, *place])
        expected = "numbers that float32 can hold" if np.isfinite(number) else "finite numbers"
        giver, owner = ("environment", "") if behavior is None else ("simulation", f" of {behavior}")
        raise SimulationError(
            f"The {giver} gave agent {int(ids[row])}{owner} {what}{where} = {number}, but {expected} were expected."
        )
