"""Processes that learn in turns, on cores that they are held to: how fast, with how much of the cores and of memory."""

import json
import os
import re
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import psutil

from trainer.errors import TrainerError
from trainer.signals import kill_with_descendants

PATIENCE_SECONDS = 300  # with a program that says nothing: one that compiles takes a while
END_SECONDS = 10
PEAK = re.compile(r"^VmHWM:\s*(\d+) kB", re.MULTILINE)
# A summary of mlagents-learn, such as ``Corridor. Step: 4096. Time Elapsed: 12.345 s. ...``.
SUMMARY = re.compile(r"\bStep: (\d+)\. Time Elapsed: ")


class Turn(NamedTuple):
    """What was learned in a turn.

    Attributes:
        rate: Agent steps per second.
        cores: Seconds of processors per second.
        fault: What is wrong with what was learned; empty if nothing is.
    """

    rate: float
    cores: float
    fault: str = ""


class LearningProcess:
    """A program that learns in turns (``trainer.bench.peers.turns``), with all processes that it starts.

    Args:
        name: Of what it runs, for messages.
        command: How it is started.
        cores: The numbers of those that it may use.
        variables: Its environment variables.
        folder: Where it runs.

    Raises:
        TrainerError: It ended before it was ready, or was silent for too long.
    """

    def __init__(
        self, name: str, command: Sequence[str], cores: Sequence[int], variables: dict[str, str], folder: Path
    ) -> None:
        self.name = name
        self._errors = (folder / f"{len(list(folder.iterdir()))}.log").open("w+", errors="replace")
        with _held_to(cores):
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                env=variables,
                cwd=folder,
            )
        self._family = psutil.Process(self._process.pid)
        try:
            self._become_ready()
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> "LearningProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._end()

    def turn(self, seconds: float) -> Turn:
        """Has it learn for so long, and to the end of an update.

        Raises:
            TrainerError: It ended instead, or was silent for too long.
        """
        assert self._process.stdin is not None
        before = self._processor_seconds()
        with suppress(BrokenPipeError):  # it has ended, which the next line says
            self._process.stdin.write(f"{seconds}\n")
            self._process.stdin.flush()
        done = json.loads(self._line())
        used = self._processor_seconds() - before
        fault = "its loss is no number" if done["loss"] is None else "" if done["steps"] else "it took no step"
        return Turn(done["steps"] / done["seconds"], used / done["seconds"], fault)

    def peak_megabytes(self) -> float:
        """The most memory that it had, all of its processes together, in MB."""
        kilobytes = 0
        for each in self._all():
            with suppress(OSError):
                found = PEAK.search(Path(f"/proc/{each.pid}/status").read_text())
                kilobytes += int(found[1]) if found else 0
        return round(kilobytes / 1024, 1)

    def _become_ready(self) -> None:
        self._line()

    def _end(self) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_SECONDS)
        self._kill()

    def _kill(self) -> None:
        kill_with_descendants(self._process.pid)
        self._process.wait()
        self._errors.close()

    def _line(self) -> str:
        assert self._process.stdout is not None
        silence = threading.Timer(PATIENCE_SECONDS, kill_with_descendants, [self._process.pid])
        silence.start()
        try:
            line = self._process.stdout.readline()
        finally:
            silence.cancel()
        if not line:
            raise TrainerError(f"{self.name} ended before it measured anything: {self._last_words()}")
        return line

    def _last_words(self) -> str:
        self._errors.seek(0)
        said = [line.strip() for line in self._errors if line.strip()]
        return said[-1] if said else f"it said nothing (within {PATIENCE_SECONDS} s)."

    def _all(self) -> list[psutil.Process]:
        with suppress(psutil.Error):
            return [self._family, *self._family.children(recursive=True)]
        return []

    def _processor_seconds(self) -> float:
        total = 0.0
        for each in self._all():
            with suppress(psutil.Error):
                times = each.cpu_times()
                total += times.user + times.system
        return total


class MLAgentsProcess(LearningProcess):
    """``mlagents-learn``, which stands still between its turns; what it prints of its steps is measured.

    A turn is from a summary to another, and lasts at least as long as is asked for.
    """

    SUMMARIES = 3  # before anything is measured

    def turn(self, seconds: float) -> Turn:
        """See ``LearningProcess``."""
        self._continue()
        (begun, first), before = self._summary(), self._processor_seconds()
        ended, last = begun, first
        while ended - begun < seconds:
            ended, last = self._summary()
        used = self._processor_seconds() - before
        self._pause()
        return Turn((last - first) / (ended - begun), used / (ended - begun))

    def _become_ready(self) -> None:
        for _ in range(self.SUMMARIES):
            self._summary()
        self._pause()

    def _summary(self) -> tuple[float, int]:
        """When the next one came, and its steps."""
        while True:
            found = SUMMARY.search(self._line())
            if found:
                return time.perf_counter(), int(found[1])

    def _last_words(self) -> str:
        return "run it by hand."  # it prints all on one stream, and reasons in the middle

    def _pause(self) -> None:
        for each in self._all():
            each.suspend()

    def _continue(self) -> None:
        for each in self._all():
            each.resume()

    def _end(self) -> None:
        self._kill()


@contextmanager
def _held_to(cores: Sequence[int]) -> Iterator[None]:
    """What is started meanwhile may use these cores alone."""
    before: Any = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
