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
    number = NUMBER.read(value)
    if number is not None:
        return number
    try:
        return _sampler(value, seed)
    except (KeyError, TypeError, ValueError) as error:
        forms = "; ".join(f"{kind} with {', '.join(names)}" for kind, names in SAMPLERS.items() if kind != "constant")
        raise SettingError(
            f"The environment parameter {name} is {shown(value)}, but a number was expected, or a sampler_type with "
            f"its sampler_parameters: {forms}."
        ) from error


def _sampler(value: Any, seed: int) -> Sampler | float:
    """The sampler that a value describes; KeyError, TypeError or ValueError if it has another form."""
    kind, given = value["sampler_type"], value["sampler_parameters"]
    if len(value) > 2 or not isinstance(given, Mapping) or not set(given) <= {"seed", *SAMPLERS[kind]}:
        raise ValueError
    own = SEED.read(given.get("seed", -1), whole=True)
    if own is None:
        raise ValueError
    seed = seed if own == -1 else int(own)
    numbers = [given.get(name, default) for name, default in SAMPLERS[kind].items()]
    if kind == "constant":
        return _finite(numbers[0])
    if kind == "multirangeuniform":
        pairs = [_in_order(_finite(low), _finite(high)) for low, high in numbers[0]]
        if not pairs:
            raise ValueError
        return MultiRangeUniform(seed, tuple(pairs))
    first, second = map(_finite, numbers)
    if kind == "uniform":
        return Uniform(seed, *_in_order(first, second))
    if second < 0.0:
        raise ValueError
    return Gaussian(seed, first, second)


def _in_order(low: float, high: float) -> tuple[float, float]:
    if low > high:
        raise ValueError
    return low, high


def _finite(value: object) -> float:
    number = NUMBER.read(value)
    if number is None:
        raise ValueError
    return number
