"""What a run tells its players over side channels: Unity's engine settings, and environment parameters."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from mlagents_envs.side_channel.engine_configuration_channel import EngineConfigurationChannel
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.side_channel import SideChannel

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform
from trainer.config import RunConfig
from trainer.corridor import PENALTY
from trainer.curriculum import Curricula
from trainer.parameter_values import parse_parameter
from trainer.players.location import BUILTIN
from trainer.seeds import sampler_seed


def channels(config: RunConfig, seed: int, curricula: Curricula | None = None) -> list[SideChannel]:
    """Engine settings and environment parameters: what carries a run's settings to one player with its first reset.

    What the run has for a corridor alone, the penalty and the preset's parameters, goes to our own player only: of no
    other is known that early which behavior it has (see ``tell_corridor``).

    Args:
        config: The run.
        seed: The player's, from which its samplers' follow.
        curricula: Of the run's environment parameters, in their present lessons; None for the first ones.
    """
    engine, parameters = EngineConfigurationChannel(), EnvironmentParametersChannel()
    engine.set_configuration_parameters(**asdict(config.engine))
    ours = config.env == BUILTIN
    if ours:
        parameters.set_float_parameter(PENALTY, config.penalty)
    lessons = Curricula(config.environment_parameters) if curricula is None else curricula
    set_parameters(parameters, present_parameters(config, lessons), seed)
    return [engine, parameters]


def present_parameters(config: RunConfig, curricula: Curricula) -> dict[str, Any]:
    """The environment parameters of the present lessons, without what only the paper's corridor has."""
    ours = config.env == BUILTIN
    return {name: value for name, value in curricula.values().items() if ours or name not in config.preset_parameters}


def set_parameters(parameters: EnvironmentParametersChannel, values: Mapping[str, Any], seed: int) -> None:
    """Has the next message set environment parameters.

    Args:
        parameters: The channel to a player.
        values: Numbers or samplers by name, as the YAML file has them.
        seed: The player's, from which its samplers' follow.
    """
    for index, (name, value) in enumerate(values.items()):
        _set(parameters, name, value, sampler_seed(seed, index))


def tell_corridor(config: RunConfig, parameters: EnvironmentParametersChannel) -> None:
    """Has the next message carry what ``channels`` kept back from a player that turned out to be a corridor.

    Args:
        config: The run.
        parameters: The channel to that player.
    """
    parameters.set_float_parameter(PENALTY, config.penalty)
    for name in config.preset_parameters:
        parameters.set_float_parameter(name, config.environment_parameters[name])


def _set(parameters: EnvironmentParametersChannel, name: str, value: Any, seed: int) -> None:
    match parse_parameter(name, value, seed):
        case Uniform(own_seed, low, high):
            parameters.set_uniform_sampler_parameters(name, low, high, own_seed)
        case Gaussian(own_seed, mean, deviation):
            parameters.set_gaussian_sampler_parameters(name, mean, deviation, own_seed)
        case MultiRangeUniform(own_seed, ranges):
            parameters.set_multirangeuniform_sampler_parameters(name, list(ranges), own_seed)
        case number:
            parameters.set_float_parameter(name, number)
