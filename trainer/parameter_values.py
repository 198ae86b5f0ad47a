"""Values of environment parameters, in the forms that ``mlagents-learn``'s YAML has for them.

A number, or a sampler::

gravity: -9.8
goal_z:
  sampler_type: uniform          # or gaussian (mean, st_dev), or multirangeuniform (intervals)
  sampler_parameters:
    min_value: 1
    max_value: 3
"""

from collections.abc import Mapping
from typing import Any

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Sampler, Uniform, Value
from corridor_server.shared.given import FLOAT32, Range, shown
from trainer.errors import SettingError

NUMBER = Range(-FLOAT32, FLOAT32)  # as a side channel carries it
SEED = Range(-1, 2**31 - 1)
NAME_LENGTH = 255
# With ML-Agents' defaults. mlagents-learn writes a number as a constant, and each sampler's seed.
SAMPLERS: dict[str, dict[str, Any]] = {
    "uniform": {"min_value": 0.0, "max_value": 1.0},
    "gaussian": {"mean": 1.0, "st_dev": 1.0},
    "multirangeuniform": {"intervals": [[0.0, 1.0]]},
    "constant": {"value": 0.0},
}


def parse_parameter(name: str, value: Any, seed: int) -> Value:
    """An environment parameter's number or sampler, from the form that the YAML file has for it.

    Args:
        name: The parameter's.
        value: A number, or the sampler's type and parameters.
        seed: The sampler's, unless its parameters have one that is not -1.

    Raises:
        SettingError: The value has neither form, or the name can't be sent.
    """
    if not isinstance(name, str) or not name.isascii() or not name.isprintable() or len(name) > NAME_LENGTH:
        raise SettingError(
            f"The environment parameter {shown(name)} can't be sent; give it a name of at most {NAME_LENGTH} ASCII "
            "characters."
        )
    number = _number(value)
    if number is not None:
        return number
    try:
        return _sampler(value, seed)
    except _WrongSampler as error:
        raise SettingError(f"The environment parameter {name} has a sampler of which {error}.") from error
    except (KeyError, TypeError, ValueError) as error:
        forms = "; ".join(f"{kind} with {', '.join(names)}" for kind, names in SAMPLERS.items() if kind != "constant")
        raise SettingError(
            f"The environment parameter {name} is {shown(value)}, but a number was expected, or a sampler_type with "
            f"its sampler_parameters: {forms}."
        ) from error


class _WrongSampler(Exception):
    """One of a known type; what is wrong with it."""


def _sampler(value: Any, seed: int) -> Sampler | float:
    """The sampler that a value describes; KeyError, TypeError or ValueError if it has another form."""
    kind, given = value["sampler_type"], value["sampler_parameters"]
    known = SAMPLERS[kind]
    if len(value) > 2 or not isinstance(given, Mapping):
        raise ValueError
    for each in given:
        if each not in ("seed", *known):
            raise _WrongSampler(f"{shown(each)} is no parameter; known ones are {', '.join(known)}")
    own = SEED.read(given.get("seed", -1), whole=True)
    if own is None:
        raise _WrongSampler(
            f"the seed is {shown(given['seed'])}, but a whole number from -1 to 2147483647 was expected"
        )
    seed = seed if own == -1 else int(own)
    if kind == "multirangeuniform":
        return MultiRangeUniform(seed, _intervals(given.get("intervals", known["intervals"])))
    numbers = [_finite(name, given.get(name, default)) for name, default in known.items()]
    if kind == "constant":
        return numbers[0]
    if kind == "uniform":
        return Uniform(seed, *_in_order(*numbers))
    if numbers[1] < 0.0:
        raise _WrongSampler(f"st_dev is {numbers[1]:g}, but 0 or more was expected")
    return Gaussian(seed, *numbers)


def _intervals(values: Any) -> tuple[tuple[float, float], ...]:
    each = values if isinstance(values, list | tuple) else []
    if not each or not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in each):
        raise _WrongSampler("intervals is no list of pairs of numbers, such as [[0, 1], [3, 4]]")
    return tuple(_in_order(_finite("an interval's end", low), _finite("an interval's end", high)) for low, high in each)


def _in_order(low: float, high: float) -> tuple[float, float]:
    if low > high:
        raise _WrongSampler(f"the least value, {low:g}, is above the greatest, {high:g}")
    return low, high


def _finite(name: str, value: object) -> float:
    number = _number(value)
    if number is None:
        raise _WrongSampler(f"{name} is {shown(value)}, but a number was expected")
    return number


def _number(value: object) -> float | None:
    """A number, or a text of one: YAML 1.1 reads 1e-3 as a text."""
    return NUMBER.parse(value) if isinstance(value, str) else NUMBER.read(value)
