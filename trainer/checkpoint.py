"""A run's learned state in one file: weights, optimisers, normaliser statistics and the step count."""

import os
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from trainer.curiosity import Curiosity
from trainer.errors import TrainerError

KEPT = 5


def save_checkpoint(
    folder: Path, counters: dict[str, Any], model: BaseAlgorithm, normaliser: VecNormalize, curiosity: Curiosity | None
) -> Path:
    """Writes ``step-N.pt`` whole or not at all, and removes all but the newest ``KEPT``."""
    state: dict[str, Any] = {
        "counters": counters,
        "policy": model.policy.state_dict(),
        "optimizer": _optimizer_state(model),
        "normaliser": {
            "mean": torch.from_numpy(_statistics(normaliser).mean),
            "var": torch.from_numpy(_statistics(normaliser).var),
            "count": float(_statistics(normaliser).count),
        },
    }
    if curiosity is not None:
        state["curiosity"] = {
            name: torch.from_numpy(array) for name, array in curiosity.module.adam.state_dict().items()
        }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"step-{model.num_timesteps:010d}.pt"
    temporary = path.with_suffix(".tmp")
    with temporary.open("wb") as file:
        torch.save(state, file)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    for old in _checkpoints(folder)[:-KEPT]:
        old.unlink()
    return path


def latest_checkpoint(folder: Path) -> Path:
    """The newest checkpoint of a run.

    Raises:
        TrainerError: There is none.
    """
    found = _checkpoints(folder)
    if not found:
        raise TrainerError(f"{folder} holds no checkpoint (step-*.pt); train the run first.")
    return found[-1]


def find_checkpoint(folder: Path, name: str | None = None) -> Path:
    """A run's checkpoint by its file's name, with or without leading zeros and ending; the newest without a name.

    Raises:
        TrainerError: There is none of that name (those that there are, are named), or none at all.
    """
    if name is None:
        return latest_checkpoint(folder)
    found = {path.stem.removeprefix("step-").lstrip("0"): path for path in _checkpoints(folder)}
    wanted = name.removesuffix(".pt").removeprefix("step-").lstrip("0")
    if wanted not in found:
        known = ", ".join(f"step-{steps}" for steps in found) or "none"
        raise TrainerError(f"There is no checkpoint {name!r} in {folder}; there are: {known}.")
    return found[wanted]


def load_checkpoint(
    path: Path, model: BaseAlgorithm, normaliser: VecNormalize, curiosity: Curiosity | None
) -> dict[str, Any]:
    """Puts a checkpoint's state into a run built with the same settings. Reads tensors only, never code.

    Returns:
        The counters that were saved with it.

    Raises:
        TrainerError: The file is unreadable, or belongs to other settings or another observation or action size.
    """
    try:
        state = torch.load(path, weights_only=True)
    except Exception as error:  # torch raises many kinds for a broken file
        raise TrainerError(f"The checkpoint {path} can't be read; use an older one or train again.") from error
    try:
        size, expected = len(state["normaliser"]["mean"]), len(_statistics(normaliser).mean)
    except (KeyError, TypeError, IndexError) as error:
        raise TrainerError(f"{path} is no checkpoint of a run; take it out of the folder.") from error
    if size != expected:
        raise TrainerError(
            f"The checkpoint {path} is for observations of {size} floats, but the player's have {expected}."
        )
    try:
        model.policy.load_state_dict(state["policy"])
        if state["optimizer"] is not None:
            model.policy.optimizer.load_state_dict(state["optimizer"])
        if curiosity is not None:
            curiosity.module.adam.load_state_dict({name: tensor.numpy() for name, tensor in state["curiosity"].items()})
    except (KeyError, RuntimeError, ValueError) as error:
        raise TrainerError(
            f"The checkpoint {path} is for other settings: {' '.join(str(error).split())[:300]}"
        ) from error
    counters: dict[str, Any] = state["counters"]
    model.num_timesteps = counters["env_steps"]
    statistics = _statistics(normaliser)
    statistics.mean = state["normaliser"]["mean"].numpy()
    statistics.var = state["normaliser"]["var"].numpy()
    statistics.count = state["normaliser"]["count"]
    return counters


def _optimizer_state(model: BaseAlgorithm) -> dict[str, Any] | None:
    """Of a policy that has one optimiser; DDPG's has two, and is saved to be evaluated but not to be continued."""
    optimizer = getattr(model.policy, "optimizer", None)
    return None if optimizer is None else optimizer.state_dict()


def _statistics(normaliser: VecNormalize) -> RunningMeanStd:
    assert isinstance(normaliser.obs_rms, RunningMeanStd)  # one vector observation
    return normaliser.obs_rms


def _checkpoints(folder: Path) -> list[Path]:
    return sorted(folder.glob("step-*.pt"))
