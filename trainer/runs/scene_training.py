"""Training whatever a scene has: every behavior with its own learner, until each has taken its steps."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.utils import set_random_seed

from trainer.config import RunConfig
from trainer.curriculum import Curricula
from trainer.learning.algorithm_state import RandomStreams
from trainer.players.scene import Scene
from trainer.players.settings import present_parameters
from trainer.runs.behavior_learners import BehaviorLearners, asking_of
from trainer.runs.behavior_log import BehaviorLog
from trainer.runs.checkpoint import Checkpoint, CheckpointWriter, to_bytes
from trainer.runs.counters import Counters
from trainer.runs.folder import RunFolder
from trainer.runs.progress import ProgressDisplay
from trainer.runs.run_state import capture
from trainer.signals import StopSignals, deferred
from trainer.terminal import Terminal

SAVING_SHARE = 0.05  # of the time, at most, goes into checkpoints of updates


class SceneTraining:
    """One run, or one part of a resumed one.

    Args:
        config: The run.
        folder: Where its results go.
        scene: Its players.
        counters: Of the checkpoint, or new ones; updated as the run goes.
        curricula: In the lessons with which the players were opened; updated as the run goes.
        checkpoint: Of a resumed run, whose players were opened with its states.

    Attributes:
        learners: Of every behavior.
        curricula: As given.

    Raises:
        TrainerError: The checkpoint does not fit.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: RunFolder,
        scene: Scene,
        counters: Counters,
        curricula: Curricula,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        torch.set_num_threads(1)  # small networks: a second thread only takes the player's core
        torch.backends.cudnn.deterministic = True  # its fastest gradients of pictures differ from run to run
        set_random_seed(config.seed)
        self._config, self._folder, self._scene, self._counters = config, folder, scene, counters
        self.learners = BehaviorLearners(config, scene)
        self.curricula = curricula
        self._random = RandomStreams()
        self._writer = CheckpointWriter(folder.checkpoints)
        self._logs: dict[str, BehaviorLog] = {}
        self._lines: dict[str, str] = {}  # of the display
        self._lesson_returns: dict[str, list[float]] = {}  # of episodes since the last change of a lesson
        self._statistics: dict[str, list[float]] = {}  # of the players, since a row was written
        self._messages = scene.reset()
        for name in config.check_behaviors(scene.behaviors):
            Terminal().print(
                f"The environment has not shown {name} yet, which the file lists; it is trained once it comes."
            )
        self._listed = {name.partition("?")[0] for name in scene.behaviors}
        self._goes_on = checkpoint is not None and self._restore(checkpoint)
        # What each had learned from when this part of the run began.
        self._before = {name: learner.learned for name, learner in self.learners}
        self._saved_steps = self._kept_steps = counters.env_steps
        self._next_save = 0.0

    def train(self, begin: Callable[[int], None]) -> bool:
        """Trains until every behavior has taken its steps, a signal, or an error; whatever ends it, the run is saved.

        Args:
            begin: Called before anything is written, once everything is known to fit, with the number of agents that
                the first player has at first.

        Returns:
            Whether all steps were taken; False if a signal ended it before.

        Raises:
            TrainerError: A player failed, the folder can't be written, or numbers went bad.
        """
        learners, scene, counters = self.learners, self._scene, self._counters
        learners.take(self._messages, again=self._goes_on)
        begin(sum(len(agents) for agents in self._messages[0].asking.values()))
        started, earlier = time.monotonic(), replace(counters)
        with ProgressDisplay() as display, StopSignals() as signals:
            try:
                while True:
                    self._show(display)
                    counters.env_steps, counters.episodes = learners.steps, learners.episodes
                    counters.wall_seconds = earlier.wall_seconds + time.monotonic() - started
                    counters.exchange_seconds = earlier.exchange_seconds + scene.exchange_seconds
                    counters.restarts = earlier.restarts + scene.restarts
                    if learners.finish():  # of the updates that ran beside these steps; the next ones begin after it
                        self._report(display)
                        self._save_update()
                    if learners.learn():
                        self._report(display)  # first: a run that is cut in between drops rows, but misses none
                        self._save_update()
                    if learners.are_done or signals.received:
                        break
                    self._teach()
                    actions = learners.act()
                    if learners.may_be_full():
                        scene.ask_states()
                    scene.send(actions)
                    learners.remember()  # while the players go on
                    self._go_round(signals)
                    self._messages = scene.receive()
                    learners.take(self._messages)
            finally:
                with deferred():
                    self._finish()
        return not signals.received

    def _go_round(self, signals: StopSignals) -> None:
        """Serves several players in turn, each while the others play, as long as no update or lesson needs all of them.

        With it a player that takes its time hardly waits for another. Whose turn it is does not depend on who is
        fast: the same seed gives the same run.
        """
        learners, scene = self.learners, self._scene
        if len(scene) == 1 or self.curricula.are_taught:
            return
        while not (signals.received or learners.may_be_full(2)):  # in this round, and in the messages after it
            for number in range(len(scene)):
                learners.take_one(number, scene.receive_one(number))
                scene.send_one(number, learners.act()[number])
                learners.remember()

    def _restore(self, checkpoint: Checkpoint) -> bool:
        """Puts everything back; returns whether the running episodes go on."""
        self.learners.restore(checkpoint)
        self._listed = set(checkpoint.part("listed")["names"])
        for name, returns in checkpoint.part("lessons").items():
            self._lesson_returns[name] = list(returns)
        self._statistics = {name: list(values) for name, values in checkpoint.part("statistics").items()}
        saved, found = checkpoint.part("asking"), asking_of(self._messages)
        said = checkpoint.part("players")
        goes_on = (
            all(f"state_{number}" in said for number in range(len(self._scene)))  # or what is alike is so by chance
            and self._scene.took_up_its_state
            and saved.keys() == found.keys()
            and all(np.array_equal(saved[name], found[name]) for name in saved)
        )
        if goes_on:
            self._messages = [message._replace(anew=False) for message in self._messages]
        else:
            Terminal().print("The player can't go on where it was: new episodes begin.")
        self._random.load_state_dict(checkpoint.part("random"))
        return goes_on

    def _teach(self) -> None:
        """Goes on to the next lesson where one is over."""
        changed = must_reset = False
        for name, learner in self.learners:
            ended, learner.ended_returns = learner.ended_returns, []
            if not self.curricula.are_taught:
                continue
            returns = self._lesson_returns.setdefault(name, [])
            returns.extend(ended)
            del returns[: -self.curricula.episodes(name)]
            results = self.curricula.update(name, learner.steps / learner.settings.max_steps, returns)
            changed, must_reset = changed or results[0], must_reset or results[1]
        if not changed:
            return
        self._lesson_returns.clear()
        self._scene.set_parameters(present_parameters(self._config, self.curricula))
        if must_reset:
            self._messages = self._scene.reset()
            self.learners.take(self._messages)

    def _parts(self) -> dict[str, Any]:
        return {
            **self.learners.state_dict(),
            "players": self._scene,
            "curricula": self.curricula,
            "random": self._random,
        }

    def _save_update(self) -> None:
        """Saves after an update, unless the last checkpoint was just now and takes long; what is learned is saved."""
        if time.monotonic() >= self._next_save or self._is_time_to_keep() or self.learners.are_done:
            self._save()

    def _is_time_to_keep(self) -> bool:
        interval = min(learner.settings.checkpoint_interval for _, learner in self.learners)
        return self._counters.env_steps // interval > self._kept_steps // interval

    def _save(self) -> None:
        began = time.monotonic()
        self._random.note()
        values = {
            "behaviors": self.learners.described(),
            "lessons": self._lesson_returns,
            "listed": {"names": sorted(self._listed)},
            "statistics": self._reported(),
            "asking": asking_of(self._messages),
        }
        parts = {**self._parts(), **{name: _Plain(value) for name, value in values.items()}}
        facts = {
            "config": self._config.as_dict(),
            "counters": asdict(self._counters),
            "env_steps": self._counters.env_steps,
        }
        self._writer.write(self._counters.env_steps, to_bytes(capture(parts, facts)))
        self._saved_steps = self._counters.env_steps
        if self._is_time_to_keep():
            self._kept_steps = self._counters.env_steps
            self._writer.keep(max(learner.settings.keep_checkpoints for _, learner in self.learners))
        ended = time.monotonic()
        self._next_save = ended + (ended - began) / SAVING_SHARE

    def _finish(self) -> None:
        """Saves what was not saved yet, and closes everything.

        A run that is cut keeps a checkpoint of its last update, from which its episodes can go on: after it, nobody
        knows where they are.
        """
        exact = self._saved_steps > 0 and self._scene.says_its_state and not self.learners.are_done
        try:
            if self._counters.env_steps > self._saved_steps:
                if exact:
                    self._counters.env_steps = self._saved_steps  # from where a resumed run goes on
                else:
                    self._save()
            self._writer.keep(max([1, *(learner.settings.keep_checkpoints for _, learner in self.learners)]))
        finally:
            for log in self._logs.values():
                log.close()

    def _show(self, display: ProgressDisplay) -> None:
        """Shows how many steps every behavior has taken, which may be long before it learns from them."""
        for name, learner in self.learners:
            if name not in self._lines:
                self._lines[name] = self._config.run_id if self.is_only(name) else name
                display.add(self._lines[name], learner.settings.max_steps, learner.steps)
            display.move(self._lines[name], learner.steps)

    def _report(self, display: ProgressDisplay) -> None:
        """Shows every behavior's progress, and logs a row where it is time to."""
        for name, learner in self.learners:
            log = self._logs.get(name)
            if log is None:
                path = self._folder.behavior(name, self.is_only(name)).path
                self._logs[name] = log = BehaviorLog(path, self._before.get(name, 0), learner.settings.summary_freq)
            last_is_due = learner.steps >= learner.settings.max_steps and not learner.is_done
            if learner.learned == log.learned or last_is_due:  # that one follows at once, and has the row
                continue
            log.learned = learner.learned
            display.update(self._lines[name], log.snapshot(learner))
            if log.is_due(learner):
                statistics = {key: float(np.mean(each)) for key, each in self._reported().items() if each}
                told = present_parameters(self._config, self.curricula)
                lessons = {f"Environment/Lesson Number/{key}": self.curricula.numbers[key] for key in told}
                log.write(learner, self._counters.wall_seconds, statistics | lessons)
                self._statistics = {}

    def _reported(self) -> dict[str, list[float]]:
        """What the players have reported since a row was written."""
        for name, values in self._scene.statistics().items():
            self._statistics.setdefault(name, []).extend(values)
        return self._statistics

    def is_only(self, name: str) -> bool:
        """Whether the run's own folder is this behavior's: one that is alone, and was from the beginning."""
        return len(self._listed) == 1 and name in self._listed


class _Plain:
    """Values as a part of a checkpoint."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = values

    def state_dict(self) -> Mapping[str, Any]:
        return self._values
