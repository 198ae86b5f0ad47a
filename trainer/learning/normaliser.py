"""Normalised observations (eq. 7): Stable-Baselines3's ``VecNormalize``, to the bit, with less work at every step."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from trainer.errors import TrainerError

OBSERVATION_CLIP = 10.0


class ObservationStatistics(RunningMeanStd):
    """``RunningMeanStd``: the same numbers to the bit, without the checks of ``np.mean`` and ``np.var``."""

    def update(self, arr: NDArray[Any]) -> None:
        """Takes (n, size) floats into the mean and variance."""
        count = arr.dtype.type(len(arr))
        mean = np.add.reduce(arr, axis=0) / count
        self.update_from_moments(mean, np.add.reduce(np.square(arr - mean), axis=0) / count, len(arr))


class ObservationNormaliser(VecNormalize):
    """``VecNormalize`` without what a vector observation's eq. 7 does not need.

    It doesn't follow the return's variance, which is for ``norm_reward``, and makes no copy beforehand.
    """

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv, norm_reward=False, clip_obs=OBSERVATION_CLIP)
        shape = self.observation_space.shape or ()
        self.obs_rms = ObservationStatistics(shape=shape)  # type: ignore[assignment]  # for SB3, first a dict's

    @property
    def statistics(self) -> RunningMeanStd:
        """Running mean and variance of the observations, (size,) float64 each."""
        assert isinstance(self.obs_rms, RunningMeanStd)  # one vector observation
        return self.obs_rms

    def normalize_obs(self, obs: Any) -> NDArray[np.float32]:
        """Eq. 7: (n, size) observations less their running mean, over their running deviation, limited to +-10."""
        statistics = self.statistics
        scaled = (obs - statistics.mean) / np.sqrt(statistics.var + self.epsilon)
        limited: NDArray[np.float32] = np.minimum(np.maximum(scaled, -self.clip_obs), self.clip_obs).astype(np.float32)
        return limited

    def state_dict(self) -> dict[str, NDArray[np.float64]]:
        """``mean`` and ``var``, (size,), and ``count``; views where they can be."""
        statistics = self.statistics
        return {"mean": statistics.mean, "var": statistics.var, "count": np.array(statistics.count, np.float64)}

    def load_state_dict(self, state: Mapping[str, NDArray[np.float64]]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            TrainerError: The statistics are of observations of another size.
        """
        statistics, mean = self.statistics, state["mean"]
        if mean.shape != statistics.mean.shape:
            raise TrainerError(
                f"The checkpoint is for observations of {len(mean)} floats, but the player's have "
                f"{len(statistics.mean)}."
            )
        statistics.mean, statistics.var, statistics.count = mean.copy(), state["var"].copy(), float(state["count"])

    def _update_reward(self, reward: NDArray[np.float64]) -> None:
        pass
