"""Curiosity (section III-B, Fig. 2): an intrinsic reward for what the agent can't predict yet (ICM, ref. [12]).

``Curiosity`` is a stage between normalised observations and any Stable-Baselines3 algorithm: a ``VecEnvWrapper`` that
adds c x r_i to the reward and trains the module on what passes through it.
"""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from torch import Tensor, nn
from torch.nn import functional

from trainer.config import CuriosityConfig


class IntrinsicCuriosityModule(nn.Module):
    """Encoder phi, inverse model (phi, phi' -> action) and forward model (phi, action -> phi').

    Args:
        observation_size: Length of an observation vector.
        action_space: Box (the inverse model's error is squared) or Discrete (cross-entropy).
        config: Sizes and weights.
    """

    def __init__(self, observation_size: int, action_space: spaces.Space[Any], config: CuriosityConfig) -> None:
        super().__init__()
        if isinstance(action_space, spaces.Box):
            self.num_choices, action_size = 0, int(np.prod(action_space.shape))
        elif isinstance(action_space, spaces.Discrete):
            self.num_choices = action_size = int(action_space.n)
        else:
            raise ValueError(
                f"Curiosity takes Box or Discrete actions, not {action_space}; flatten branched actions first."
            )
        hidden, features = config.hidden_size, config.feature_size
        self.forward_weight = config.forward_weight
        self.encoder = _network(observation_size, hidden, features)
        self.inverse_model = _network(2 * features, hidden, action_size)
        self.forward_model = _network(features + action_size, hidden, features)

    def errors(self, observation: Tensor, action: Tensor, next_observation: Tensor) -> tuple[Tensor, Tensor]:
        """Forward error of eq. 6 and inverse error, each (n,).

        Args:
            observation: (n, observation size).
            action: (n, action size), or (n, 1) choices for Discrete actions.
            next_observation: (n, observation size).
        """
        phi, next_phi = self.encoder(observation), self.encoder(next_observation)
        predicted_action = self.inverse_model(torch.cat([phi, next_phi], dim=1))
        if self.num_choices:
            choice = action.long().flatten()
            inverse_error = functional.cross_entropy(predicted_action, choice, reduction="none")
        else:
            inverse_error = (predicted_action - action).square().mean(dim=1)
        return self._forward_error(phi, action, next_phi), inverse_error

    @torch.no_grad()
    def intrinsic_reward(self, observation: Tensor, action: Tensor, next_observation: Tensor) -> Tensor:
        """r_i of eq. 6, (n,): half the squared distance between predicted and actual features."""
        phi, next_phi = self.encoder(torch.cat([observation, next_observation])).chunk(2)
        return self._forward_error(phi, action, next_phi)

    def loss(self, forward_error: Tensor, inverse_error: Tensor) -> Tensor:
        """The weighted sum of both models' mean errors."""
        return self.forward_weight * forward_error.mean() + (1.0 - self.forward_weight) * inverse_error.mean()

    def _forward_error(self, phi: Tensor, action: Tensor, next_phi: Tensor) -> Tensor:
        if self.num_choices:
            action = functional.one_hot(action.long().flatten(), self.num_choices).float()
        predicted = self.forward_model(torch.cat([phi, action], dim=1))
        error: Tensor = 0.5 * (predicted - next_phi).square().sum(dim=1)
        return error


class Curiosity(VecEnvWrapper):
    """Adds c x scale x r_i to every reward, and trains the module after every ``update_every`` steps.

    Monitoring belongs below this stage, so that reported returns stay extrinsic.

    Args:
        venv: Environments with one vector observation, normalised.
        config: Strength, sizes and learning of the module.
        update_every: Steps of each environment between two updates.
        seed: Seeds the networks' initial weights and the minibatches.

    Attributes:
        metrics: Means over the last update: ``forward_loss``, ``inverse_loss``, and ``reward`` (c x scale x r_i).
    """

    def __init__(self, venv: VecEnv, config: CuriosityConfig, update_every: int, seed: int) -> None:
        super().__init__(venv)
        shape = self.observation_space.shape
        if not isinstance(self.observation_space, spaces.Box) or shape is None or len(shape) != 1:
            raise ValueError(f"Curiosity takes one vector observation, not {self.observation_space}.")
        self.config = config
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.module = IntrinsicCuriosityModule(shape[0], self.action_space, config)
        self.optimizer = torch.optim.Adam(self.module.parameters(), lr=config.learning_rate, fused=True)
        self.generator = np.random.default_rng(seed)
        self.metrics: dict[str, float] = {}
        action_size = 1 if self.module.num_choices else int(np.prod(self.action_space.shape or ()))
        self._observations = np.zeros((update_every, self.num_envs, shape[0]), dtype=np.float32)
        self._next_observations = np.zeros_like(self._observations)
        self._actions = np.zeros((update_every, self.num_envs, action_size), dtype=np.float32)
        self._rewards = np.zeros((update_every, self.num_envs), dtype=np.float32)
        self._episode_sums = np.zeros(self.num_envs)
        self._filled = 0

    def reset(self) -> VecEnvObs:
        """Resets the environments."""
        self._last_observation = np.asarray(self.venv.reset(), dtype=np.float32)
        self._episode_sums[:] = 0.0
        return self._last_observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Remembers the actions and passes them on."""
        self._actions[self._filled] = actions.reshape(self.num_envs, -1)
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Adds the intrinsic reward; an ended episode's info has its sum as ``curiosity_return``."""
        observations, rewards, dones, infos = self.venv.step_wait()
        next_observations = np.array(observations, dtype=np.float32)
        if self.config.next_state == "terminal":
            for i in np.flatnonzero(dones):
                next_observations[i] = infos[i]["terminal_observation"]
        row = self._filled
        self._observations[row] = self._last_observation
        self._next_observations[row] = next_observations
        intrinsic = self.module.intrinsic_reward(
            torch.from_numpy(self._observations[row]),
            torch.from_numpy(self._actions[row]),
            torch.from_numpy(next_observations),
        ).numpy() * np.float32(self.config.c * self.config.scale)
        self._rewards[row] = intrinsic
        self._episode_sums += intrinsic
        for i in np.flatnonzero(dones):
            infos[i]["curiosity_return"] = float(self._episode_sums[i])
            self._episode_sums[i] = 0.0
        self._last_observation = np.asarray(observations, dtype=np.float32)
        self._filled += 1
        if self._filled == len(self._rewards):
            self._update()
            self._filled = 0
        return observations, rewards + intrinsic, dones, infos

    def _update(self) -> None:
        columns = [
            torch.from_numpy(column.reshape(-1, column.shape[-1]))
            for column in (self._observations, self._actions, self._next_observations)
        ]
        order = torch.from_numpy(self.generator.permutation(self._rewards.size))
        losses = []
        for chosen in order.chunk(self.config.minibatches):
            forward_error, inverse_error = self.module.errors(*(column[chosen] for column in columns))
            self.optimizer.zero_grad()
            self.module.loss(forward_error, inverse_error).backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
            losses.append((forward_error.mean().item(), inverse_error.mean().item()))
        forward_loss, inverse_loss = np.mean(losses, axis=0)
        self.metrics = {
            "forward_loss": float(forward_loss),
            "inverse_loss": float(inverse_loss),
            "reward": float(self._rewards.mean()),
        }


def _network(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ELU(), nn.Linear(hidden, outputs))
