"""The algorithms of section III-A, on the same stages: PPO, A2C (the synchronous A3C), TRPO and DDPG."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from sb3_contrib import TRPO
from stable_baselines3 import A2C, DDPG, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import VecEnv

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.hyperparameters import A2CConfig, DDPGConfig, TRPOConfig
from trainer.learning import adam_steps  # noqa: F401 - its marks are for every optimiser
from trainer.learning.lean_ppo import LeanPPO

WINDOW = 100  # episodes that running means are over


def steps_per_update(config: RunConfig) -> int:
    """Steps of each area between two updates of an on-policy algorithm, and of the curiosity module in any case."""
    return config.other.n_steps if isinstance(config.other, A2CConfig) else config.ppo.n_steps


def build_algorithm(config: RunConfig, env: VecEnv) -> BaseAlgorithm:
    """The run's algorithm on its topmost stage; what ``config`` does not say is Stable-Baselines3's default.

    Raises:
        TrainerError: The algorithm can't take the environment's actions.
    """
    ppo, other = config.ppo, config.other
    common: dict[str, Any] = {
        "policy": "MlpPolicy",
        "env": env,
        "gamma": ppo.gamma,
        "stats_window_size": WINDOW,
        "seed": config.seed,
        "device": "cpu",
    }
    sizes = [ppo.hidden_size] * 2
    on_policy = common | {
        "n_steps": steps_per_update(config),
        "gae_lambda": ppo.gae_lambda,
        "policy_kwargs": {"net_arch": {"pi": sizes, "vf": sizes}, "log_std_init": ppo.log_std_init},
    }
    gradient: dict[str, Any] = {"ent_coef": ppo.ent_coef, "vf_coef": ppo.vf_coef, "max_grad_norm": ppo.max_grad_norm}
    if isinstance(other, A2CConfig):
        return A2C(**on_policy, **gradient, learning_rate=_rate(config, other.learning_rate))
    if isinstance(other, TRPOConfig):
        return TRPO(**on_policy, learning_rate=_rate(config, other.learning_rate), target_kl=other.target_kl)
    if isinstance(other, DDPGConfig):
        return _ddpg(other, env, common | {"policy_kwargs": {"net_arch": sizes}})
    algorithm = LeanPPO if isinstance(env.action_space, spaces.Box) else PPO
    return algorithm(
        **on_policy,
        **gradient,
        batch_size=ppo.n_steps * env.num_envs // ppo.minibatches,
        n_epochs=ppo.epochs,
        learning_rate=_rate(config, ppo.learning_rate),
        clip_range=ppo.clip_range,
        clip_range_vf=ppo.clip_range_vf,
    )


def _ddpg(other: DDPGConfig, env: VecEnv, common: dict[str, Any]) -> DDPG:
    if not isinstance(env.action_space, spaces.Box):
        raise TrainerError(f"DDPG takes continuous actions, not {env.action_space}; choose another --algo.")
    size = env.action_space.shape[0]
    common.pop("stats_window_size")  # DDPG takes none, and has 100 of its own
    model = DDPG(
        **common,
        learning_rate=other.learning_rate,
        buffer_size=other.buffer_size,
        learning_starts=other.learning_starts,
        batch_size=other.batch_size,
        train_freq=1,
        gradient_steps=other.gradient_steps,
        tau=other.tau,
        action_noise=NormalActionNoise(np.zeros(size), np.full(size, other.action_noise)),
    )
    # With it, SB3's replay buffer would take rewards from the normaliser, which is below curiosity.
    model._vec_normalize_env = None
    return model


def _rate(config: RunConfig, at_first: float) -> float | Callable[[float], float]:
    return (lambda remaining: at_first * remaining) if config.ppo.anneal else at_first
