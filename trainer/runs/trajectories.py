"""``trajectories.npz``: every number of a run's newest evaluation, exactly as it crossed the wire."""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trainer.errors import TrainerError
from trainer.files import whole_file
from trainer.runs.evaluation import Episode

VERSION = 1


@dataclass(frozen=True)
class Trajectories:
    """An evaluation's episodes, and what it takes to play them again.

    Attributes:
        behavior: The behavior's name.
        seed: The player's; None if the player had played before the evaluation, so that its episodes don't follow
            from a seed.
        env_steps: Agent steps that the policy had been trained for.
        episodes: Slot by slot.
    """

    behavior: str
    seed: int | None
    env_steps: int
    episodes: list[Episode]


def save_trajectories(path: Path, trajectories: Trajectories) -> None:
    """Writes the file whole or not at all.

    Its arrays, for E episodes of lengths l, n observation floats and S statistics (docs/watching.md):
    ``version``, ``behavior``, ``seed`` (-1: None), ``env_steps``; ``lengths`` (E,), ``slots`` (E,), ``truncated`` (E,);
    ``observations`` (sum of l + 1, n) float32, ``actions`` (sum of l, ...), ``rewards`` (sum of l,) float32;
    ``statistic_names`` (S,), ``statistics`` (E, S) float64, NaN where the player reported none; where the run has them,
    ``values`` (sum of l + 1,) and ``intrinsic_rewards`` (sum of l,) float32.
    """
    episodes = trajectories.episodes
    names = sorted({name for episode in episodes for name in episode.statistics})
    with whole_file(path) as file:
        np.savez_compressed(
            file,
            version=VERSION,
            behavior=trajectories.behavior,
            seed=-1 if trajectories.seed is None else trajectories.seed,
            env_steps=trajectories.env_steps,
            lengths=np.array([len(episode.rewards) for episode in episodes]),
            slots=np.array([episode.slot for episode in episodes]),
            truncated=np.array([episode.truncated for episode in episodes]),
            observations=np.concatenate([episode.observations for episode in episodes]),
            actions=np.concatenate([episode.actions for episode in episodes]),
            rewards=np.concatenate([episode.rewards for episode in episodes]),
            statistic_names=np.array(names, dtype=np.str_),
            statistics=np.array([[episode.statistics.get(name, np.nan) for name in names] for episode in episodes]),
            **_estimates(episodes),
        )


def load_trajectories(path: Path) -> Trajectories:
    """Reads what ``save_trajectories`` wrote; arrays only, never code.

    Raises:
        TrainerError: There is no such file, it is broken, or of another version.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if int(arrays["version"]) != VERSION:
                raise TrainerError(
                    f"{path} has version {int(arrays['version'])}, but {VERSION} was expected; run 'corridor evaluate'."
                )
            lengths = arrays["lengths"]
            ends = np.cumsum(lengths)[:-1]
            observations = np.split(arrays["observations"], np.cumsum(lengths + 1)[:-1])
            actions, rewards = np.split(arrays["actions"], ends), np.split(arrays["rewards"], ends)
            names = arrays["statistic_names"].tolist()
            # Files of before have neither.
            values = np.split(arrays["values"], np.cumsum(lengths + 1)[:-1]) if "values" in arrays else None
            intrinsic = np.split(arrays["intrinsic_rewards"], ends) if "intrinsic_rewards" in arrays else None
            episodes = [
                Episode(
                    observations=observations[row],
                    actions=actions[row],
                    rewards=rewards[row],
                    truncated=bool(arrays["truncated"][row]),
                    slot=int(arrays["slots"][row]),
                    statistics={
                        name: float(value)
                        for name, value in zip(names, arrays["statistics"][row], strict=True)
                        if not np.isnan(value)
                    },
                    values=None if values is None else values[row],
                    intrinsic_rewards=None if intrinsic is None else intrinsic[row],
                )
                for row in range(len(lengths))
            ]
            if not all(_is_whole(episode, length) for episode, length in zip(episodes, lengths, strict=True)):
                raise ValueError("its arrays have different lengths")
            seed = int(arrays["seed"])
            behavior, env_steps = str(arrays["behavior"]), int(arrays["env_steps"])
            return Trajectories(behavior, None if seed < 0 else seed, env_steps, episodes)
    except FileNotFoundError as error:
        raise TrainerError(f"There is no {path}: the run has not been evaluated; run 'corridor evaluate'.") from error
    except (OSError, EOFError, KeyError, IndexError, TypeError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise TrainerError(f"{path} is broken ({error}); run 'corridor evaluate' to write it again.") from error


def _estimates(episodes: list[Episode]) -> dict[str, Any]:
    found = {name: [getattr(episode, name) for episode in episodes] for name in ("values", "intrinsic_rewards")}
    return {name: np.concatenate(each) for name, each in found.items() if each and all(one is not None for one in each)}


def _is_whole(episode: Episode, length: int) -> bool:
    """Whether every array has the length that it should have."""
    states = [episode.observations, *([] if episode.values is None else [episode.values])]
    steps = [episode.rewards, *([] if episode.intrinsic_rewards is None else [episode.intrinsic_rewards])]
    return all(len(each) == length + 1 for each in states) and all(len(each) == length for each in steps)
