"""What a run's networks make of an evaluated episode: the critic's values, and curiosity's rewards."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy

from trainer.learning.stages import Stages
from trainer.runs.evaluation import Episode


def with_estimates(stages: Stages, episodes: Sequence[Episode]) -> list[Episode]:
    """The episodes with ``values`` and ``intrinsic_rewards``, as far as the run has networks that give them.

    Both come from the networks as they are now, as the actions did. The last reward is that of the episode's own end,
    also where curiosity has learned from the next episode's beginning in its place (``next_state``), which pays far
    more. DDPG's critic needs an action, so it gives no value of an observation alone.

    Args:
        stages: Of the run, with what it has learned.
        episodes: Of ``evaluate`` on the same stages.
    """
    return [
        replace(episode, values=_values(stages, episode), intrinsic_rewards=_intrinsic_rewards(stages, episode))
        for episode in episodes
    ]


def _values(stages: Stages, episode: Episode) -> NDArray[np.float32] | None:
    policy = stages.model.policy
    if not isinstance(policy, ActorCriticPolicy):
        return None
    with torch.no_grad():
        observations = torch.from_numpy(stages.normaliser.normalize_obs(episode.observations))
        values: NDArray[np.float32] = policy.predict_values(observations).numpy()[:, 0]
    return values


def _intrinsic_rewards(stages: Stages, episode: Episode) -> NDArray[np.float32] | None:
    curiosity = stages.curiosity
    if curiosity is None:
        return None
    observations = stages.normaliser.normalize_obs(episode.observations)
    actions = episode.actions.reshape(len(episode.actions), -1).astype(np.float32)
    rewards = curiosity.module.intrinsic_reward(observations[:-1], actions, observations[1:])
    return rewards * np.float32(curiosity.config.c * curiosity.module.scale)
