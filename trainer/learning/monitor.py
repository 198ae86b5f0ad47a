"""Extrinsic returns and lengths of episodes: Stable-Baselines3's ``VecMonitor``, below curiosity and normalisation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn


class EpisodeMonitor(VecMonitor):
    """``VecMonitor`` that reports no episode which a player's death cut."""

    def step_wait(self) -> VecEnvStepReturn:
        """Adds ``episode`` to the info of every episode that was played to its end."""
        observations, rewards, dones, infos = super().step_wait()
        for slot in np.flatnonzero(dones):
            if "dropped" in infos[slot]:
                del infos[slot]["episode"]
        return observations, rewards, dones, infos

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """What the running episodes have so far: ``returns`` and ``lengths``, (slots,); views."""
        return {"returns": self.episode_returns, "lengths": self.episode_lengths}

    def load_state_dict(self, state: dict[str, NDArray[Any]]) -> None:
        """Goes on in the middle of episodes.

        Raises:
            KeyError: Something is missing.
        """
        self.episode_returns, self.episode_lengths = state["returns"].copy(), state["lengths"].copy()
