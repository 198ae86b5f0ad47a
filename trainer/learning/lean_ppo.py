"""Stable-Baselines3's PPO with less overhead: the same updates, to rounding, in a fraction of the time.

With networks this small, most of SB3's time is bookkeeping of Python and autograd for each minibatch. Here they are a
``LeanActorCritic``, which leaves everything where SB3 has it: ``predict``, ``state_dict`` and a switch back to
``PPO.train`` all see the same numbers.
"""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv

from trainer.learning.actor_critic import HALF_LOG_TAU
from trainer.learning.lean_actor_critic import LeanActorCritic, normalised, policy_loss
from trainer.learning.transitions import Singles


class LeanPPO(PPO):
    """PPO for Box actions, and an actor and a critic of dense layers.

    Takes SB3's arguments; advantages are normalised, and state-dependent exploration and ``target_kl`` are not used.

    Raises:
        ValueError: The policy is of another form.
    """

    def _setup_model(self) -> None:
        super()._setup_model()
        space = self.action_space
        if not isinstance(space, spaces.Box) or self.policy.use_sde or not LeanActorCritic.fits(self.policy):
            raise ValueError("LeanPPO takes Box actions, and dense tanh or SiLU layers on the CPU; use PPO for others.")
        self._networks = LeanActorCritic(self.policy)
        self._sizes = self._networks.actor.weights[0].shape[1], space.shape[0]

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
            actions, _, log_probs = self._networks.act(observations, None, noise)
            env.step_async(np.minimum(np.maximum(actions, low), high))
            # What the player need not wait for.
            rollout_buffer.observations[row] = observations
            rollout_buffer.actions[row] = actions
            rollout_buffer.episode_starts[row] = self._last_episode_starts
            rollout_buffer.values[row] = self._networks.values(observations)[:, 0]
            rollout_buffer.log_probs[row] = log_probs
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
                    rewards[slot] += self.gamma * self._networks.values(last[None])[0, 0]
            rollout_buffer.rewards[row] = rewards
            observations = np.array(new_observations, dtype=np.float32)
            self._last_obs = observations
            self._last_episode_starts = dones
        rollout_buffer.pos, rollout_buffer.full = n_rollout_steps, True
        last_values = torch.from_numpy(self._networks.values(observations)[:, 0])
        rollout_buffer.compute_returns_and_advantage(last_values=last_values, dones=dones)
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """One update, as ``PPO.train``."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        networks = self._networks
        assert callable(self.clip_range)
        clip_range = float(self.clip_range(self._current_progress_remaining))
        clip_range_vf = None
        if self.clip_range_vf is not None:
            assert callable(self.clip_range_vf)
            clip_range_vf = float(self.clip_range_vf(self._current_progress_remaining))
        buffer = self.rollout_buffer
        rows = _flattened(buffer, *self._sizes)
        measures = []
        for _ in range(self.n_epochs):
            order = np.random.permutation(len(rows))  # noqa: NPY002 - the draw that SB3's buffer makes
            for start in range(0, len(rows), self.batch_size):
                batch = rows[order[start : start + self.batch_size]]
                measures.append(self._differentiate(batch, clip_range, clip_range_vf))
                networks.adam.limit(self.max_grad_norm)
                networks.adam.step(self.policy.optimizer)
        self._n_updates += self.n_epochs
        policy_loss, value_loss, clip_fraction, approx_kl = np.mean(measures, axis=0).tolist()
        entropy = float((networks.log_std + np.float32(0.5 + HALF_LOG_TAU)).sum())
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

    def _differentiate(
        self, batch: Singles, clip_range: float, clip_range_vf: float | None
    ) -> tuple[float, float, float, float]:
        """Fills in the gradient of PPO's loss (eq. 5) for a minibatch of rows of ``_flattened``.

        Returns:
            Policy loss, value loss, share of clipped ratios, and the approximate KL divergence.
        """
        networks, (size, actions) = self._networks, self._sizes
        observations, taken = np.ascontiguousarray(batch[:, :size]), batch[:, size : size + actions]
        old_log_prob, advantage, old_value, target = batch[:, size + actions :].T
        nothing = np.empty((len(batch), 0), np.int64)
        judged = networks.judge(observations, None, taken, nothing)
        slope, (loss, outside, divergence) = policy_loss(
            judged.log_probs - old_log_prob, normalised(advantage), clip_range
        )
        networks.differentiate_actor(judged, nothing, slope, -self.ent_coef)

        given, values = networks.critic(observations)
        difference = values[:, 0] - old_value
        if clip_range_vf is None:
            error, counts = values[:, 0] - target, np.float32(1.0)
        else:
            error = old_value + np.clip(difference, -clip_range_vf, clip_range_vf) - target
            counts = np.abs(difference) <= clip_range_vf
        value_slope = error * np.float32(2.0 * self.vf_coef / len(batch)) * counts
        networks.critic.differentiate(given, value_slope[:, None])
        return loss, float(np.square(error).mean()), outside, divergence


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
