"""Evaluation: whole episodes of a policy without learning, and what they amount to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trainer.corridor import OPPONENT_CONTACTS, SUCCESS, WALL_CONTACTS

if TYPE_CHECKING:  # replays and the page, which only read episodes, start without it
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv, VecNormalize

# The statistics that rates are made from.
_REPORTED = {"success_rate": SUCCESS, "opponent_contact_rate": OPPONENT_CONTACTS, "wall_contact_rate": WALL_CONTACTS}


@dataclass(frozen=True)
class Episode:
    """One evaluated episode.

    Attributes:
        observations: From the first to the last (the terminal one), not normalised, (length + 1, n).
        actions: As sent to the player, (length, ...).
        rewards: Extrinsic, (length,).
        truncated: It was cut by a step limit; every other end is terminated.
        slot: The environment that it was played in; episodes of a slot are in the order in which they were played.
        statistics: What the player reported at its end, by name; empty if it reports none.
        values: What the policy's critic makes of each observation, (length + 1,); None if it has none, or nobody
            asked.
        intrinsic_rewards: What curiosity would have added to each reward, c x scale x r_i, (length,); None without
            curiosity, or if nobody asked.
    """

    observations: NDArray[np.float32]
    actions: NDArray[Any]
    rewards: NDArray[np.float32]
    truncated: bool
    slot: int
    statistics: dict[str, float]
    values: NDArray[np.float32] | None = None
    intrinsic_rewards: NDArray[np.float32] | None = None

    @property
    def succeeded(self) -> bool | None:
        """Whether the task was completed; None if the player doesn't say."""
        return self.statistics[SUCCESS] > 0.5 if SUCCESS in self.statistics else None


def evaluate(
    model: "BaseAlgorithm",
    normaliser: "VecNormalize",
    player: "VecEnv",
    episodes: int,
    deterministic: bool = True,
    tell: Callable[[int], None] = lambda played: None,
) -> list[Episode]:
    """Plays episodes with the policy, as it is, on unwrapped environments.

    Each slot plays a number of episodes fixed beforehand: taking those that end first would favour short ones.

    Args:
        model: Has the policy.
        normaliser: Has the observation statistics, which stay as they are.
        player: The environments.
        episodes: How many to play.
        deterministic: Take the policy's mean action instead of a sample.
        tell: Told how many episodes have been played, whenever one has.

    Returns:
        The episodes, slot by slot.
    """
    quotas = [episodes // player.num_envs + (slot < episodes % player.num_envs) for slot in range(player.num_envs)]
    played: list[list[Episode]] = [[] for _ in quotas]
    observations = np.asarray(player.reset())
    path: list[list[NDArray[np.float32]]] = [[observation] for observation in observations]
    taken: list[list[NDArray[Any]]] = [[] for _ in quotas]
    rewards: list[list[float]] = [[] for _ in quotas]
    while any(len(done) < quota for done, quota in zip(played, quotas, strict=True)):
        actions, _ = model.predict(np.asarray(normaliser.normalize_obs(observations)), deterministic=deterministic)
        stepped, step_rewards, dones, infos = player.step(actions)
        observations = np.asarray(stepped)
        for slot, quota in enumerate(quotas):
            if len(played[slot]) == quota:
                continue
            taken[slot].append(actions[slot])
            rewards[slot].append(float(step_rewards[slot]))
            if not dones[slot]:
                path[slot].append(observations[slot])
                continue
            if "dropped" in infos[slot]:  # the player died and was started again
                path[slot], taken[slot], rewards[slot] = [observations[slot]], [], []
                continue
            path[slot].append(infos[slot]["terminal_observation"])
            played[slot].append(
                Episode(
                    observations=np.array(path[slot]),
                    actions=np.array(taken[slot]),
                    rewards=np.array(rewards[slot], np.float32),
                    truncated=bool(infos[slot].get("TimeLimit.truncated", False)),
                    slot=slot,
                    statistics=infos[slot].get("statistics", {}),
                )
            )
            path[slot], taken[slot], rewards[slot] = [observations[slot]], [], []
            tell(sum(map(len, played)))
    return [episode for slot in played for episode in slot]


def summarise(episodes: Sequence[Episode]) -> dict[str, Any]:
    """The ``evaluation`` part of ``summary.json``; None for a rate that an episode has not been reported for."""
    return {
        "episodes": len(episodes),
        "success_rate": _share(episodes, "success_rate"),
        "mean_return": float(np.mean([episode.rewards.sum(dtype=np.float64) for episode in episodes])),
        "mean_episode_length": float(np.mean([len(episode.rewards) for episode in episodes])),
        "opponent_contact_rate": _share(episodes, "opponent_contact_rate"),
        "wall_contact_rate": _share(episodes, "wall_contact_rate"),
        "mean_success_length": _mean_length([episode for episode in episodes if episode.succeeded]),
        "success_unknown": unreported(episodes, "success_rate"),
    }


def unreported(episodes: Sequence[Episode], measure: str) -> int:
    """For how many episodes the player has not reported what a rate is made from; 0 for any other measure."""
    return sum(_REPORTED[measure] not in episode.statistics for episode in episodes) if measure in _REPORTED else 0


def _mean_length(episodes: Sequence[Episode]) -> float | None:
    return float(np.mean([len(episode.rewards) for episode in episodes])) if episodes else None


def _share(episodes: Sequence[Episode], rate: str) -> float | None:
    """Share of all episodes in which a rate's statistic is above 0; None if one of them has none."""
    if unreported(episodes, rate):
        return None
    return float(np.mean([episode.statistics[_REPORTED[rate]] > 0 for episode in episodes]))
