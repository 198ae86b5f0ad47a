"""Environment parameters that an environment's user declares: what a trainer may set, draws, and how it gets there."""

import difflib
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from corridor_server.protocol.samplers import Value
from corridor_server.shared.given import shown
from corridor_server.simulations.simulation import SimulationError


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

    def state(self) -> dict[str, Any]:
        """What is set, and where its samplers are, as plain values."""
        states = {name: [each.bit_generator.state for each in rows] for name, rows in self._generators.items()}
        return {"values": repr(self._values), "samplers": states}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Takes up where samplers were.

        Raises:
            ValueError: Other values are set.
        """
        if state["values"] != repr(self._values):
            raise ValueError("other environment parameters were set")
        for name, states in state["samplers"].items():
            for generator, each in zip(self._generators[name], states, strict=True):
                generator.bit_generator.state = each


class ParameterTaker:
    """Brings an environment to what is set: attributes, and arguments with which it is made anew.

    Args:
        name: The environment's, for errors.
        env: As it was made.
        make: Makes it of its arguments.
        arguments: That it was made of.
        attributes: Of the unwrapped environment that may be set.
        spaces: What a trainer was told of an environment, to be compared.

    Raises:
        SimulationError: It has no such attribute.
    """

    def __init__(
        self,
        name: str,
        env: Any,
        make: Callable[..., Any],
        arguments: Mapping[str, Any],
        attributes: tuple[str, ...],
        spaces: Callable[[Any], Mapping[str, object]],
    ) -> None:
        self._make, self._arguments, self._attributes, self._spaces = make, dict(arguments), attributes, spaces
        self._random = np.random.default_rng(0)  # draws the seeds of environments made anew
        for attribute in attributes:
            if not is_number(getattr(env.unwrapped, attribute, None)):
                raise SimulationError(
                    f"--parameters names {shown(attribute)}, but {name} has no such number; give an attribute of the "
                    "unwrapped environment."
                )

    def take_up(self, env: Any, settings: Mapping[str, float], seed: int | None) -> tuple[Any, int | None]:
        """Before an episode; returns the environment, which may be another, and the seed to reset it with.

        Args:
            env: As it stands.
            settings: Attributes and arguments by name; a name that is both is the attribute's.
            seed: Of the episode; None goes on with the random numbers of the one before.

        Raises:
            SimulationError: With other arguments it has other spaces.
        """
        if seed is not None:
            self._random = np.random.default_rng(seed)
        arguments = {name: value for name, value in settings.items() if name not in self._attributes}
        changed = {name: like(self._arguments[name], value) for name, value in arguments.items()}
        if any(self._arguments[name] != value for name, value in changed.items()):
            self._arguments |= changed
            if seed is None:
                seed = int(self._random.integers(2**31))
            before = self._spaces(env)
            env.close()
            env = self._make(**self._arguments)
            if any(before.get(of) != space for of, space in self._spaces(env).items()):  # fewer agents are no others
                given = ", ".join(f"{name} = {value}" for name, value in changed.items())
                raise SimulationError(
                    f"With {given} the environment has other spaces than a trainer was told; give an environment "
                    "parameter that leaves them as they are."
                )
        for name in settings.keys() - arguments.keys():
            setattr(env.unwrapped, name, like(getattr(env.unwrapped, name), settings[name]))
        return env, seed


def is_number(value: object) -> bool:
    """Whether a parameter can set what is now this."""
    return isinstance(value, int | float | np.number | np.bool_)


def like(present: Any, value: float) -> Any:
    """The value as the type that the present one has; an integer's is whole, and what is not whole stays as it is."""
    if isinstance(present, int | np.integer) and not isinstance(present, bool):
        return type(present)(value) if float(value).is_integer() else value
    return type(present)(value)
