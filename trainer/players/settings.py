"""What a run tells its players over side channels: Unity's engine settings, and environment parameters."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from mlagents_envs.side_channel.engine_configuration_channel import EngineConfigurationChannel
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.side_channel import SideChannel

from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.parameters import Gaussian, MultiRangeUniform, Uniform
from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.settings_file import PENALTY, parse_parameter


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
        match parse_parameter(name, value, (seed + index) % 2**31):
            case Uniform(sampler_seed, low, high):
                parameters.set_uniform_sampler_parameters(name, low, high, sampler_seed)
            case Gaussian(sampler_seed, mean, deviation):
                parameters.set_gaussian_sampler_parameters(name, mean, deviation, sampler_seed)
            case MultiRangeUniform(sampler_seed, ranges):
                parameters.set_multirangeuniform_sampler_parameters(name, list(ranges), sampler_seed)
            case number:
                parameters.set_float_parameter(name, number)
    return [engine, parameters]


def check_ranges(parameters: Mapping[str, Any]) -> None:
    """Refuses a range of our corridor that a parameter has turned round.

    Raises:
        TrainerError: A range begins above its end.
    """
    for name, (low, high) in _ranges(parameters).items():
        if low > high:
            raise TrainerError(
                f"{name} would go from {low:g} to {high:g} (the end not given is the preset's or the corridor's), "
                f"but the smaller number was expected first; give both {name}_min and {name}_max, or {name} alone."
            )


def corridor_of(config: RunConfig) -> CorridorConfig:
    """The corridor that a run's built-in player makes, as far as it is the same in every episode."""
    values = asdict(CorridorConfig())
    given = {PENALTY: config.penalty, **config.environment_parameters}
    sent = {name: float(np.float32(value)) for name, value in given.items() if isinstance(value, int | float)}
    values |= {name: value for name, value in sent.items() if name in values} | _ranges(sent)
    try:
        return CorridorConfig.from_mapping(values)
    except ValueError:  # another player's parameter of the same name
        return CorridorConfig()


def _ranges(parameters: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """The corridor's ranges with the ends that parameters give: the later of NAME and NAME_min counts."""
    ends = {name: list(value) for name, value in asdict(CorridorConfig()).items() if isinstance(value, tuple)}
    for name, value in parameters.items():
        of, _, end = name.rpartition("_")
        if not isinstance(value, int | float):
            continue
        if name in ends:
            ends[name] = [value, value]
        elif of in ends and end in ("min", "max"):
            ends[of][("min", "max").index(end)] = value
    return {name: (low, high) for name, (low, high) in ends.items()}
