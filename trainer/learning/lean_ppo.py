"""Stable-Baselines3's PPO with less overhead: the same updates, to rounding, in a fraction of the time.

With networks this small, most of SB3's time is bookkeeping of Python and autograd for each minibatch. Here actor and
critic, which have the same hidden layers, go through one batched product a layer, the gradient is written out, and Adam
works on one flat vector. Everything stays where SB3 has it: parameters and Adam's moments are views of flat vectors, so
that ``predict``, ``state_dict`` and a switch back to ``PPO.train`` all see the same numbers.
"""

import math
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from trainer.learning.networks import Adam, Singles

LOG_SQRT_2_PI = np.float32(0.5 * math.log(2.0 * math.pi))
ACTOR, CRITIC, BOTH = slice(0, 1), slice(1, 2), slice(0, 2)


class LeanPPO(PPO):
    """PPO for Box actions and actor and critic of two hidden tanh layers each, of one size.

    Takes SB3's arguments; advantages are normalised, and state-dependent exploration and ``target_kl`` are not used.

    Raises:
        ValueError: The policy is of another form.
    """

    def _setup_model(self) -> None:
        super()._setup_model()
        self._networks = _Networks(self.policy, self.action_space)

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Collects a rollout as ``OnPolicyAlgorithm.collect_rollouts`` does; False if the callback stopped it."""
        assert isinstance(self.action_space, spaces.Box)
        assert self._last_obs is not None
        low, high = self.action_space.low, self.action_space.high
        rollout_buffer.reset()
        callback.on_rollout_start()
        observations = np.asarray(self._last_obs, dtype=np.float32)
        noise = self._networks.noise(env.num_envs)
        for row in range(n_rollout_steps):
            actions = self._networks.act(observations, noise)
            env.step_async(np.minimum(np.maximum(actions, low), high))
            # What the player need not wait for.
            rollout_buffer.observations[row] = observations
            rollout_buffer.actions[row] = actions
            rollout_buffer.episode_starts[row] = self._last_episode_starts
            rollout_buffer.values[row] = self._networks.values(observations)
            rollout_buffer.log_probs[row] = self._networks.log_probs(noise)
            if row + 1 < n_rollout_steps:
                noise = self._networks.noise(env.num_envs)
            new_observations, rewards, dones, infos = env.step_wait()
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            rewards = np.array(rewards, dtype=np.float32)
            for slot in np.flatnonzero(dones):
                if infos[slot].get("TimeLimit.truncated", False):
                    last = np.asarray(infos[slot]["terminal_observation"], dtype=np.float32)
                    rewards[slot] += self.gamma * self._networks.values(last[None])[0]
            rollout_buffer.rewards[row] = rewards
            observations = np.array(new_observations, dtype=np.float32)
            self._last_obs = observations
            self._last_episode_starts = dones
        rollout_buffer.pos, rollout_buffer.full = n_rollout_steps, True
        last_values = torch.from_numpy(self._networks.values(observations))
        rollout_buffer.compute_returns_and_advantage(last_values=last_values, dones=dones)
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """One update, as ``PPO.train``."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        networks = self._networks
        networks.bind(self.policy.optimizer)
        assert callable(self.clip_range)
        clip_range = float(self.clip_range(self._current_progress_remaining))
        clip_range_vf = None
        if self.clip_range_vf is not None:
            assert callable(self.clip_range_vf)
            clip_range_vf = float(self.clip_range_vf(self._current_progress_remaining))
        buffer = self.rollout_buffer
        rows = _flattened(buffer, networks.observation_size, networks.action_size)
        measures = []
        for _ in range(self.n_epochs):
            order = np.random.permutation(len(rows))  # noqa: NPY002 - the draw that SB3's buffer makes
            for start in range(0, len(rows), self.batch_size):
                batch = rows[order[start : start + self.batch_size]]
                measures.append(networks.differentiate(batch, clip_range, clip_range_vf, self.ent_coef, self.vf_coef))
                networks.descend(self.max_grad_norm)
        networks.publish()
        self._n_updates += self.n_epochs
        policy_loss, value_loss, clip_fraction, approx_kl = np.mean(measures, axis=0).tolist()
        entropy = float((networks.log_std + np.float32(0.5) + LOG_SQRT_2_PI).sum())
        self.logger.record("train/entropy_loss", -entropy)
        self.logger.record("train/policy_gradient_loss", policy_loss)
        self.logger.record("train/value_loss", value_loss)
        self.logger.record("train/approx_kl", approx_kl)
        self.logger.record("train/clip_fraction", clip_fraction)
        self.logger.record("train/loss", policy_loss - self.ent_coef * entropy + self.vf_coef * value_loss)
        explained = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.logger.record("train/explained_variance", float(explained))
        self.logger.record("train/std", float(np.exp(networks.log_std).mean()))
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/clip_range", clip_range)


class _Networks:
    """Actor and critic side by side: parameters, gradients and Adam's moments as views of flat vectors.

    Torch's parameters are views of the same memory.
    """

    def __init__(self, policy: ActorCriticPolicy, action_space: spaces.Space[Any]) -> None:
        actor, critic = policy.mlp_extractor.policy_net, policy.mlp_extractor.value_net
        if not isinstance(action_space, spaces.Box) or policy.use_sde or not _same_form(actor, critic):
            raise ValueError("LeanPPO takes Box actions and two hidden tanh layers of one size; use PPO for others.")
        pairs = list(zip(actor.parameters(), critic.parameters(), strict=True))
        action, value = policy.action_net, policy.value_net
        assert isinstance(action, nn.Linear)
        assert isinstance(policy.log_std, nn.Parameter)
        singles: list[Tensor] = [action.weight, action.bias, value.weight, value.bias, policy.log_std]
        # Every pair is one block, so that both networks are one stacked array.
        self._parameters: list[Tensor] = [each for pair in pairs for each in pair] + singles
        size = sum(parameter.numel() for parameter in self._parameters)
        if size != sum(parameter.numel() for parameter in policy.parameters()):
            raise ValueError("LeanPPO knows no shared or further layers; use PPO for this policy.")
        self._adam = Adam(size)
        self._published_steps = [torch.tensor(0.0) for _ in self._parameters]
        for parameter, view in zip(self._parameters, self._views(self._adam.parameters), strict=True):
            view[...] = parameter.detach().numpy()
            parameter.data = torch.from_numpy(view)
        self._w1, self._b1, self._w2, self._b2 = self._stacked(self._adam.parameters)
        self._gw1, self._gb1, self._gw2, self._gb2 = self._stacked(self._adam.gradient)
        *_, self._gwa, self._gba, self._gwv, self._gbv, self._g_log_std = self._views(self._adam.gradient)
        *_, self._wa, self._ba, self._wv, self._bv, self.log_std = self._views(self._adam.parameters)
        self.observation_size, self.action_size = self._parameters[0].shape[1], action.out_features
        self._optimizer: torch.optim.Optimizer | None = None

    def bind(self, optimizer: torch.optim.Optimizer) -> None:
        """Makes the optimiser's state views of the flat moments; takes over what it holds, after a load say."""
        first = optimizer.state[self._parameters[0]]
        if first and first["step"] is self._published_steps[0] and self._optimizer is optimizer:
            return
        self._optimizer = optimizer
        moments, squares = self._views(self._adam.moment), self._views(self._adam.square)
        for parameter, step, moment, square in zip(
            self._parameters, self._published_steps, moments, squares, strict=True
        ):
            state = optimizer.state[parameter]
            if state:
                moment[...] = state["exp_avg"].numpy()
                square[...] = state["exp_avg_sq"].numpy()
                self._adam.steps = int(state["step"])
            state.update(step=step, exp_avg=torch.from_numpy(moment), exp_avg_sq=torch.from_numpy(square))

    def publish(self) -> None:
        """Tells the optimiser how many steps were taken; everything else it sees already."""
        for step in self._published_steps:
            step.fill_(self._adam.steps)

    def noise(self, count: int) -> Singles:
        """Standard normal numbers for the actions of ``count`` observations, (count, actions), from torch's stream."""
        noise: Singles = torch.randn(count, self.action_size).numpy()
        return noise

    def act(self, observations: Singles, noise: Singles) -> Singles:
        """Samples actions, (n, actions)."""
        _, hidden = self._hidden(observations, ACTOR)
        actions: Singles = hidden[0] @ self._wa.T + self._ba + noise * np.exp(self.log_std)
        return actions

    def log_probs(self, noise: Singles) -> Singles:
        """Log probabilities, (n,), of the actions that ``act`` made of noise."""
        log_probs: Singles = -(0.5 * np.square(noise) + self.log_std + LOG_SQRT_2_PI).sum(axis=1)
        return log_probs

    def values(self, observations: Singles) -> Singles:
        """The critic's values, (n,)."""
        _, hidden = self._hidden(observations, CRITIC)
        values: Singles = (hidden[0] @ self._wv.T + self._bv)[:, 0]
        return values

    def differentiate(
        self, batch: Singles, clip_range: float, clip_range_vf: float | None, ent_coef: float, vf_coef: float
    ) -> tuple[float, float, float, float]:
        """Fills in the gradient of PPO's loss (eq. 5) for a minibatch of rows of ``_flattened``.

        Returns:
            Policy loss, value loss, share of clipped ratios, and the approximate KL divergence.
        """
        size, actions = self.observation_size, self.action_size
        observations, taken = batch[:, :size], batch[:, size : size + actions]
        old_log_prob, advantage, old_value, target = batch[:, size + actions :].T
        count = np.float32(len(batch))
        advantage = (advantage - advantage.mean()) / (advantage.std(ddof=1) + np.float32(1e-8))

        first, second = self._hidden(observations, BOTH)
        mean = second[0] @ self._wa.T + self._ba
        value = second[1] @ self._wv[0] + self._bv
        inverse_std = np.exp(-self.log_std)
        deviation = (taken - mean) * inverse_std
        squared_deviation = np.square(deviation)
        log_ratio = -(0.5 * squared_deviation + self.log_std + LOG_SQRT_2_PI).sum(axis=1) - old_log_prob
        ratio = np.exp(log_ratio)
        outside = np.abs(ratio - 1.0) > clip_range
        plain, clipped = advantage * ratio, advantage * np.clip(ratio, 1.0 - clip_range, 1.0 + clip_range)
        # d loss / d log probability; a clipped ratio that is the smaller of the two has no gradient
        slope = np.where(outside & (clipped < plain), np.float32(0.0), plain / -count)[:, None]

        difference = value - old_value
        if clip_range_vf is None:
            error = value - target
            value_slope = error * (2.0 * vf_coef / count)
        else:
            error = old_value + np.clip(difference, -clip_range_vf, clip_range_vf) - target
            value_slope = error * (2.0 * vf_coef / count) * (np.abs(difference) <= clip_range_vf)

        self._g_log_std[...] = (slope * (squared_deviation - 1.0)).sum(axis=0) - ent_coef
        mean_slope = slope * (deviation * inverse_std)
        np.matmul(mean_slope.T, second[0], out=self._gwa)
        mean_slope.sum(axis=0, out=self._gba)
        np.matmul(value_slope, second[1], out=self._gwv[0])
        self._gbv[0] = value_slope.sum()
        back = np.empty_like(second)
        np.matmul(mean_slope, self._wa, out=back[0])
        np.multiply(value_slope[:, None], self._wv, out=back[1])
        back *= 1.0 - np.square(second)
        np.matmul(back.transpose(0, 2, 1), first, out=self._gw2)
        back.sum(axis=1, keepdims=True, out=self._gb2)
        back = np.matmul(back, self._w2)
        back *= 1.0 - np.square(first)
        np.matmul(back.transpose(0, 2, 1), observations, out=self._gw1)
        back.sum(axis=1, keepdims=True, out=self._gb1)
        return (
            float(-np.minimum(plain, clipped).mean()),
            float(np.square(error).mean()),
            float(outside.mean()),
            float((ratio - 1.0 - log_ratio).mean()),
        )

    def descend(self, max_grad_norm: float) -> None:
        """Limits the gradient's norm and takes one step of Adam, with the bound optimiser's settings."""
        assert self._optimizer is not None
        group = self._optimizer.param_groups[0]
        gradient = self._adam.gradient
        norm = math.sqrt(float(gradient @ gradient))
        if norm + 1e-6 > max_grad_norm:
            gradient *= np.float32(max_grad_norm / (norm + 1e-6))
        self._adam.descend(group["lr"], group["betas"], group["eps"])

    def _hidden(self, observations: Singles, networks: slice) -> tuple[Singles, Singles]:
        """Both hidden layers of some networks, (networks, n, units): actor first."""
        first = np.matmul(observations, self._w1[networks].transpose(0, 2, 1))
        first += self._b1[networks]
        np.tanh(first, out=first)
        second = np.matmul(first, self._w2[networks].transpose(0, 2, 1))
        second += self._b2[networks]
        np.tanh(second, out=second)
        return first, second

    def _views(self, flat: Singles) -> list[Singles]:
        ends = np.cumsum([parameter.numel() for parameter in self._parameters])[:-1]
        parts = np.split(flat, ends)
        return [part.reshape(parameter.shape) for part, parameter in zip(parts, self._parameters, strict=True)]

    def _stacked(self, flat: Singles) -> tuple[Singles, Singles, Singles, Singles]:
        """Weights (2, out, in) and biases (2, 1, out) of both hidden layers."""
        hidden, size = self._parameters[0].shape
        lengths = np.cumsum([2 * hidden * size, 2 * hidden, 2 * hidden * hidden, 2 * hidden])
        w1, b1, w2, b2, _ = np.split(flat, lengths)
        return (
            w1.reshape(2, hidden, size),
            b1.reshape(2, 1, hidden),
            w2.reshape(2, hidden, hidden),
            b2.reshape(2, 1, hidden),
        )


def _same_form(actor: nn.Sequential, critic: nn.Sequential) -> bool:
    """Whether both are Linear, Tanh, Linear, Tanh, of the same sizes and one hidden size."""
    shapes = [[tuple(parameter.shape) for parameter in network.parameters()] for network in (actor, critic)]
    layers = [[type(layer) for layer in network] for network in (actor, critic)]
    if layers != [[nn.Linear, nn.Tanh, nn.Linear, nn.Tanh]] * 2 or shapes[0] != shapes[1]:
        return False
    return shapes[0][0][0] == shapes[0][2][0]


def _flattened(buffer: RolloutBuffer, size: int, actions: int) -> Singles:
    """A rollout's transitions as rows, environment by environment as SB3's buffer orders them.

    Each is observation, action, old log probability, advantage, old value, return.
    """
    steps, slots = buffer.rewards.shape
    rows = np.empty((slots, steps, size + actions + 4), dtype=np.float32)
    rows[..., :size] = buffer.observations.swapaxes(0, 1)
    rows[..., size : size + actions] = buffer.actions.swapaxes(0, 1)
    columns = (buffer.log_probs, buffer.advantages, buffer.values, buffer.returns)
    for place, column in enumerate(columns, size + actions):
        rows[..., place] = column.T
    return rows.reshape(slots * steps, -1)
