"""What a run logs while it goes: ``progress.csv`` and TensorBoard, as outputs of Stable-Baselines3's logger."""

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import KVWriter
from torch.utils.tensorboard import SummaryWriter

from trainer.errors import TrainerError
from trainer.files import write_whole

# Columns of progress.csv and the logger's tags that fill them; the last two are timing and differ between runs.
PROGRESS_COLUMNS = {
    "env_steps": "time/total_timesteps",
    "episodes": "rollout/episodes",
    "mean_return": "rollout/ep_rew_mean",
    "mean_episode_length": "rollout/ep_len_mean",
    "success_rate": "rollout/success_rate",
    "intrinsic_reward": "rollout/intrinsic_reward",
    "curiosity_return": "Policy/Curiosity Reward",
    "curiosity_forward_loss": "Losses/Curiosity Forward Loss",
    "curiosity_inverse_loss": "Losses/Curiosity Inverse Loss",
    "policy_loss": "train/policy_gradient_loss",
    "value_loss": "train/value_loss",
    "entropy_loss": "train/entropy_loss",
    "approx_kl": "train/approx_kl",
    "clip_fraction": "train/clip_fraction",
    "explained_variance": "train/explained_variance",
    "action_std": "train/std",
    "steps_per_second": "time/fps",
    "wall_seconds": "time/time_elapsed",
}


class ProgressFile(KVWriter):
    """``progress.csv``: a Stable-Baselines3 log output with fixed columns, so that equal runs give equal files.

    Args:
        path: The file.
        steps: Steps of the checkpoint that a resumed run goes on from: later rows are dropped. 0 begins anew.
    """

    def __init__(self, path: Path, steps: int) -> None:
        rows = []
        if steps and path.is_file():
            try:
                with path.open(newline="", encoding="utf-8") as former:
                    rows = [row for row in csv.DictReader(former) if _steps_of(row) <= steps]
            except (csv.Error, ValueError) as error:
                raise TrainerError(f"{path} is broken ({error}); delete it to go on without its rows.") from error
        with io.StringIO(newline="") as text:
            writer = csv.DictWriter(text, list(PROGRESS_COLUMNS), restval="", extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
            write_whole(path, text.getvalue())
        self._file = path.open("a", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._file, list(PROGRESS_COLUMNS))

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Appends a row."""
        self._writer.writerow({column: key_values.get(tag) for column, tag in PROGRESS_COLUMNS.items()})
        self._file.flush()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


class TensorBoardLog(KVWriter):
    """TensorBoard's event files, one per part of a run.

    Args:
        folder: Where they go.
        steps: Steps of the checkpoint that a resumed run goes on from: later values, which a run that was killed has
            and its resumed part writes again, are purged by whoever reads the files. 0 begins anew.
    """

    def __init__(self, folder: Path, steps: int) -> None:
        self._writer: Any = SummaryWriter(str(folder), purge_step=steps + 1 if steps else 0)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Writes every number that is not excluded, and waits until the file has them."""
        for name, value in key_values.items():
            if isinstance(value, int | float | np.number) and "tensorboard" not in (key_excluded[name] or ()):
                self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def close(self) -> None:
        """Closes the file."""
        self._writer.close()


def _steps_of(row: dict[str, str]) -> float:
    """The steps of a row of ``progress.csv``; infinitely many for one that a full disk cut."""
    whole = len(row) == len(PROGRESS_COLUMNS) and None not in row.values()
    return float(row["env_steps"]) if whole else math.inf
