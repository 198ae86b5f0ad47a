"""A batch of agents, in the one form that it has from a simulation to a trainer's decisions."""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

# DimensionProperty: neither translation-equivariant nor of variable size; translation-equivariant, as pictures are; of
# variable size, as buffers are.
NO_PROPERTY, TRANSLATIONAL_EQUIVARIANCE, VARIABLE_SIZE = 1, 2, 4


class Sensor(NamedTuple):
    """An observation, as it describes itself in every message.

    Attributes:
        name: Its name.
        shape: Of its numbers; a picture's as the peer has it, (height, width, channels) or (channels, height, width).
        dimension_properties: One per dimension (DimensionProperty), or none.
        kind: ObservationTypeProto: 0, or 1 for a goal signal.
    """

    name: str
    shape: tuple[int, ...]
    dimension_properties: tuple[int, ...]
    kind: int = 0

    @classmethod
    def of(cls, name: str, shape: tuple[int, ...]) -> "Sensor":
        """A vector (size,), a buffer of vectors (most, size), or a picture (height, width, channels), by its shape."""
        properties = {
            1: (NO_PROPERTY,),
            2: (VARIABLE_SIZE, NO_PROPERTY),
            3: (TRANSLATIONAL_EQUIVARIANCE, TRANSLATIONAL_EQUIVARIANCE, NO_PROPERTY),
        }
        return cls(name, shape, properties[len(shape)])

    @property
    def is_picture(self) -> bool:
        """Whether its numbers are a picture's."""
        return len(self.shape) == 3


@dataclass(frozen=True)
class Behavior:
    """What a trainer is told of agents that one policy plays.

    Attributes:
        name: With its team, such as ``Corridor?team=0``.
        sensors: What an agent observes, in the order of ``Agents.observations``.
        continuous_actions: How many numbers an action has.
        discrete_branches: How many choices each branch of an action has; none without discrete actions.
    """

    name: str
    sensors: tuple[Sensor, ...]
    continuous_actions: int = 0
    discrete_branches: tuple[int, ...] = ()


class ActionBatch(NamedTuple):
    """What agents of one behavior shall do, a row each.

    Attributes:
        continuous: (n, size) float32.
        discrete: The choice in each branch, (n, branches) int32.
    """

    continuous: NDArray[np.float32]
    discrete: NDArray[np.int32]

    @classmethod
    def zeros(cls, count: int, behavior: Behavior) -> "ActionBatch":
        """What Unity's agents do when nobody decides for them."""
        size, branches = behavior.continuous_actions, len(behavior.discrete_branches)
        return cls(np.zeros((count, size), np.float32), np.zeros((count, branches), np.int32))


@dataclass(frozen=True)
class Agents:
    """Agents of one behavior, a row each: in a message of ours, those that ended stand before those that decide.

    Attributes:
        ids: An agent's own for its life, over all its episodes; from 0; (n,) int32.
        rewards: Since the agent's last batch, (n,) float32.
        done: Whose episode ended, with its last observation and reward, (n,) bool.
        interrupted: Which of those a step limit cut, (n,) bool.
        observations: One per sensor, (n, *shape) float32; a vector's are (n, size). A picture of the player's may be
            (n, height, width, channels) uint8.
        group_ids: The groups that agents play in, (n,) int32; 0 for an agent on its own.
        group_rewards: What the agent's group got since its last batch, apart from ``rewards``, (n,) float32.
        masks: One per discrete branch, (n, choices) bool, True for a choice that is forbidden; empty if none is.
    """

    ids: NDArray[np.int32]
    rewards: NDArray[np.float32]
    done: NDArray[np.bool_]
    interrupted: NDArray[np.bool_]
    observations: tuple[NDArray[Any], ...]
    group_ids: NDArray[np.int32]
    group_rewards: NDArray[np.float32]
    masks: tuple[NDArray[np.bool_], ...] = ()

    @classmethod
    def ungrouped(
        cls,
        ids: NDArray[np.int32],
        rewards: NDArray[np.float32],
        done: NDArray[np.bool_],
        interrupted: NDArray[np.bool_],
        observations: tuple[NDArray[Any], ...],
        masks: tuple[NDArray[np.bool_], ...] = (),
    ) -> "Agents":
        """Agents each on its own."""
        groups, group_rewards = np.zeros(len(ids), np.int32), np.zeros(len(ids), np.float32)
        return cls(ids, rewards, done, interrupted, observations, groups, group_rewards, masks)

    @classmethod
    def that_ask(
        cls,
        ids: ArrayLike,
        observations: tuple[NDArray[Any], ...],
        rewards: ArrayLike,
        masks: tuple[NDArray[np.bool_], ...] = (),
    ) -> "Agents":
        """Agents each on its own that ask for an action.

        Raises:
            ValueError: An id is none.
        """
        numbers = _ids(ids)
        nobody = np.zeros(len(numbers), np.bool_)
        return cls.ungrouped(numbers, np.asarray(rewards, np.float32), nobody, nobody, observations, masks)

    @classmethod
    def that_ended(
        cls, ids: ArrayLike, observations: tuple[NDArray[Any], ...], rewards: ArrayLike, interrupted: ArrayLike
    ) -> "Agents":
        """Agents each on its own whose episode ended.

        Raises:
            ValueError: An id is none.
        """
        numbers = _ids(ids)
        done, cut = np.ones(len(numbers), np.bool_), np.asarray(interrupted, np.bool_)
        return cls.ungrouped(numbers, np.asarray(rewards, np.float32), done, cut, observations)

    def then(self, others: "Agents") -> "Agents":
        """These and the others of the same behavior after them; where only one of both has masks, all may do all."""
        columns: list[Any] = []
        for column in fields(self):
            mine, theirs = getattr(self, column.name), getattr(others, column.name)
            if column.name == "masks" and len(mine) != len(theirs):
                mine = mine or tuple(np.zeros((len(self), each.shape[1]), np.bool_) for each in theirs)
                theirs = theirs or tuple(np.zeros((len(others), each.shape[1]), np.bool_) for each in mine)
            if isinstance(mine, tuple):
                columns.append(tuple(np.concatenate(pair) for pair in zip(mine, theirs, strict=True)))
            else:
                columns.append(np.concatenate([mine, theirs]))
        return Agents(*columns)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def ended(self) -> "Agents":
        """Those whose episode ended; a view, where they stand first."""
        return self._part(done=True)

    @property
    def deciding(self) -> "Agents":
        """Those that ask for an action; a view, where they stand last."""
        return self._part(done=False)

    def _part(self, done: bool) -> "Agents":
        ended = np.count_nonzero(self.done)
        if ended == (len(self) if done else 0):
            return self
        if not ended or self.done[:ended].all():
            return self.rows(slice(0, ended) if done else slice(ended, None))
        return self.rows((self.done == done).nonzero()[0])  # a peer's message may have them in any order

    def rows(self, rows: Any) -> "Agents":
        """Those in these rows, a slice or an index; a view for a slice."""
        return Agents(
            self.ids[rows],
            self.rewards[rows],
            self.done[rows],
            self.interrupted[rows],
            tuple(each[rows] for each in self.observations),
            self.group_ids[rows],
            self.group_rewards[rows],
            tuple(each[rows] for each in self.masks),
        )


def _ids(given: ArrayLike) -> NDArray[np.int32]:
    """As int32, which would make other ids of those that it can't hold."""
    ids = np.asarray(given)
    if ids.dtype == np.int32:
        return ids
    with np.errstate(invalid="ignore"):  # of NaN
        numbers = ids.astype(np.int32)
    for unequal in ids[numbers != ids].ravel()[:1].tolist():
        raise ValueError(f"an agent's id is {unequal}, but a whole number from 0 to {2**31 - 1} was expected")
    return numbers
