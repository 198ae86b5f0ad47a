"""An evaluation in which everything happens that the time line marks, and what networks made of it."""

import dataclasses

import numpy as np
from recorded_run import settings

from corridor_server.corridor.gym_env import CorridorEnv
from trainer.config import RunConfig
from trainer.corridor import corridor_of
from trainer.runs.evaluation import Episode
from trainer.runs.trajectories import Trajectories


def eventful(run_id: str = "eventful", haste: float = 1.0) -> tuple[RunConfig, Trajectories]:
    """Three episodes: onto the switch, into the wall, and into the opponent until the episode fails.

    Args:
        run_id: The run's.
        haste: The largest action; another one is another way through the same episodes.
    """
    # Rewards add up to -3 before an episode fails, so that there is time for all of it.
    config = dataclasses.replace(settings(run_id), environment_parameters={"failure_return": -3.0})
    corridor = dataclasses.asdict(corridor_of(config.penalty, config.environment_parameters))
    return config, Trajectories("Corridor?team=0", 7, 5000, [_episode(corridor, area, haste) for area in range(3)])


def _episode(corridor: dict, area: int, haste: float) -> Episode:
    env = CorridorEnv(area=area, **corridor)
    observation, _ = env.reset(seed=7)
    observations, actions, rewards, walls = [observation], [], [], 0
    terminated = False
    while not terminated:
        if observation[7] < 0.5:
            to = np.array([0.0, 0.3]) - observation[:2]
        elif walls < 3:
            to = np.array([0.0, 1.0])
        else:
            to = observation[8:10] - observation[:2]
        action = (haste * to / max(np.abs(to).max(), 1e-6)).astype(np.float32)
        observation, reward, terminated, _, info = env.step(action)
        walls += abs(reward + 0.1) < 1e-6
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
    rng = np.random.default_rng(area)
    return Episode(
        observations=np.array(observations),
        actions=np.array(actions),
        rewards=np.array(rewards, np.float32),
        truncated=False,
        slot=area,
        statistics=info["statistics"],
        values=np.linspace(0.5, -2.5, len(observations), dtype=np.float32),
        intrinsic_rewards=rng.exponential(0.01, len(rewards)).astype(np.float32),
    )
