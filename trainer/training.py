"""A training run: player -> stages -> PPO, with progress, checkpoints and a clean stop."""

import signal
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass
from types import FrameType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from trainer.algorithms import WINDOW, build_algorithm, steps_per_update
from trainer.checkpoint import find_checkpoint, load_checkpoint, save_checkpoint
from trainer.config import RunConfig
from trainer.curiosity import Curiosity
from trainer.errors import TrainerError
from trainer.players import EpisodeMonitor
from trainer.progress import ProgressDisplay, Snapshot
from trainer.results import ProgressFile, RunFolder
from trainer.signals import uninterrupted

ROW_STEPS = 10_000  # agent steps between two rows of progress.csv
CHECKPOINT_STEPS = 500_000
OBSERVATION_CLIP = 10.0
NEVER = sys.maxsize  # for an off-policy algorithm, whose log_interval counts episodes; its rows are _Recorder's
CURIOSITY_TAGS = {
    "forward_loss": "Losses/Curiosity Forward Loss",
    "inverse_loss": "Losses/Curiosity Inverse Loss",
    "rnd_loss": "Losses/RND Loss",
    "reward": "rollout/intrinsic_reward",
}


@dataclass
class Counters:
    """What a run has done so far, resumed parts included.

    Attributes:
        env_steps: Agent steps.
        episodes: Ended episodes.
        wall_seconds: Time spent learning.
        steps_to_50_success: Agent steps at which half of the last 100 episodes had succeeded, or None.
        steps_to_90_success: The same for nine tenths.
        restarts: How often a player was started again because it had died or hung.
    """

    env_steps: int = 0
    episodes: int = 0
    wall_seconds: float = 0.0
    steps_to_50_success: int | None = None
    steps_to_90_success: int | None = None
    restarts: int = 0


class ObservationNormaliser(VecNormalize):
    """``VecNormalize`` without what a vector observation's eq. 7 does not need.

    It doesn't follow the return's variance, which is for ``norm_reward``, and makes no copy beforehand.
    """

    def normalize_obs(self, obs: Any) -> NDArray[np.float32]:
        """Eq. 7: (n, size) observations less their running mean, over their running deviation, limited to +-10."""
        statistics = self.obs_rms
        assert isinstance(statistics, RunningMeanStd)  # one vector observation
        scaled = (obs - statistics.mean) / np.sqrt(statistics.var + self.epsilon)
        limited: NDArray[np.float32] = np.minimum(np.maximum(scaled, -self.clip_obs), self.clip_obs).astype(np.float32)
        return limited

    def _update_reward(self, reward: NDArray[np.float64]) -> None:
        pass


@dataclass
class Stages:
    """The environment's stages, lowest first, and the algorithm on top."""

    player: VecEnv
    normaliser: VecNormalize
    curiosity: Curiosity | None
    model: BaseAlgorithm


def build_stages(config: RunConfig, player: VecEnv) -> Stages:
    """Puts monitoring, normalisation (eq. 7), curiosity and the algorithm on an environment.

    Raises:
        TrainerError: Curiosity or the algorithm can't take the environment's observations or actions.
    """
    torch.set_num_threads(1)  # small networks: a second thread only takes the player's core
    normaliser = ObservationNormaliser(EpisodeMonitor(player), norm_reward=False, clip_obs=OBSERVATION_CLIP)
    top: VecEnv = normaliser
    curiosity = None
    if config.curiosity.c > 0:
        try:
            top = curiosity = Curiosity(normaliser, config.curiosity, steps_per_update(config), config.seed)
        except ValueError as error:
            raise TrainerError(f"{error} Or train without curiosity: --c 0.") from error
    model = build_algorithm(config, top)
    return Stages(player, normaliser, curiosity, model)


def train(config: RunConfig, folder: RunFolder, stages: Stages, counters: Counters) -> bool:
    """Trains until ``config.steps``, a signal or an error; whatever ends it, a checkpoint is saved.

    Args:
        config: The run.
        folder: Where its results go.
        stages: Of ``build_stages``, with a checkpoint loaded into them if the run is resumed.
        counters: Updated as the run goes.

    Returns:
        Whether all steps were taken; False if a signal ended it before.

    Raises:
        TrainerError: The player failed; the checkpoint is saved all the same.
    """
    model = stages.model
    update_steps = steps_per_update(config) * stages.player.num_envs
    updates_a_row = max(1, ROW_STEPS // update_steps)
    outputs = [ProgressFile(folder.progress, counters.env_steps), TensorBoardOutputFormat(str(folder.tensorboard))]
    model.set_logger(Logger(str(folder.path), outputs))
    with ProgressDisplay(config, counters.env_steps) as display, _StopSignals() as signals:
        try:
            model.learn(
                max(config.steps - counters.env_steps, 0),
                callback=_Recorder(stages, folder, counters, display, signals),
                log_interval=NEVER if isinstance(model, OffPolicyAlgorithm) else updates_a_row,
                reset_num_timesteps=False,
            )
        finally:
            with uninterrupted():
                _save(folder, stages, counters)
                model.logger.close()
    return not signals.received


def resume(folder: RunFolder, stages: Stages, checkpoint: str | None = None) -> Counters:
    """Loads a checkpoint, the newest if none is named, into freshly built stages.

    Raises:
        TrainerError: There is none, or it does not fit.
    """
    path = find_checkpoint(folder.checkpoints, checkpoint)
    return Counters(**load_checkpoint(path, stages.model, stages.normaliser, stages.curiosity))


def _save(folder: RunFolder, stages: Stages, counters: Counters) -> None:
    save_checkpoint(folder.checkpoints, asdict(counters), stages.model, stages.normaliser, stages.curiosity)


class _Recorder(BaseCallback):
    """Watches infos, records what Stable-Baselines3 does not, and stops learning when asked to."""

    def __init__(
        self,
        stages: Stages,
        folder: RunFolder,
        counters: Counters,
        display: ProgressDisplay,
        signals: "_StopSignals",
    ) -> None:
        super().__init__()
        self._stages = stages
        self._folder = folder
        self._counters = counters
        self._display = display
        self._signals = signals
        self._recent: dict[str, deque[float]] = {
            name: deque(maxlen=WINDOW) for name in ("return", "length", "success", "curiosity_return")
        }
        self._next_checkpoint = counters.env_steps + CHECKPOINT_STEPS
        self._next_row = counters.env_steps + ROW_STEPS
        self._earlier_seconds = counters.wall_seconds
        self._earlier_restarts = counters.restarts
        self._started = time.monotonic()

    def _on_step(self) -> bool:
        self._counters.env_steps = self.num_timesteps
        self._counters.wall_seconds = self._earlier_seconds + time.monotonic() - self._started
        self._counters.restarts = self._earlier_restarts + getattr(self._stages.player, "restarts", 0)
        for info in self.locals["infos"]:
            if "episode" in info:
                self._end_episode(info)
        return not self._signals.received

    def _end_episode(self, info: dict[str, Any]) -> None:
        self._counters.episodes += 1
        self._recent["return"].append(info["episode"]["r"])
        self._recent["length"].append(info["episode"]["l"])
        if "curiosity_return" in info:
            self._recent["curiosity_return"].append(info["curiosity_return"])
        success = self._recent["success"]
        if "is_success" in info:
            success.append(float(info["is_success"]))
        if len(success) == WINDOW:
            rate = float(np.mean(success))
            if rate >= 0.5 and self._counters.steps_to_50_success is None:
                self._counters.steps_to_50_success = self.num_timesteps
            if rate >= 0.9 and self._counters.steps_to_90_success is None:
                self._counters.steps_to_90_success = self.num_timesteps

    def _on_rollout_end(self) -> None:
        means = {name: float(np.mean(values)) for name, values in self._recent.items() if values}
        tags = {
            "Environment/Cumulative Reward": means.get("return"),
            "Environment/Episode Length": means.get("length"),
            "Policy/Extrinsic Reward": means.get("return"),
            "Policy/Curiosity Reward": means.get("curiosity_return"),
        }
        metrics = {} if self._stages.curiosity is None else self._stages.curiosity.metrics
        tags |= {CURIOSITY_TAGS[name]: value for name, value in metrics.items()}
        self.logger.record("rollout/episodes", self._counters.episodes)
        for tag, value in tags.items():
            if value is not None:
                self.logger.record(tag, value)
        self._display.update(
            Snapshot(
                self.num_timesteps,
                means.get("return"),
                means.get("success"),
                means.get("length"),
                metrics.get("reward"),
            )
        )
        if isinstance(self.model, OffPolicyAlgorithm) and self.num_timesteps >= self._next_row:
            self._next_row += ROW_STEPS
            self.model.dump_logs()
        if self.num_timesteps >= self._next_checkpoint:
            self._next_checkpoint += CHECKPOINT_STEPS
            _save(self._folder, self._stages, self._counters)


class _StopSignals:
    """The first SIGINT or SIGTERM asks for a clean stop; a second one interrupts at once."""

    def __init__(self) -> None:
        self.received = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> "_StopSignals":
        for number in (signal.SIGINT, signal.SIGTERM):
            self._former[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.received:
            raise KeyboardInterrupt
        self.received = True
