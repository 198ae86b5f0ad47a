"""A scripted ML-Agents environment: gives out prepared steps and keeps the actions that it gets."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mlagents_envs.base_env import (
    ActionSpec,
    ActionTuple,
    BehaviorSpec,
    DecisionSteps,
    DimensionProperty,
    ObservationSpec,
    ObservationType,
    TerminalSteps,
)
from mlagents_envs.exception import UnityEnvironmentException

BEHAVIOR = "Scripted?team=0"


def spec(shapes: list[tuple[int, ...]], actions: ActionSpec) -> BehaviorSpec:
    observations = [
        ObservationSpec(shape, (DimensionProperty.NONE,) * len(shape), ObservationType.DEFAULT, f"observation {i}")
        for i, shape in enumerate(shapes)
    ]
    return BehaviorSpec(observations, actions)


@dataclass
class Scripted:
    """Each message is ({agent id: reward} that decide, {agent id: (reward, interrupted)} that end).

    An agent's observations are filled with its id, plus a hundredth for each message. Its group gets ``group_reward``
    with every message, and ``forbids`` says, of an agent's id and the message's number, what each branch forbids.
    """

    behavior: BehaviorSpec
    messages: list[tuple[dict[int, float], dict[int, tuple[float, bool]]]]
    sent: list[ActionTuple] = field(default_factory=list)
    resets: int = 0
    closed: bool = False
    at: int = -1
    group_reward: float = 0.0
    forbids: Callable[[int, int], list[list[bool]]] | None = None

    @property
    def behavior_specs(self) -> dict[str, BehaviorSpec]:
        return {BEHAVIOR: self.behavior} if self.at >= 0 else {}

    def reset(self) -> None:
        self.resets += 1
        self.at += 1

    def step(self) -> None:
        self.at += 1

    def set_actions(self, name: str, action: ActionTuple) -> None:
        assert name == BEHAVIOR
        self.sent.append(action)

    def get_steps(self, name: str) -> tuple[DecisionSteps, TerminalSteps]:
        decide, end = self.messages[self.at]
        zeros, mask = [0] * len(decide), None
        if self.forbids is not None and decide:
            mask = [
                np.array(branch) for branch in zip(*(self.forbids(agent, self.at) for agent in decide), strict=True)
            ]
        group = np.full(len(decide), self.group_reward, np.float32)
        decision = DecisionSteps(
            self._observe(list(decide)), _floats(decide.values()), _ids(decide), mask, zeros, group
        )
        rewards = _floats(reward for reward, _ in end.values())
        interrupted = np.array([cut for _, cut in end.values()], dtype=bool)
        group = np.full(len(end), self.group_reward, np.float32)
        return decision, TerminalSteps(self._observe(list(end)), rewards, interrupted, _ids(end), [0] * len(end), group)

    def close(self) -> None:
        if self.closed:
            raise UnityEnvironmentException("No Unity environment is loaded.")
        self.closed = True

    def _observe(self, ids: list[int]) -> list[Any]:
        values = np.array([agent + 0.01 * self.at for agent in ids], dtype=np.float32)
        return [
            np.broadcast_to(values.reshape(-1, *(1 for _ in observation.shape)), (len(ids), *observation.shape))
            for observation in self.behavior.observation_specs
        ]


def _floats(values: Any) -> Any:
    return np.array(list(values), dtype=np.float32)


def _ids(agents: Any) -> Any:
    return np.array(list(agents), dtype=np.int32)
