"""Observations as a policy takes them: vectors normalised where that is asked for (eq. 7), everything else as it is."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents, Behavior
from trainer.learning.normaliser import OBSERVATION_CLIP, ObservationStatistics
from trainer.learning.transitions import Observed, Singles

EPSILON = 1e-8  # added to a variance, as Stable-Baselines3's ``VecNormalize`` does


class ObservationScaling:
    """What a behavior's agents observe.

    Args:
        behavior: With which sensors.
        normalize: Whether vectors are scaled by their running mean and deviation.

    Attributes:
        statistics: Of the observations that are normalised, by their place.
    """

    def __init__(self, behavior: Behavior, normalize: bool) -> None:
        self.statistics = {
            index: ObservationStatistics(shape=sensor.shape)
            for index, sensor in enumerate(behavior.sensors)
            if normalize and len(sensor.shape) == 1
        }

    def learn(self, agents: Agents) -> None:
        """Takes agents' observations into the running statistics."""
        for index, statistics in self.statistics.items():
            statistics.update(np.asarray(agents.observations[index], np.float32))

    def of(self, agents: Agents) -> Observed:
        """What agents observe, as a policy takes it."""
        allowed = ~np.concatenate(agents.masks, axis=1) if agents.masks else None
        return Observed(self.scaled(agents.observations), allowed)

    def scaled(self, observations: Sequence[NDArray[Any]]) -> tuple[Singles, ...]:
        """Observations, (n, *shape) of each sensor, as a policy takes them."""
        return tuple(self._scaled(index, values) for index, values in enumerate(observations))

    def state_dict(self) -> dict[str, NDArray[np.float64]]:
        """For each vector that is normalised, its running ``mean_<index>``, ``var_<index>`` and ``count_<index>``."""
        state: dict[str, NDArray[np.float64]] = {}
        for index, each in self.statistics.items():
            state |= {f"mean_{index}": each.mean, f"var_{index}": each.var, f"count_{index}": np.array(each.count)}
        return state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
        """
        for index, each in self.statistics.items():
            each.mean, each.var = state[f"mean_{index}"].copy(), state[f"var_{index}"].copy()
            each.count = float(state[f"count_{index}"])

    def _scaled(self, index: int, values: NDArray[Any]) -> Singles:
        if index not in self.statistics:
            return np.asarray(values, np.float32)
        statistics = self.statistics[index]
        scaled = (values - statistics.mean) / np.sqrt(statistics.var + EPSILON)
        limited: Singles = np.clip(scaled, -OBSERVATION_CLIP, OBSERVATION_CLIP).astype(np.float32)
        return limited
