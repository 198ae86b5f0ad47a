"""Environment parameters that an environment's user declares: what a trainer may set, and draws for an episode."""

import difflib
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from corridor_server.protocol.samplers import Value
from corridor_server.shared.given import shown


class DeclaredParameters:
    """What is set, for areas that draw their own values of samplers.

    Args:
        names: Those that may be set.
        areas: The areas' numbers.
    """

    def __init__(self, names: Collection[str], areas: Sequence[int]) -> None:
        self._names = names
        self._areas = areas
        self._values: dict[str, Value] = {}
        self._generators: dict[str, list[np.random.Generator]] = {}

    def set(self, name: str, value: Value) -> bool:
        """Sets one for every episode that begins from now on; returns whether that changes anything.

        Raises:
            ValueError: It is not declared.
        """
        if name not in self._names:
            near = difflib.get_close_matches(name[:100], self._names, n=1, cutoff=0.0)
            declared = f"the nearest that is declared is {near[0]}" if near else "none is declared"
            raise ValueError(
                f"{shown(name)} is no environment parameter here: {declared}; an attribute is declared with "
                "--parameters, an argument in --env-kwargs."
            )
        if self._values.get(name) == value:
            return False
        self._values[name] = value
        if not isinstance(value, float):
            seed = value.seed % 2**32
            self._generators[name] = [np.random.default_rng([seed, area]) for area in self._areas]
        return True

    def draw(self, row: int) -> dict[str, float]:
        """What the area in this row has in its next episode, by name; only what was set."""
        return {
            name: value if isinstance(value, float) else value.sample(self._generators[name][row])
            for name, value in self._values.items()
        }


def is_number(value: object) -> bool:
    """Whether a parameter can set what is now this."""
    return isinstance(value, int | float | np.number | np.bool_)


def like(present: Any, value: float) -> Any:
    """The value as the type that the present one has; an integer's is whole, and what is not whole stays as it is."""
    if isinstance(present, int | np.integer) and not isinstance(present, bool):
        return type(present)(value) if float(value).is_integer() else value
    return type(present)(value)
