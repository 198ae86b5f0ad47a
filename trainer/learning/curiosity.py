"""Curiosity (section III-B): an intrinsic reward beside the environment's own.

``Curiosity`` is a stage between normalised observations and any Stable-Baselines3 algorithm: a ``VecEnvWrapper`` that
adds c x r_i to the reward and trains the module that gives r_i on what passes through it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from trainer.hyperparameters import CuriosityConfig
from trainer.learning.icm import IntrinsicCuriosityModule
from trainer.learning.rnd import RandomNetworkDistillation


class Curiosity(VecEnvWrapper):
    """Adds c x scale x r_i to every reward, and trains the module on every ``update_every`` steps.

    It learns once the next step's actions are on their way, in the time in which the player moves. Monitoring belongs
    below this stage, so that reported returns stay extrinsic.

    Args:
        venv: Environments with one vector observation, normalised.
        config: Strength, sizes and learning of the module.
        update_every: Steps of each environment between two updates.
        seed: Seeds the networks' initial weights and the minibatches.

    Attributes:
        metrics: Means of the module's losses over its last update, and of ``reward`` (c x scale x r_i) over the last
            ``update_every`` steps; each is missing before there is one.
        last_observation: What the running episodes showed last, (n, size) float32.
        episode_sums: c x scale x r_i of the running episodes so far, (n,).
        episodes: Where the running episodes are, as a part that can be written down and taken up again.
    """

    def __init__(self, venv: VecEnv, config: CuriosityConfig, update_every: int, seed: int) -> None:
        super().__init__(venv)
        shape = self.observation_space.shape
        if not isinstance(self.observation_space, spaces.Box) or shape is None or len(shape) != 1:
            raise ValueError(f"Curiosity takes one vector observation, not {self.observation_space}.")
        self.config = config
        self.generator = np.random.default_rng(seed)
        kind = RandomNetworkDistillation if config.intrinsic == "rnd" else IntrinsicCuriosityModule
        self.module = kind(shape[0], self.action_space, config, self.generator)
        self.metrics: dict[str, float] = {}
        action_size = int(np.prod(self.action_space.shape or (1,)))
        self._observations = np.zeros((update_every, self.num_envs, shape[0]), dtype=np.float32)
        self._next_observations = np.zeros_like(self._observations)
        self._actions = np.zeros((update_every, self.num_envs, action_size), dtype=np.float32)
        self._rewards = np.zeros((update_every, self.num_envs), dtype=np.float32)
        self.episode_sums = np.zeros(self.num_envs)
        self._filled = 0
        self.episodes = _RunningEpisodes(self)

    def reset(self) -> VecEnvObs:
        """Resets the environments."""
        self.last_observation = np.asarray(self.venv.reset(), dtype=np.float32)
        self.episode_sums[:] = 0.0
        return self.last_observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Passes the actions on, and learns while the player moves if it is time to."""
        self.venv.step_async(actions)
        self.learn()
        self._actions[self._filled] = actions.reshape(self.num_envs, -1)

    def step_wait(self) -> VecEnvStepReturn:
        """Adds the intrinsic reward; an ended episode's info has its sum as ``curiosity_return``."""
        observations, rewards, dones, infos = self.venv.step_wait()
        observations = np.asarray(observations, dtype=np.float32)
        ended = np.flatnonzero(dones)
        row = self._filled
        next_observations = self._next_observations[row]
        next_observations[:] = observations
        if self.config.next_state == "terminal":
            for i in ended:
                next_observations[i] = infos[i]["terminal_observation"]
        self._observations[row] = self.last_observation
        self.last_observation = observations
        intrinsic = self.module.intrinsic_reward(self._observations[row], self._actions[row], next_observations)
        intrinsic *= np.float32(self.config.c * self.module.scale)
        self._rewards[row] = intrinsic
        self.episode_sums += intrinsic
        for i in ended:
            infos[i]["curiosity_return"] = float(self.episode_sums[i])
            self.episode_sums[i] = 0.0
        self._filled += 1
        if self._filled == len(self._rewards):
            self.metrics = {**self.metrics, "reward": float(self._rewards.mean())}
        return observations, rewards + intrinsic, dones, infos

    def learn(self) -> None:
        """Trains the module, if ``update_every`` steps have passed since it last was."""
        if self._filled < len(self._rewards):
            return
        self._filled = 0
        columns = [
            column.reshape(-1, column.shape[-1])
            for column in (self._observations, self._actions, self._next_observations)
        ]
        order = self.generator.permutation(self._rewards.size)
        minibatches = np.array_split(order, min(self.config.minibatches, len(order)))
        losses = [self.module.learn(*(column[chosen] for column in columns)) for chosen in minibatches]
        means = {name: float(np.mean([loss[name] for loss in losses])) for name in losses[0]}
        self.metrics = {**self.metrics, **means}

    def state_dict(self) -> dict[str, Any]:
        """All that it has learned, the state of its random stream, and the last update's metrics."""
        self.learn()
        return self.module.state_dict() | {"random": self.generator.bit_generator.state, "metrics": self.metrics}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            ValueError: An array is of another size.
        """
        self.module.load_state_dict(state)
        self.generator.bit_generator.state = state["random"]
        self.metrics = dict(state["metrics"])


class _RunningEpisodes:
    """Where a stage's running episodes are."""

    def __init__(self, stage: Curiosity) -> None:
        self._stage = stage

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """``observations``, (n, size), the last ones, and ``sums``, (n,), of the intrinsic reward; views."""
        return {"observations": self._stage.last_observation, "sums": self._stage.episode_sums}

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Goes on in the middle of episodes, instead of after a reset.

        Raises:
            KeyError: Something is missing.
        """
        self._stage.last_observation = state["observations"].copy()
        self._stage.episode_sums[:] = state["sums"]
