"""A behavior's observations and actions as Gymnasium's spaces, for every wrapper of an ML-Agents environment alike."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from mlagents_envs.base_env import (
    ActionSpec,
    BehaviorSpec,
    DecisionSteps,
    DimensionProperty,
    ObservationSpec,
    TerminalSteps,
)
from numpy.typing import NDArray

from trainer.errors import TrainerError

Observation = NDArray[Any] | dict[str, NDArray[Any]]
_CHANNELS_FIRST = (
    DimensionProperty.NONE,
    DimensionProperty.TRANSLATIONAL_EQUIVARIANCE,
    DimensionProperty.TRANSLATIONAL_EQUIVARIANCE,
)


def picture_axes(observation: ObservationSpec, channels_first: bool = False) -> tuple[int, int, int]:
    """The axes of a picture as the player has it, in the order (height, width, channels).

    Unity's package sends (height, width, channels) up to 2.x and (channels, height, width) from 3.0 on, and says so
    in the dimensions' properties; a player that says nothing of them has its channels last.

    Args:
        observation: Of three dimensions.
        channels_first: Whether the order is (channels, height, width) instead.
    """
    is_first = tuple(observation.dimension_property) == _CHANNELS_FIRST
    if channels_first:
        return (0, 1, 2) if is_first else (2, 0, 1)
    return (1, 2, 0) if is_first else (0, 1, 2)


def in_axes(array: NDArray[Any], axes: tuple[int, int, int]) -> NDArray[Any]:
    """Pictures (n, *as the player has them) with their axes in another order; a view."""
    return array.transpose(0, *(axis + 1 for axis in axes))


def sees_vectors(spec: BehaviorSpec) -> bool:
    """Whether all observations are vectors, and there is one."""
    shapes = [tuple(each.shape) for each in spec.observation_specs]
    return bool(shapes) and all(len(shape) == 1 for shape in shapes)


class ObservationLayout:
    """What an agent of a behavior observes, as one value: nothing is left out.

    Vectors alone are one Box, one after another. Every other behavior has a Dict of all its observations, ``obs_0``,
    ``obs_1``, ... in their order: a vector (size,), a buffer of vectors (most, size), or a picture, all float32.

    Args:
        spec: The behavior's.
        channels_first: Give pictures as (channels, height, width) instead of (height, width, channels).

    Raises:
        TrainerError: The behavior observes nothing.
    """

    def __init__(self, spec: BehaviorSpec, channels_first: bool = False) -> None:
        if not spec.observation_specs:
            raise TrainerError("The behavior has no observation, but one or more were expected; add a sensor.")
        self._one_vector = sees_vectors(spec)
        self._axes: dict[int, tuple[int, int, int]] = {}
        if self._one_vector:
            size = sum(int(each.shape[0]) for each in spec.observation_specs)
            self.space: spaces.Space[Any] = spaces.Box(-np.inf, np.inf, (size,), np.float32)
            return
        boxes: list[spaces.Space[Any]] = []
        for index, each in enumerate(spec.observation_specs):
            shape = tuple(each.shape)
            if len(shape) == 3:
                self._axes[index] = axes = picture_axes(each, channels_first)
                boxes.append(spaces.Box(0.0, 1.0, tuple(shape[axis] for axis in axes), np.float32))
            else:
                boxes.append(spaces.Box(-np.inf, np.inf, shape, np.float32))
        self.space = spaces.Dict({f"obs_{index}": box for index, box in enumerate(boxes)})

    def parts(self, steps: DecisionSteps | TerminalSteps) -> list[NDArray[np.float32]]:
        """The agents' observations, (n, *shape) for each Box of the space."""
        if self._one_vector:
            vector = steps.obs[0] if len(steps.obs) == 1 else np.concatenate(steps.obs, axis=1)
            return [np.asarray(vector, dtype=np.float32)]
        return [
            np.asarray(in_axes(each, self._axes[index]) if index in self._axes else each, dtype=np.float32)
            for index, each in enumerate(steps.obs)
        ]

    def empty(self, count: int) -> list[NDArray[np.float32]]:
        """Room for so many agents' observations."""
        boxes = self.space.spaces.values() if isinstance(self.space, spaces.Dict) else [self.space]
        return [np.zeros((count, *(box.shape or ())), dtype=np.float32) for box in boxes]

    def value(self, parts: Sequence[NDArray[np.float32]]) -> Observation:
        """The space's own value for what ``parts`` gave: a row of each for one agent, or all rows."""
        return parts[0] if self._one_vector else {f"obs_{index}": part for index, part in enumerate(parts)}


def action_space(action: ActionSpec) -> spaces.Space[Any]:
    """What an agent does.

    Box(-1, 1) for continuous actions, Discrete for one discrete branch, MultiDiscrete for several, and
    Tuple((Box, MultiDiscrete)) for both kinds at once.

    Raises:
        TrainerError: It does nothing.
    """
    if not action.continuous_size and not action.discrete_size:
        raise TrainerError(
            "The behavior has no action, but one or more were expected; add continuous or discrete ones."
        )
    box = spaces.Box(-1.0, 1.0, (action.continuous_size,), np.float32)
    branches = [int(size) for size in action.discrete_branches]
    if action.is_continuous():
        return box
    if not action.is_discrete():
        return spaces.Tuple((box, spaces.MultiDiscrete(branches)))
    return spaces.Discrete(branches[0]) if len(branches) == 1 else spaces.MultiDiscrete(branches)


def action_arrays(spec: ActionSpec, actions: Any, count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Actions of that space, batched as Gymnasium batches it, as arrays.

    Args:
        spec: The behavior's.
        actions: Of so many agents; for one agent, its action as it is.
        count: How many.

    Returns:
        Continuous actions (count, size) and discrete ones (count, branches).
    """
    if spec.is_continuous():
        numbers, choices = actions, np.zeros((count, 0))
    elif spec.is_discrete():
        numbers, choices = np.zeros((count, 0)), actions
    else:
        numbers, choices = actions
    return (
        np.asarray(numbers).reshape(count, spec.continuous_size).astype(np.float32, copy=False),
        np.asarray(choices).reshape(count, spec.discrete_size).astype(np.int32, copy=False),
    )


def allowed_choices(spec: ActionSpec, decision: DecisionSteps) -> NDArray[np.bool_]:
    """Which choices the agents have, (n, all branches' choices one after another); True is allowed."""
    if not decision.action_mask:  # None, or an empty list where no agent has a mask
        return np.ones((len(decision), sum(spec.discrete_branches)), np.bool_)
    return ~np.concatenate(decision.action_mask, axis=1).astype(np.bool_, copy=False)


def all_rewards(steps: DecisionSteps | TerminalSteps) -> NDArray[np.float32]:
    """The agents' own rewards, (n,), with their groups' added."""
    rewards: NDArray[np.float32] = steps.reward
    return rewards + steps.group_reward if np.count_nonzero(steps.group_reward) else rewards
