"""What a run tells its players over side channels: Unity's engine settings, and environment parameters.

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
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import yaml
from mlagents_envs.side_channel.engine_configuration_channel import EngineConfigurationChannel
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.side_channel import SideChannel

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform, Value
from trainer.config import EngineConfig, RunConfig
from trainer.corridor import PENALTY, check_parameter
from trainer.errors import TrainerError
from trainer.seeds import sampler_seed

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
    known = {each.name: each.type for each in fields(EngineConfig)}
    for name, value in values.items():
        if name not in known:
            raise TrainerError(f"{name!r} is no engine setting; known ones are {', '.join(known)}.")
        low, high = EngineConfig.RANGES[name]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not low <= value <= high or (known[name] is int and value != int(value)):
            kind = "whole number" if known[name] is int else "number"
            raise TrainerError(
                f"The engine setting {name} is {value}, but a {kind} from {low:g} to {high:g} was expected."
            )
    typed: dict[str, Any] = {name: int(value) if known[name] is int else float(value) for name, value in values.items()}
    return EngineConfig(**typed)


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
        parsed = _parse(name, value, 0)
        if env_is_ours:
            check_parameter(name, parsed)
    return parameters


def channels(config: RunConfig, seed: int) -> list[SideChannel]:
    """Side channels that carry a run's settings to one player with its first reset.

    Args:
        config: The run.
        seed: The player's; samplers take it, each its own number more, as ``mlagents-learn`` does.
    """
    engine, parameters = EngineConfigurationChannel(), EnvironmentParametersChannel()
    engine.set_configuration_parameters(**asdict(config.engine))
    parameters.set_float_parameter(PENALTY, config.penalty)
    for index, (name, value) in enumerate(config.environment_parameters.items()):
        match _parse(name, value, sampler_seed(seed, index)):
            case Uniform(own_seed, low, high):
                parameters.set_uniform_sampler_parameters(name, low, high, own_seed)
            case Gaussian(own_seed, mean, deviation):
                parameters.set_gaussian_sampler_parameters(name, mean, deviation, own_seed)
            case MultiRangeUniform(own_seed, ranges):
                parameters.set_multirangeuniform_sampler_parameters(name, list(ranges), own_seed)
            case number:
                parameters.set_float_parameter(name, number)
    return [engine, parameters]


def _parse(name: str, value: Any, seed: int) -> Value:
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
