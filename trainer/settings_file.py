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

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_type_hints

import yaml

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform, Value
from trainer.config import EngineConfig
from trainer.corridor import PENALTY, check_parameter
from trainer.errors import TrainerError

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
        values = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except (OSError, UnicodeDecodeError) as error:
        raise TrainerError(f"{path} can't be read ({error}); give a YAML file with --config.") from error
    except yaml.YAMLError as error:
        raise TrainerError(f"{path} is not YAML ({' '.join(str(error).split())}).") from error
    expected = f"the sections {' and '.join(SECTIONS)} were expected"
    if not isinstance(values, dict):
        raise TrainerError(f"{path} holds a {type(values).__name__}, but {expected}.")
    for section, content in values.items():
        if section not in SECTIONS:
            raise TrainerError(
                f"{path} has the section {section!r}, but {expected}; everything else is an option of corridor train."
            )
        if not isinstance(content, dict):
            raise TrainerError(f"{section} in {path} is {content!r}, but lines 'name: value' were expected.")
    engine, parameters = (values.get(section, {}) for section in SECTIONS)
    return engine, {str(name): value for name, value in parameters.items()}


def engine_config(values: Mapping[str, Any]) -> EngineConfig:
    """Engine settings from names and values; ``mlagents-learn``'s defaults for the rest.

    Raises:
        TrainerError: A name is unknown, or a value out of its range.
    """
    types = get_type_hints(EngineConfig)
    for name in values:
        if name not in types:
            raise TrainerError(f"{name!r} is no engine setting; known ones are {', '.join(types)}.")
    EngineConfig(**values)  # refuses what is not a number in the setting's range
    return EngineConfig(**{name: types[name](value) for name, value in values.items()})


def environment_parameters(texts: Sequence[str], from_file: Mapping[str, Any], env_is_ours: bool) -> dict[str, Any]:
    """Environment parameters of the command line (``NAME=NUMBER``) over those of a file, checked.

    Raises:
        TrainerError: A text has another form, a value can't be sent, or our corridor has no such parameter.
    """
    parameters = dict(from_file)
    for text in texts:
        name, equals, number = text.partition("=")
        try:
            parameters[name] = float(number)
        except ValueError:
            equals = ""
        if not name or not equals:
            raise TrainerError(f"--env-param {text} is not of the form NAME=NUMBER, such as opponent_speed=1.5.")
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
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    try:
        kind, given = value["sampler_type"], value["sampler_parameters"]
        numbers = [given[each] for each in SAMPLERS[kind]]
        if kind == "multirangeuniform":
            return MultiRangeUniform(seed, tuple((float(low), float(high)) for low, high in numbers[0]))
        first, second = map(float, numbers)
    except (KeyError, TypeError, ValueError) as error:
        forms = "; ".join(f"{kind} with {', '.join(names)}" for kind, names in SAMPLERS.items())
        raise TrainerError(
            f"The environment parameter {name} is {value!r}, but a number was expected, or a sampler_type with its "
            f"sampler_parameters: {forms}."
        ) from error
    return Uniform(seed, first, second) if kind == "uniform" else Gaussian(seed, first, second)
