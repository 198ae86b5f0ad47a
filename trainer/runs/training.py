"""A training run: player -> stages -> PPO, with progress, checkpoints and a clean stop."""

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from types import FrameType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.learning.algorithms import WINDOW, build_algorithm, steps_per_update
from trainer.learning.curiosity import Curiosity
from trainer.learning.normaliser import ObservationNormaliser
from trainer.players.environment import BadNumbers
from trainer.players.several import EpisodeMonitor, Players
from trainer.runs.checkpoint import Checkpoint, CheckpointWriter, read_checkpoint, to_bytes
from trainer.runs.folder import ProgressFile, RunFolder, cut_events
from trainer.runs.progress import ProgressDisplay, Snapshot
from trainer.runs.run_state import RandomStates, Stages, Windows, load_policy, put_back, random_states, take
from trainer.signals import heeded, uninterrupted

ROW_STEPS = 10_000  # agent steps between two rows of progress.csv
CHECKPOINT_STEPS = 500_000
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
        exchange_seconds: Of it, time spent exchanging messages with the players.
        steps_to_50_success: Agent steps at which half of the last 100 episodes had succeeded, or None.
        steps_to_90_success: The same for nine tenths.
        restarts: How often a player was started again because it had died or hung.
        resumes: How often the run was resumed.
    """

    env_steps: int = 0
    episodes: int = 0
    wall_seconds: float = 0.0
    exchange_seconds: float = 0.0
    steps_to_50_success: int | None = None
    steps_to_90_success: int | None = None
    restarts: int = 0
    resumes: int = 0


class Meanwhile(VecEnvWrapper):
    """The topmost stage: does what was put off as soon as the next actions are sent, while the player moves."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self._put_off: list[Callable[[], None]] = []

    def put_off(self, work: Callable[[], None]) -> None:
        """Has something done during the next step, or instead of it if the actions can't be sent."""
        self._put_off.append(work)

    def reset(self) -> VecEnvObs:
        """Resets the environments."""
        return self.venv.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Passes the actions on, and does what was put off."""
        try:
            self.venv.step_async(actions)
        finally:
            while self._put_off:
                self._put_off.pop()()

    def step_wait(self) -> VecEnvStepReturn:
        """Passes on what the environments answer."""
        return self.venv.step_wait()


def build_stages(config: RunConfig, player: VecEnv) -> Stages:
    """Puts monitoring, normalisation (eq. 7), curiosity and the algorithm on an environment.

    Raises:
        TrainerError: Curiosity or the algorithm can't take the environment's observations or actions.
    """
    torch.set_num_threads(1)  # small networks: a second thread only takes the player's core
    normaliser = ObservationNormaliser(EpisodeMonitor(player))
    top: VecEnv = normaliser
    curiosity = None
    if config.curiosity.c > 0:
        try:
            top = curiosity = Curiosity(normaliser, config.curiosity, steps_per_update(config), config.seed)
        except ValueError as error:
            raise TrainerError(f"{error} Or train without curiosity: --c 0.") from error
    model = build_algorithm(config, Meanwhile(top))
    return Stages(player, normaliser, curiosity, model)


def train(
    config: RunConfig, folder: RunFolder, stages: Stages, counters: Counters, checkpoint: Checkpoint | None = None
) -> bool:
    """Trains until ``config.steps``, a signal or an error; whatever ends it, the last whole update is saved.

    Args:
        config: The run.
        folder: Where its results go.
        stages: Of ``build_stages``.
        counters: Of the checkpoint, or new ones; updated as the run goes, and those of the last update at the end.
        checkpoint: Of a resumed run, whose players were opened with its states.

    Returns:
        Whether all steps were taken; False if a signal ended it before.

    Raises:
        TrainerError: The player failed, the folder can't be written, or numbers went bad; the last whole update is
            saved all the same.
    """
    model = stages.model
    windows: Windows = {name: deque(maxlen=WINDOW) for name in ("return", "length", "success", "curiosity_return")}
    cut_events(folder.tensorboard, counters.env_steps)
    outputs = [ProgressFile(folder.progress, counters.env_steps), TensorBoardOutputFormat(str(folder.tensorboard))]
    model.set_logger(Logger(str(folder.path), outputs))
    if checkpoint is not None:
        load_policy(checkpoint, stages, config.algo)
        if not put_back(checkpoint, stages, windows):
            Console().print("The player can't go on where it was: new episodes begin.", highlight=False)
    writer = CheckpointWriter(folder.checkpoints)
    with ProgressDisplay(config, counters.env_steps) as display, _StopSignals() as signals:
        recorder = _Recorder(config, stages, windows, counters, display, signals, writer)
        try:
            with _named_step(model):
                model.learn(
                    max(config.steps - counters.env_steps, 0),
                    callback=recorder,
                    log_interval=None,  # type: ignore[arg-type]  # rows are the recorder's, by steps and not by calls
                    reset_num_timesteps=False,
                )
        finally:
            vars(counters).update(vars(recorder.saved))
            with uninterrupted():
                writer.keep()
                model.logger.close()
    return not signals.received


def load_trained(config: RunConfig, folder: RunFolder, stages: Stages, checkpoint: str | None = None) -> Counters:
    """Puts a run's policy into freshly built stages, to be played and not to be trained further.

    Args:
        config: The run.
        folder: Its folder.
        stages: Of ``build_stages``.
        checkpoint: The checkpoint's name; the newest if not given.

    Returns:
        The counters that were saved with it.

    Raises:
        TrainerError: There is none, it is damaged, or it does not fit.
    """
    read = read_checkpoint(folder.checkpoints, checkpoint)
    load_policy(read, stages, config.algo)
    return Counters(**read.facts["counters"])


@contextmanager
def _named_step(model: BaseAlgorithm) -> Iterator[None]:
    """Says after which step numbers went bad."""
    try:
        yield
    except TrainerError as error:
        if isinstance(error.__cause__, BadNumbers):
            raise TrainerError(f"After step {model.num_timesteps:,}: {error}") from error
        raise


class _Recorder(BaseCallback):
    """Watches infos, records what Stable-Baselines3 does not, saves after every update, and stops when asked to.

    Attributes:
        saved: The counters of the last update, which is the newest checkpoint's.
    """

    def __init__(
        self,
        config: RunConfig,
        stages: Stages,
        windows: Windows,
        counters: Counters,
        display: ProgressDisplay,
        signals: "_StopSignals",
        writer: CheckpointWriter,
    ) -> None:
        super().__init__()
        self.saved = replace(counters)
        self._config = config.as_dict()
        self._stages = stages
        self._recent = windows
        self._counters = counters
        self._display = display
        self._signals = signals
        self._writer = writer
        # An off-policy algorithm's rollout is a step: it is saved now and then, and its rows are by steps.
        self._on_policy = isinstance(stages.model, OnPolicyAlgorithm)
        self._rollout_steps = steps_per_update(config)
        self._row_updates = max(1, ROW_STEPS // (self._rollout_steps * stages.player.num_envs))
        self._step_of_rollout = 0
        self._cut = False
        self._next_row = counters.env_steps + ROW_STEPS
        self._next_kept = counters.env_steps + CHECKPOINT_STEPS
        self._earlier_seconds = counters.wall_seconds
        self._earlier_exchange = counters.exchange_seconds - getattr(stages.player, "exchange_seconds", 0.0)
        self._earlier_restarts = counters.restarts
        self._started = time.monotonic()

    def _on_training_start(self) -> None:
        # SB3's clock and its count of steps go on where they were.
        self.model.start_time -= int(self._earlier_seconds * 1e9)
        self.model._num_timesteps_at_start = 0

    def _on_rollout_start(self) -> None:
        self._step_of_rollout = 0
        if self._on_policy or self.num_timesteps >= self._next_kept:
            env, random = self.training_env, random_states()  # as they are before the first action's noise
            assert isinstance(env, Meanwhile)
            env.put_off(lambda: self._save(random))
        self._ask_before_last_step()

    def _on_step(self) -> bool:
        self._counters.env_steps = self.num_timesteps
        self._counters.wall_seconds = self._earlier_seconds + time.monotonic() - self._started
        self._counters.exchange_seconds = self._earlier_exchange + getattr(self._stages.player, "exchange_seconds", 0.0)
        self._counters.restarts = self._earlier_restarts + getattr(self._stages.player, "restarts", 0)
        for info in self.locals["infos"]:
            if "episode" in info:
                self._end_episode(info)
        self._step_of_rollout += 1
        self._ask_before_last_step()
        self._cut = self._signals.received
        return not self._cut

    def _on_training_end(self) -> None:
        if not self._on_policy or not self._cut:  # what a rollout that was cut changed has not been learned from
            self._save(random_states())

    def _ask_before_last_step(self) -> None:
        player = self._stages.player
        if self._on_policy and self._step_of_rollout == self._rollout_steps - 1 and isinstance(player, Players):
            player.ask_states()

    def _save(self, random: RandomStates) -> None:
        """Saves the run as it is after an update."""
        if self.num_timesteps == self.saved.env_steps:
            return
        try:
            facts = {"config": self._config, "counters": asdict(self._counters)}
            data = to_bytes(take(self._stages, self._recent, random, facts))
        except TrainerError as error:
            raise TrainerError(f"After the update at step {self.num_timesteps:,}: {error}") from error
        self._writer.write(self.num_timesteps, data)
        self.saved = replace(self._counters)
        if self.num_timesteps >= self._next_kept:
            self._next_kept += CHECKPOINT_STEPS
            self._writer.keep()

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
        update = self.num_timesteps // (self._rollout_steps * self._stages.player.num_envs)
        if isinstance(self.model, OnPolicyAlgorithm):
            if update % self._row_updates == 0:
                self.model.dump_logs(update)
        elif isinstance(self.model, OffPolicyAlgorithm) and self.num_timesteps >= self._next_row:
            self._next_row += ROW_STEPS
            self.model.dump_logs()


class _StopSignals:
    """The first SIGINT, SIGTERM or SIGHUP asks for a clean stop; a second one interrupts at once."""

    def __init__(self) -> None:
        self.received = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> "_StopSignals":
        for number in heeded():
            self._former[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.received:
            raise KeyboardInterrupt
        self.received = True
