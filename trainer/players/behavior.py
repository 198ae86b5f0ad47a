"""A player's one behavior, and its observations and actions as plain values, which a run keeps of it."""

from typing import Any

from mlagents_envs.base_env import ActionSpec, BehaviorSpec, DimensionProperty, ObservationSpec, ObservationType
from mlagents_envs.environment import UnityEnvironment

from corridor_server.protocol.agents import Behavior
from trainer.corridor import check_contract, is_corridor
from trainer.errors import TrainerError
from trainer.players.steps import sensors_of
from trainer.players.unsupported import SEVERAL


def only_behavior(environment: UnityEnvironment) -> tuple[str, BehaviorSpec]:
    """Name and spec of the environment's one behavior, which it makes known with its first agents.

    Raises:
        TrainerError: There are several, or one called Corridor that does not keep the corridor's contract.
    """
    if not environment.behavior_specs:
        environment.reset()
    specs = dict(environment.behavior_specs.items())
    if not specs:
        raise TrainerError("The player announced no behavior in its first message; look for agents in the scene.")
    if len(specs) != 1:
        raise TrainerError(
            f"The player has {len(specs)} behaviors ({', '.join(specs)}), but one was expected; {SEVERAL}."
        )
    name, spec = next(iter(specs.items()))
    if is_corridor(name):
        check_contract(spec)
    return name, spec


def described(name: str, spec: BehaviorSpec) -> Behavior:
    """A behavior in our own form."""
    action = spec.action_spec
    return Behavior(name, sensors_of(spec), int(action.continuous_size), tuple(map(int, action.discrete_branches)))


def behavior_record(name: str, spec: BehaviorSpec) -> dict[str, Any]:
    """Names and values for ``configuration.yaml``."""
    return {
        "name": name,
        "observations": [{"name": each.name, "shape": list(each.shape)} for each in spec.observation_specs],
        "continuous_actions": int(spec.action_spec.continuous_size),
        "discrete_branches": [int(size) for size in spec.action_spec.discrete_branches],
    }


def recorded_spec(record: dict[str, Any]) -> BehaviorSpec:
    """The inverse of ``behavior_record``, as far as it is recorded.

    Raises:
        KeyError: A value is missing.
        TypeError: One is of another type.
    """
    observations = [
        ObservationSpec(
            tuple(each["shape"]), (DimensionProperty.NONE,) * len(each["shape"]), ObservationType.DEFAULT, each["name"]
        )
        for each in record["observations"]
    ]
    return BehaviorSpec(observations, ActionSpec(record["continuous_actions"], tuple(record["discrete_branches"])))
