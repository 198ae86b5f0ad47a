"""A behavior's observations and actions as plain values: what a run keeps of its player once that is gone."""

from typing import Any

from mlagents_envs.base_env import ActionSpec, BehaviorSpec, DimensionProperty, ObservationSpec, ObservationType


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
