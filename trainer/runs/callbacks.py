"""What happens beside learning, one job per callback: counting, logging, showing, saving, stopping."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from trainer.errors import TrainerError
from trainer.learning.algorithm_state import RandomStreams, set_clock
from trainer.learning.algorithms import WINDOW
from trainer.learning.stages import Stages
from trainer.players.slots import Slots
from trainer.runs.checkpoint import CheckpointWriter, to_bytes
from trainer.runs.counters import Counters
from trainer.runs.progress import ProgressDisplay, Snapshot
from trainer.runs.run_state import Captured, capture
from trainer.signals import StopSignals

ROW_STEPS = 10_000  # agent steps between two rows of progress.csv
CHECKPOINT_STEPS = 500_000
UNKNOWN = -1.0  # in the place of an episode's success, where the player doesn't say
CURIOSITY_TAGS = {
    "forward_loss": "Losses/Curiosity Forward Loss",
    "inverse_loss": "Losses/Curiosity Inverse Loss",
    "rnd_loss": "Losses/RND Loss",
    "reward": "rollout/intrinsic_reward",
}


class CountSteps(BaseCallback):
    """Keeps the counters of steps, time and restarts, which go on where a run's earlier parts left them.

    Args:
        counters: Of the whole run.
        players: Count their own restarts, and the time spent with them.
    """

    def __init__(self, counters: Counters, players: Slots) -> None:
        super().__init__()
        self._counters = counters
        self._players = players
        self._earlier = replace(counters, exchange_seconds=counters.exchange_seconds - players.exchange_seconds)
        self._started = time.monotonic()

    def _on_step(self) -> bool:
        counters, earlier = self._counters, self._earlier
        counters.env_steps = self.num_timesteps
        counters.wall_seconds = earlier.wall_seconds + time.monotonic() - self._started
        counters.exchange_seconds = earlier.exchange_seconds + self._players.exchange_seconds
        counters.restarts = earlier.restarts + self._players.restarts
        return True


class CountEpisodes(BaseCallback):
    """Counts ended episodes, and keeps the numbers of the last ones, also over a resume.

    Success is taken out of the infos: Stable-Baselines3 has the rate over those episodes alone that report it.

    Args:
        counters: Of the whole run.
    """

    def __init__(self, counters: Counters) -> None:
        super().__init__()
        self._counters = counters
        names = ("return", "length", "success", "curiosity_return")
        self._recent: dict[str, deque[float]] = {name: deque(maxlen=WINDOW) for name in names}

    def means(self) -> dict[str, float]:
        """Means over the last episodes, by name; nothing for what no episode has had yet, or not all of them have."""
        known = {name: values for name, values in self._recent.items() if values and UNKNOWN not in values}
        return {name: float(np.mean(values)) for name, values in known.items()}

    def unknown(self) -> tuple[int, int]:
        """Of how many of the last episodes the player has not said whether they succeeded, and how many those are."""
        success = self._recent["success"]
        return success.count(UNKNOWN), len(success)

    def state_dict(self) -> dict[str, Any]:
        """The numbers of the last episodes, oldest first."""
        return {name: np.array(values) for name, values in self._recent.items()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
        """
        for name, values in self._recent.items():
            values.extend(state[name])

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self._count(info)
        return True

    def _count(self, info: dict[str, Any]) -> None:
        counters, success = self._counters, self._recent["success"]
        counters.episodes += 1
        self._recent["return"].append(info["episode"]["r"])
        self._recent["length"].append(info["episode"]["l"])
        if "curiosity_return" in info:
            self._recent["curiosity_return"].append(info["curiosity_return"])
        success.append(float(info.pop("is_success", UNKNOWN)))
        if len(success) == WINDOW and UNKNOWN not in success:
            rate = float(np.mean(success))
            if rate >= 0.5 and counters.steps_to_50_success is None:
                counters.steps_to_50_success = self.num_timesteps
            if rate >= 0.9 and counters.steps_to_90_success is None:
                counters.steps_to_90_success = self.num_timesteps


class LogRows(BaseCallback):
    """Logs what Stable-Baselines3 does not, and has a row written every ``ROW_STEPS`` agent steps.

    Args:
        counters: Of the whole run.
        episodes: The last episodes.
        stages: Curiosity has metrics of its own.
        update_steps: Agent steps in an update.
    """

    def __init__(self, counters: Counters, episodes: CountEpisodes, stages: Stages, update_steps: int) -> None:
        super().__init__()
        self._counters = counters
        self._episodes = episodes
        self._curiosity = stages.curiosity
        self._update_steps = update_steps
        self._row_updates = max(1, ROW_STEPS // update_steps)
        self._next_row = counters.env_steps + ROW_STEPS

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        means = self._episodes.means()
        tags = {
            "rollout/success_rate": means.get("success"),
            "Environment/Cumulative Reward": means.get("return"),
            "Environment/Episode Length": means.get("length"),
            "Policy/Extrinsic Reward": means.get("return"),
            "Policy/Curiosity Reward": means.get("curiosity_return"),
        }
        if self._curiosity is not None:
            tags |= {CURIOSITY_TAGS[name]: value for name, value in self._curiosity.metrics.items()}
        self.logger.record("rollout/episodes", self._counters.episodes)
        for tag, value in tags.items():
            if value is not None:
                self.logger.record(tag, value)
        set_clock(self.model, self._counters.wall_seconds)
        update = self.num_timesteps // self._update_steps
        if isinstance(self.model, OnPolicyAlgorithm):
            if update % self._row_updates == 0:
                self.model.dump_logs(update)
        elif isinstance(self.model, OffPolicyAlgorithm) and self.num_timesteps >= self._next_row:
            self._next_row += ROW_STEPS
            self.model.dump_logs()


class ShowProgress(BaseCallback):
    """Shows how far the run is.

    Args:
        display: Where.
        line: In which line.
        episodes: The last episodes.
        stages: Curiosity has metrics of its own.
    """

    def __init__(self, display: ProgressDisplay, line: str, episodes: CountEpisodes, stages: Stages) -> None:
        super().__init__()
        self._display, self._line = display, line
        self._episodes = episodes
        self._curiosity = stages.curiosity

    def _on_step(self) -> bool:
        self._display.move(self._line, self.num_timesteps)
        return True

    def _on_rollout_end(self) -> None:
        means = self._episodes.means()
        intrinsic = None if self._curiosity is None else self._curiosity.metrics.get("reward")
        self._display.update(
            self._line,
            Snapshot(
                self.num_timesteps,
                means.get("return"),
                means.get("success"),
                means.get("length"),
                intrinsic,
                *self._episodes.unknown(),
            ),
        )


class StopOnSignal(BaseCallback):
    """Ends the run when a signal has asked for it.

    Args:
        signals: Say whether one has.

    Attributes:
        stopped: Whether this has ended the run, in the middle of a rollout it may be.
    """

    def __init__(self, signals: StopSignals) -> None:
        super().__init__()
        self._signals = signals
        self.stopped = False

    def _on_step(self) -> bool:
        self.stopped = self._signals.received
        return not self.stopped


class Save(BaseCallback):
    """Saves the run after every update, while the next rollout's first step is under way.

    An off-policy algorithm's rollout is one step: it is saved every ``CHECKPOINT_STEPS``, and at the end.

    Args:
        parts: All that a checkpoint holds.
        random: Of the parts, the streams; noted before the next rollout's first actions are drawn.
        counters: Of the whole run.
        config: The run's settings, as values.
        stages: Those that defer, and the algorithm.
        players: Asked for their states with a rollout's last step.
        rollout_steps: Steps of each slot in a rollout.
        stop: Says whether the last rollout was cut.
        writer: Writes checkpoints.

    Attributes:
        saved: The counters of the newest checkpoint.
    """

    def __init__(
        self,
        parts: Mapping[str, Captured],
        random: RandomStreams,
        counters: Counters,
        config: dict[str, Any],
        stages: Stages,
        players: Slots,
        rollout_steps: int,
        stop: StopOnSignal,
        writer: CheckpointWriter,
    ) -> None:
        super().__init__()
        self.saved = replace(counters)
        self._parts = parts
        self._random = random
        self._counters = counters
        self._config = config
        self._defer: Callable[[Callable[[], None]], None] = stages.top.defer
        self._players = players
        self._on_policy = isinstance(stages.model, OnPolicyAlgorithm)
        self._rollout_steps = rollout_steps
        self._stop = stop
        self._writer = writer
        self._step_of_rollout = 0
        self._next_kept = counters.env_steps + CHECKPOINT_STEPS

    def _on_rollout_start(self) -> None:
        self._step_of_rollout = 0
        if self._on_policy or self.num_timesteps >= self._next_kept:
            self._random.note()
            self._defer(self._save)
        self._ask_before_last_step()

    def _on_step(self) -> bool:
        self._step_of_rollout += 1
        self._ask_before_last_step()
        return True

    def _on_training_end(self) -> None:
        if self._on_policy and self._stop.stopped:
            return  # what a rollout that was cut changed has not been learned from
        self._random.note()
        self._save()

    def _ask_before_last_step(self) -> None:
        if self._on_policy and self._step_of_rollout == self._rollout_steps - 1:
            self._players.ask_states()

    def _save(self) -> None:
        if self.num_timesteps == self.saved.env_steps:
            return
        facts = {"config": self._config, "counters": asdict(self._counters), "env_steps": self.num_timesteps}
        try:
            data = to_bytes(capture(self._parts, facts))
        except TrainerError as error:
            raise TrainerError(f"After the update at step {self.num_timesteps:,}: {error}") from error
        self._writer.write(self.num_timesteps, data)
        self.saved = replace(self._counters)
        if self.num_timesteps >= self._next_kept:
            self._next_kept += CHECKPOINT_STEPS
            self._writer.keep()
