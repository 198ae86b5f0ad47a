"""Where a study's runs are executed: processes of this machine, or (``ray_executor``) tasks on a Ray cluster.

Either way a run is one ``worker`` process that trains in a scratch folder; what it leaves is then put in the results
place. An executor yields what is going on until every run has ended.
"""

import csv
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from trainer.config import RunConfig
from trainer.signals import deferred, kill_with_descendants
from trainer.studies.store import Store

POLL_SECONDS = 0.2
LOG = "run_logs/train.log"


@dataclass(frozen=True)
class Task:
    """A run that is to be done.

    Attributes:
        config: The run.
        place: The results place.
        study: Whose folder it goes to.
        episodes: Of its evaluation.
        timeout_wait: Seconds to wait for the player.
    """

    config: RunConfig
    place: str
    study: str
    episodes: int
    timeout_wait: int


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended.

    Attributes:
        run_id: The run.
        error: What went wrong, or None.
        log: Where its log is.
    """

    run_id: str
    error: str | None
    log: str


@dataclass(frozen=True)
class Update:
    """What is going on.

    Attributes:
        running: Runs in progress.
        steps: Steps that they have taken, as far as is known.
        ended: Runs that ended since the last update.
    """

    running: int
    steps: int
    ended: tuple[RunOutcome, ...]


class Executor(Protocol):
    """Runs tasks; closing the generator stops those that are running."""

    def check(self) -> None:
        """Makes sure that runs can be executed.

        Raises:
            TrainerError: They can't.
        """

    def run(self, tasks: Sequence[Task]) -> Generator[Update, None, None]:
        """Runs them all, and yields at least once a second."""


class LocalExecutor:
    """A pool of processes on this machine.

    Args:
        jobs: Runs at a time. Each is a trainer and a player, which take turns: about one core.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def check(self) -> None:
        """This machine is always there."""

    def run(self, tasks: Sequence[Task]) -> Generator[Update, None, None]:
        """Runs them in order."""
        waiting, running = deque(tasks), list[Attempt]()
        try:
            while waiting or running:
                while waiting and len(running) < self.jobs:
                    with deferred():  # one that nobody knows of would leave its folder
                        running.append(Attempt(waiting.popleft()))
                ended = [attempt for attempt in running if attempt.has_ended()]
                running = [attempt for attempt in running if attempt not in ended]
                outcomes = tuple(attempt.publish() for attempt in ended)
                yield Update(len(running), sum(attempt.steps() for attempt in running), outcomes)
                time.sleep(POLL_SECONDS if running else 0.0)
        finally:
            with deferred():
                for attempt in running:
                    attempt.discard()


class Attempt:
    """One execution of a task, begun at once: a worker process and its scratch folder."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._scratch = Path(tempfile.mkdtemp(prefix="corridor-run-"))
        self._folder = self._scratch / task.config.run_id
        self._log = self._scratch / "train.log"
        order = {
            "config": task.config.as_dict(),
            "folder": str(self._scratch),
            "port": free_port(),
            "timeout_wait": task.timeout_wait,
            "episodes": task.episodes,
        }
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "trainer.studies.worker"],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a terminal's Ctrl-C is the study's to pass on
            )
        assert self._process.stdin is not None
        self._input = self._process.stdin
        self._input.write(json.dumps(order).encode() + b"\n")
        self._input.flush()

    def steps(self) -> int:
        """Agent steps taken, as far as ``progress.csv`` says."""
        try:
            with (self._folder / "progress.csv").open(newline="", encoding="utf-8") as file:
                return int(float([row["env_steps"] for row in csv.DictReader(file)][-1]))
        except (OSError, IndexError, TypeError, ValueError):
            return 0

    def has_ended(self) -> bool:
        """Whether the worker has ended."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Waits for the worker's end."""
        self._process.wait()

    def publish(self) -> RunOutcome:
        """Puts what an ended worker left in the results place, and removes the scratch folder."""
        config, study = self.task.config, self.task.study
        store = Store(self.task.place)
        error = None
        if self._process.returncode:
            error = _last_error(self._log) or f"its process ended with exit code {self._process.returncode}"
            (self._folder / "summary.json").unlink(missing_ok=True)
        (self._folder / LOG).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(self._log, self._folder / LOG)
        try:
            store.publish_run(self._folder, config, study, self.task.episodes)
        except Exception as failure:  # every fsspec file system raises its own
            return RunOutcome(
                config.run_id, f"its results can't be written to {self.task.place}: {failure}", str(self._log)
            )
        self._input.close()
        shutil.rmtree(self._scratch, ignore_errors=True)
        return RunOutcome(config.run_id, error, f"{store.place}/{study}/{config.run_id}/{LOG}")

    def discard(self) -> None:
        """Ends the worker and its player, whose results nobody wants, and removes the scratch folder."""
        kill_with_descendants(self._process.pid)
        self._process.wait()
        shutil.rmtree(self._scratch, ignore_errors=True)


def free_port() -> int:
    """A port of this machine that nobody uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _last_error(log: Path) -> str | None:
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    return errors[-1] if errors else (lines[-1] if lines else None)
