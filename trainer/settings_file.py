"""What a run tells its players, as users write it: engine settings and environment parameters.

Both may stand in a YAML file, in the sections and forms that ``mlagents-learn`` has for them::

    engine_settings:
      time_scale: 20
    environment_parameters:
      opponent_speed: 1.5
      goal_z:
        sampler_type: uniform          # or gaussian (mean, st_dev), or multirangeuniform (intervals)
        sampler_parameters:
          min_value: 1
          max_value: 3
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_type_hints

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Sampler, Uniform, Value
from corridor_server.shared.given import FLOAT32, Range, read_mapping, shown
from trainer.config import EngineConfig
from trainer.corridor import PENALTY, check_parameter
from trainer.errors import TrainerError

NUMBER = Range(-FLOAT32, FLOAT32)  # as a side channel carries it
NAME_LENGTH = 255
SECTIONS = ("engine_settings", "environment_parameters")
SAMPLERS = {
    "uniform": ("min_value", "max_value"),
    "gaussian": ("mean", "st_dev"),
    "multirangeuniform": ("intervals",),
}


def read_settings(path: Path | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """The engine settings and the environment parameters of a YAML file; nothing without a file.

    Raises:
        TrainerError: The file can't be read, or holds something else.
    """
    if path is None:
        return {}, {}
    try:
        values = read_mapping(path)
    except ValueError as error:
        raise TrainerError(f"{error} --config is a YAML file with the sections {' and '.join(SECTIONS)}.") from error
    for section, content in values.items():
        if section not in SECTIONS:
            raise TrainerError(
                f"{path} has the section {shown(section)}, but the sections {' and '.join(SECTIONS)} were expected; "
                "everything else is an option of corridor train."
            )
        if not isinstance(content, dict) or not all(isinstance(name, str) for name in content):
            raise TrainerError(f"{section} in {path} is {shown(content)}, but lines 'name: value' were expected.")
    engine, parameters = (values.get(section, {}) for section in SECTIONS)
    return engine, parameters


def engine_config(values: Mapping[str, Any]) -> EngineConfig:
    """Engine settings from names and values; ``mlagents-learn``'s defaults for the rest.

    Raises:
        TrainerError: A name is unknown, or a value out of its range.
    """
    types = get_type_hints(EngineConfig)
    for name in values:
        if name not in types:
            raise TrainerError(f"{shown(name)} is no engine setting; known ones are {', '.join(types)}.")
    return EngineConfig(**values)


def environment_parameters(texts: Sequence[str], from_file: Mapping[str, Any], env_is_ours: bool) -> dict[str, Any]:
    """Environment parameters of the command line (``NAME=NUMBER``) over those of a file, checked.

    Raises:
        TrainerError: A text has another form, a value can't be sent, or our corridor has no such parameter.
    """
    parameters = dict(from_file)
    for text in texts:
        name, equals, typed = text.partition("=")
        number = NUMBER.parse(typed)
        if not name or not equals or number is None:
            raise TrainerError(f"--env-param {text} is not of the form NAME=NUMBER, such as opponent_speed=1.5.")
        parameters[name] = number
    if PENALTY in parameters:
        raise TrainerError(f"The environment parameter {PENALTY} is set by --penalty; take it out.")
    for name, value in parameters.items():
        parsed = parse_parameter(name, value, 0)
        if env_is_ours:
            check_parameter(name, parsed)
    return parameters


def parse_parameter(name: str, value: Any, seed: int) -> Value:
    """An environment parameter's number or sampler, from the form that the YAML file has for it.

    Args:
        name: The parameter's.
        value: A number, or the sampler's type and parameters.
        seed: The sampler's.

    Raises:
        TrainerError: The value has neither form.
    """
    if not name.isascii() or not name.isprintable() or len(name) > NAME_LENGTH:
        raise TrainerError(
            f"The environment parameter {shown(name)} can't be sent; give it a name of at most {NAME_LENGTH} ASCII "
            "characters."
        )
    number = NUMBER.read(value)
    if number is not None:
        return number
    try:
        return _sampler(value, seed)
    except (KeyError, TypeError, ValueError) as error:
        forms = "; ".join(f"{kind} with {', '.join(names)}" for kind, names in SAMPLERS.items())
        raise TrainerError(
            f"The environment parameter {name} is {shown(value)}, but a number was expected, or a sampler_type with "
            f"its sampler_parameters: {forms}."
        ) from error


def _sampler(value: Any, seed: int) -> Sampler:
    """The sampler that a value describes; KeyError, TypeError or ValueError if it has another form."""
    kind, given = value["sampler_type"], value["sampler_parameters"]
    if len(value) > 2 or set(given) != set(SAMPLERS[kind]):
        raise ValueError
    numbers = [given[each] for each in SAMPLERS[kind]]
    if kind == "multirangeuniform":
        pairs = [(_finite(low), _finite(high)) for low, high in numbers[0]]
        if not pairs:
            raise ValueError
        return MultiRangeUniform(seed, tuple(pairs))
    first, second = map(_finite, numbers)
    if kind == "gaussian" and second < 0.0:
        raise ValueError
    return Uniform(seed, first, second) if kind == "uniform" else Gaussian(seed, first, second)


def _finite(value: object) -> float:
    number = NUMBER.read(value)
    if number is None:
        raise ValueError
    return number
