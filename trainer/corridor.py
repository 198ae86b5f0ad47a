"""All that only the paper's corridor has: contract, statistics, parameters, and the values that presets give them.

Everything else in the trainer goes for any ML-Agents environment. This stands on the floor of the house, beside
``config``: it imports ``corridor_server`` and the errors, and nothing else of the trainer.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from corridor_server.corridor import colours
from corridor_server.corridor import observation as layout
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.curious_corridor import as_environment_parameters
from corridor_server.protocol.samplers import Value
from corridor_server.shared.given import MAX_AREAS
from trainer.errors import TrainerError

if TYPE_CHECKING:
    from mlagents_envs.base_env import BehaviorSpec

BEHAVIOR = "Corridor"

# What a player reports of each ended episode over the statistics channel.
SUCCESS = "Corridor/Success"
OPPONENT_CONTACTS = "Corridor/Opponent Contacts"
WALL_CONTACTS = "Corridor/Wall Contacts"

# The environment parameter that --penalty sets.
PENALTY = "failure_penalty"
DEFAULT_PENALTY = 1.0
# The corridor that presets ask a player for, but for what they have of their own. On it curiosity decides between
# failure and success (docs/calibration.md).
CORRIDOR = as_environment_parameters()
# Who has which colour on a figure.
LEARNER_COLOUR, OPPONENT_COLOUR, SWITCH_COLOUR, WALL_COLOUR = map(
    colours.hexadecimal, (colours.LEARNER, colours.OPPONENT, colours.SWITCH_ON, colours.WALL)
)


def is_corridor(behavior: str) -> bool:
    """Whether a behavior claims to be the paper's corridor."""
    return behavior.partition("?")[0] == BEHAVIOR


def check_contract(spec: "BehaviorSpec") -> None:
    """Refuses a behavior called Corridor that has other observations or actions than the corridor's.

    Raises:
        TrainerError: It does not keep the corridor's contract.
    """
    shapes = [tuple(observation.shape) for observation in spec.observation_specs]
    vector = [shape[0] for shape in shapes if len(shape) == 1]
    if len(vector) != 1 or not layout.is_size(vector[0]):
        raise TrainerError(
            f"Behavior Corridor has observations of shapes {shapes}, but one vector of {layout.OWN_SIZE} + "
            f"{layout.OPPONENT_SIZE}K floats for K opponents ({layout.size(1)} for one) was expected; set the vector "
            "observation's Space Size to that and collect what docs/contract.md lists."
        )
    action = spec.action_spec
    if action.continuous_size != 2 or action.discrete_size:
        raise TrainerError(
            f"Behavior Corridor has {action.continuous_size} continuous actions and {action.discrete_size} discrete "
            "branches, but 2 continuous actions and no discrete ones were expected; set Continuous Actions to 2 and "
            "Discrete Branches to 0 in the scene's Behavior Parameters."
        )


def episode_info(statistics: dict[str, float]) -> dict[str, Any]:
    """An ended episode's part of a Stable-Baselines3 info; ``is_success`` only if the player reports success.

    A value that is NaN or infinite says nothing: it is left out, as if it had not been reported.
    """
    statistics = {name: value for name, value in statistics.items() if math.isfinite(value)}
    if not statistics:
        return {}
    info: dict[str, Any] = {"statistics": statistics}
    if SUCCESS in statistics:
        info["is_success"] = statistics[SUCCESS] > 0.5
    return info


def check_areas(count: int) -> None:
    """Refuses more areas than our player has.

    Raises:
        TrainerError: There are more.
    """
    if count > MAX_AREAS:
        raise TrainerError(
            f"--num-areas is {count}, but the built-in player has at most {MAX_AREAS}; take several players with "
            "--num-envs."
        )


def check_parameter(name: str, value: Value) -> None:
    """Refuses what our corridor can't be told.

    Raises:
        TrainerError: The corridor has no such parameter, or the value is out of its range.
    """
    from corridor_server.corridor.parameters import EpisodeParameters

    try:
        EpisodeParameters(CorridorConfig(), ()).set(name, value)
    except ValueError as error:
        raise TrainerError(str(error)) from error


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


def corridor_of(penalty: float, environment_parameters: Mapping[str, Any]) -> CorridorConfig:
    """The corridor that a run's built-in player makes, as far as it is the same in every episode.

    Args:
        penalty: The run's failure penalty.
        environment_parameters: Of the run, as float32 numbers arrive at the player; samplers count for nothing here.
    """
    import numpy as np

    values = asdict(CorridorConfig())
    given = {PENALTY: penalty, **environment_parameters}
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
