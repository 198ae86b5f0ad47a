"""The replay buffer: transitions as agents saw them, drawn as the networks of that moment take and value them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from trainer.learning.observation_scaling import ObservationScaling
from trainer.learning.rewards import Signal
from trainer.learning.transitions import Singles, Transitions


class ReplayMemory(DictReplayBuffer):
    """Stable-Baselines3's, whose samples have all rewards added up, and observations scaled, when they are drawn.

    What an intrinsic reward pays and what an observation's mean is changes while a transition lies here.

    Args:
        buffer_size: Transitions; then the oldest go.
        observation_space: With ``obs_0``, ``obs_1``, ... in the sensors' order.
        action_space: Continuous actions.
        device: Where samples go.
        n_envs: 1; agents come as they like.
        optimize_memory_usage: False; what follows a transition need not be the next row.
        scaling: Of observations.
        signals: The rewards.

    Attributes:
        intrinsic_reward: Mean over the last sample of the intrinsic rewards.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Dict,
        action_space: spaces.Box,
        device: torch.device,
        n_envs: int,
        optimize_memory_usage: bool,
        *,
        scaling: ObservationScaling,
        signals: Sequence[Signal],
    ) -> None:
        super().__init__(
            buffer_size,
            observation_space,
            action_space,
            device,
            n_envs,
            optimize_memory_usage,
            handle_timeout_termination=False,  # transitions say themselves whether an episode was only cut
        )
        self._scaling, self._signals = scaling, signals
        self.intrinsic_reward = 0.0

    def store(self, transitions: Transitions) -> None:
        """Adds transitions, with their observations as they came."""
        for index, places in enumerate(zip(transitions.seen, transitions.next_seen, strict=True)):
            seen, then = (
                {f"obs_{number}": each[place] for number, each in enumerate(transitions.observations)}
                for place in places
            )
            action, ended = transitions.decided.continuous[index], transitions.terminated[index]
            self.add(seen, then, action, transitions.rewards[index], ended, [{}])

    def state_dict(self) -> dict[str, Any]:
        """Every transition: arrays, and ``place``, where the next one goes; views."""
        used = self.size()
        return {name: each[:used] for name, each in self._columns().items()} | {"place": self.pos}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            ValueError: It is of another size.
        """
        for name, column in self._columns().items():
            column[: len(state[name])] = state[name]
        self.pos, self.full = state["place"], len(state["rewards"]) == self.buffer_size

    def _columns(self) -> dict[str, NDArray[Any]]:
        return {
            **{f"seen_{name}": each for name, each in self.observations.items()},
            **{f"next_{name}": each for name, each in self.next_observations.items()},
            "actions": self.actions,
            "rewards": self.rewards,
            "dones": self.dones,
        }

    def _get_samples(self, batch_inds: NDArray[Any], env: VecNormalize | None = None) -> DictReplayBufferSamples:  # type: ignore[override]
        before, after = (self._scaled(each, batch_inds) for each in (self.observations, self.next_observations))
        actions = self.to_torch(self.actions[batch_inds, 0])
        choices = torch.zeros(len(batch_inds), 0, dtype=torch.int64, device=actions.device)
        rewards, intrinsic = np.zeros((2, len(batch_inds)), np.float32)
        for signal in self._signals:
            if signal.module is None:
                rewards += signal.strength * self.rewards[batch_inds, 0]
            else:
                paid: Singles = signal.module.reward(list(before.values()), actions, choices, list(after.values()))
                intrinsic += signal.strength * paid
        self.intrinsic_reward = float(intrinsic.mean())
        return DictReplayBufferSamples(
            observations=before,
            actions=actions,
            next_observations=after,
            dones=self.to_torch(self.dones[batch_inds]),
            rewards=self.to_torch((rewards + intrinsic).reshape(-1, 1)),
        )

    def _scaled(self, observations: Mapping[str, NDArray[Any]], rows: NDArray[Any]) -> dict[str, Tensor]:
        scaled = self._scaling.scaled([each[rows, 0] for each in observations.values()])
        return {name: self.to_torch(each) for name, each in zip(observations, scaled, strict=True)}
