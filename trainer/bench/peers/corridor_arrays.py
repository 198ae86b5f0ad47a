"""The corridor in process for a vectorised PPO: arrays in, arrays out."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor.areas import BEHAVIOR, Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol.agents import ActionBatch

LIMIT = 10.0  # of a normalised observation
TINY = 1e-8
Singles = NDArray[np.float32]


class SteppedCorridor(NamedTuple):
    """What a step of all areas gave.

    Attributes:
        observations: Of every area, (areas, size); where an episode ended, the next one's first.
        rewards: Of every area, (areas,).
        terminated: Which episodes ended by themselves, (areas,) bool.
        truncated: Which a step limit cut, (areas,) bool.
        ended: Areas whose episodes ended, in order.
        last_observations: Of those, the last ones, (ended, size).
    """

    observations: Singles
    rewards: Singles
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    ended: NDArray[np.intp]
    last_observations: Singles


class CorridorArrays:
    """Areas of the corridor, which count their steps.

    Args:
        areas: How many.
        seed: Of their episodes.
        parameters: Environment parameters by name.
        normalised: Give observations less their running mean, over their running deviation, limited to +-10.

    Attributes:
        size: Of an observation.
        action_size: Of an action, whose numbers go from -1 to 1.
        steps: Agent steps so far.
        reward: The sum of all rewards so far.
    """

    def __init__(self, areas: int, seed: int, parameters: dict[str, Any], normalised: bool) -> None:
        self._areas = Areas(CorridorConfig(), seed, range(areas))
        for name, value in parameters.items():
            self._areas.set_parameter(name, float(value))
        behavior = self._areas.behaviors[BEHAVIOR]
        self._no_choices = np.empty((areas, 0), np.int32)
        self.size, self.action_size = behavior.sensors[0].shape[0], behavior.continuous_actions
        self._normalised = normalised
        self._mean, self._variance, self._count = np.zeros(self.size), np.ones(self.size), 1e-4
        self.steps, self.reward = 0, 0.0

    def __len__(self) -> int:
        return len(self._areas)

    def reset(self) -> Singles:
        """Begins an episode in every area; returns observations, (areas, size)."""
        observations: Singles = self._areas.reset()[BEHAVIOR].observations[0]
        return self._normal(observations, learn=True)

    def step(self, actions: Singles) -> SteppedCorridor:
        """One step of every area.

        Args:
            actions: (areas, action size), from -1 to 1.
        """
        count = len(self)
        agents = self._areas.step({BEHAVIOR: ActionBatch(actions, self._no_choices)})[0][BEHAVIOR]
        seen: Singles = agents.observations[0]
        early = len(seen) - count  # those that ended stand first
        rewards = agents.rewards[early:].copy()
        ended = agents.ids[:early].astype(np.intp)
        rewards[ended] = agents.rewards[:early]
        flags = np.zeros((2, count), np.bool_)
        flags[0, ended], flags[1, ended] = ~agents.interrupted[:early], agents.interrupted[:early]
        self.steps += count
        self.reward += float(rewards.sum())
        observations = self._normal(seen[early:], learn=True)
        last = self._normal(seen[:early], learn=False)
        return SteppedCorridor(observations, rewards, flags[0], flags[1], ended, last)

    def _normal(self, observations: Singles, learn: bool) -> Singles:
        if not self._normalised:
            return observations
        if learn:
            # Means and variances of two groups are put together (Chan et al.).
            count, total = len(observations), self._count + len(observations)
            mean, variance = observations.mean(axis=0), observations.var(axis=0)
            apart = mean - self._mean
            self._variance = (
                self._variance * self._count + variance * count + apart**2 * self._count * count / total
            ) / total
            self._mean = self._mean + apart * count / total
            self._count = total
        scaled = (observations - self._mean) / np.sqrt(self._variance + TINY)
        return np.clip(scaled, -LIMIT, LIMIT).astype(np.float32)
