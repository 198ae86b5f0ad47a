"""What a behavior logs while it is trained: ``progress.csv`` and TensorBoard, by the tags of SB3 and ML-Agents."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from stable_baselines3.common.logger import Logger

from trainer.learning.learner import WINDOW, Learner
from trainer.runs.logs import PROGRESS_COLUMNS, ProgressFile, TensorBoardLog
from trainer.runs.progress import Snapshot

INTRINSIC_RETURN = PROGRESS_COLUMNS["curiosity_return"]  # ML-Agents' tag of curiosity; the column is of any such reward


class BehaviorLog:
    """The rows of one behavior.

    Args:
        folder: Where ``progress.csv`` and ``tensorboard`` go.
        steps: That its learner has learned from before; later rows of a run that was cut are dropped.
        every: Steps between two rows.

    Attributes:
        learned: By the learner, when it was last looked at.
    """

    def __init__(self, folder: Path, steps: int, every: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.learned = steps
        self._every, self._written = every, steps - steps % every
        self._last_steps, self._last_seconds = steps, 0.0
        outputs = [ProgressFile(folder / "progress.csv", steps), TensorBoardLog(folder / "tensorboard", steps)]
        self._logger = Logger(str(folder), list(outputs))

    def snapshot(self, learner: Learner) -> Snapshot:
        """What a person sees of it."""
        returns, lengths, _ = _means(learner)
        intrinsic = learner.metrics.get("rollout/intrinsic_reward")
        return Snapshot(
            learner.steps,
            returns,
            None,
            lengths,
            intrinsic,
            reports_success=False,
            is_curious=learner.is_curious,
        )

    def is_due(self, learner: Learner) -> bool:
        """Whether it is time for a row."""
        return learner.steps - self._written >= self._every or learner.is_done

    def write(self, learner: Learner, seconds: float, statistics: Mapping[str, float]) -> None:
        """Writes a row.

        Args:
            learner: The behavior's.
            seconds: That the run has trained for.
            statistics: Further values, by tag.
        """
        self._written = learner.steps - learner.steps % self._every
        returns, lengths, intrinsic = _means(learner)
        rows = {
            "rollout/ep_rew_mean": returns,
            "rollout/ep_len_mean": lengths,
            "Environment/Cumulative Reward": returns,
            "Environment/Episode Length": lengths,
            **_of_signals(learner, returns, intrinsic),
            **learner.metrics,
            **statistics,
        }
        for tag, value in rows.items():
            if value is not None and np.isfinite(value):
                self._logger.record(tag, value)
        if intrinsic is not None and INTRINSIC_RETURN not in rows:
            self._logger.record(INTRINSIC_RETURN, intrinsic, exclude="tensorboard")
        self._logger.record("time/total_timesteps", learner.steps)
        self._logger.record("rollout/episodes", learner.episodes)
        self._logger.record("time/time_elapsed", int(seconds), exclude="tensorboard")
        self._logger.record(
            "time/fps", int((learner.steps - self._last_steps) / max(seconds - self._last_seconds, 1e-9))
        )
        self._last_steps, self._last_seconds = learner.steps, seconds
        self._logger.record("train/n_updates", learner.updates, exclude="tensorboard")
        self._logger.dump(learner.steps)

    def close(self) -> None:
        """Closes the files."""
        self._logger.close()


def _of_signals(learner: Learner, returns: float | None, intrinsic: float | None) -> dict[str, float | None]:
    """What each reward signal paid for an episode, by ML-Agents' tags."""
    own = [name for name in learner.strengths if name != "extrinsic"]
    paid = {f"Policy/{name.capitalize()} Reward": intrinsic for name in own if len(own) == 1}  # of two we have the sum
    if returns is not None and "extrinsic" in learner.strengths:
        paid["Policy/Extrinsic Reward"] = returns * learner.strengths["extrinsic"]
    return paid


def _means(learner: Learner) -> tuple[float | None, float | None, float | None]:
    """Of the last episodes: return, length, and intrinsic reward; None before there are any."""
    found = [
        float(np.mean(list(learner.recent[name])[-WINDOW:])) if learner.recent[name] else None
        for name in ("returns", "lengths", "intrinsic")
    ]
    return found[0], found[1], found[2]
