"""A behavior's observations and actions as Gymnasium's spaces, for every wrapper of an ML-Agents environment alike."""

from collections.abc import Collection, Sequence
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

from corridor_server.shared.given import shown
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


def picture_box(shape: tuple[int, ...], is_compressed: bool) -> spaces.Box:
    """Where a picture's values lie: bytes of a PNG file become floats from 0 to 1, others are what a player likes."""
    low, high = (0.0, 1.0) if is_compressed else (-np.inf, np.inf)
    return spaces.Box(low, high, shape, np.float32)


def sees_vectors(spec: BehaviorSpec) -> bool:
    """Whether all observations are vectors, and there is one."""
    shapes = [tuple(each.shape) for each in spec.observation_specs]
    return bool(shapes) and all(len(shape) == 1 for shape in shapes)


class ObservationLayout:
    """What an agent of a behavior observes, as one value: nothing is left out.

    Vectors alone are one Box, one after another. Every other behavior has a Dict of all its observations, ``obs_0``,
    ``obs_1``, ... in their order: a vector (size,), a buffer of vectors (most, size), or a picture, all float32.
    Compressed pictures are from 0 to 1; nothing else has bounds that the protocol tells.

    Args:
        spec: The behavior's.
        compressed: Which observations are compressed pictures.
        channels_first: Give pictures as (channels, height, width) instead of (height, width, channels).

    Raises:
        TrainerError: The behavior observes nothing.
    """

    def __init__(self, spec: BehaviorSpec, compressed: Collection[int] = (), channels_first: bool = False) -> None:
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
                boxes.append(picture_box(tuple(shape[axis] for axis in axes), index in compressed))
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

    Raises:
        TrainerError: They have another shape, are no numbers, or choose what a branch does not have.
    """
    if spec.is_continuous():
        numbers = _rows(actions, count, spec.continuous_size)
        return numbers.astype(np.float32, copy=False), np.empty((count, 0), np.int32)
    if spec.is_discrete():
        return np.empty((count, 0), np.float32), _choices(actions, count, spec.discrete_branches)
    if not isinstance(actions, tuple | list) or len(actions) != 2:
        raise TrainerError(
            f"The action is {shown(actions)}, but a pair was expected: continuous numbers and discrete choices."
        )
    numbers = _rows(actions[0], count, spec.continuous_size)
    return numbers.astype(np.float32, copy=False), _choices(actions[1], count, spec.discrete_branches)


def _rows(given: Any, count: int, size: int) -> NDArray[Any]:
    """Numbers as (count, size); one agent's may be without that axis, and so may one number of each agent.

    Raises:
        TrainerError: They are no numbers, or have another shape.
    """
    try:
        array = np.asarray(given)
    except ValueError:  # rows of different lengths
        array = np.empty(0, object)
    expected = (size,) if count == 1 else (count, size)
    if array.dtype.kind not in "biuf":
        raise TrainerError(f"The action is {shown(given)}, but numbers of shape {expected} were expected.")
    flat = array.ndim < 2 and array.size == count * size and 1 in (count, size)
    if array.shape != (count, size) and not flat:
        raise TrainerError(f"The action has shape {array.shape}, but numbers of shape {expected} were expected.")
    return array.reshape(count, size)


def _choices(given: Any, count: int, branches: Sequence[int]) -> NDArray[np.int32]:
    """Choices as (count, branches).

    Raises:
        TrainerError: As ``_rows``; or one is none of its branch's.
    """
    array = _rows(given, count, len(branches))
    wrong = ~((array >= 0) & (array < np.asarray(branches)) & (array % 1 == 0))  # NaN compares to nothing
    if wrong.any():
        row, branch = map(int, np.argwhere(wrong)[0])
        whose = f" of agent {row}" if count > 1 else ""
        raise TrainerError(
            f"The choice{whose} in branch {branch} is {array[row, branch]}, but a whole number from 0 to "
            f"{branches[branch] - 1} was expected."
        )
    return array.astype(np.int32, copy=False)


def allowed_choices(spec: ActionSpec, decision: DecisionSteps) -> NDArray[np.bool_]:
    """Which choices the agents have, (n, all branches' choices one after another); True is allowed."""
    if not decision.action_mask:  # None, or an empty list where no agent has a mask
        return np.ones((len(decision), sum(spec.discrete_branches)), np.bool_)
    return ~np.concatenate(decision.action_mask, axis=1).astype(np.bool_, copy=False)


def action_mask(spec: ActionSpec, allowed: NDArray[np.bool_]) -> Any:
    """What one agent may choose, in the form that its action space's ``sample`` takes as ``mask``.

    Args:
        spec: The behavior's, with discrete actions.
        allowed: A row of ``allowed_choices``.

    Returns:
        An int8 array for Discrete, 1 for what is allowed; a tuple of one for each branch for MultiDiscrete; with
        continuous actions beside them, a tuple of None and that tuple.
    """
    branches = tuple(np.split(allowed.astype(np.int8), np.cumsum(spec.discrete_branches)[:-1]))
    if not spec.is_discrete():
        return None, branches
    return branches[0] if len(branches) == 1 else branches


def all_rewards(steps: DecisionSteps | TerminalSteps) -> NDArray[np.float32]:
    """The agents' own rewards, (n,), with their groups' added."""
    rewards: NDArray[np.float32] = steps.reward
    return rewards + steps.group_reward if np.count_nonzero(steps.group_reward) else rewards
