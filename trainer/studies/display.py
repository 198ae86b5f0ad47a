"""What a person sees while a study runs: runs done and running, and the time left."""

import time
from types import TracebackType

from rich.progress import BarColumn, Progress, TextColumn

from trainer.studies.executors import Update
from trainer.terminal import Terminal


class StudyDisplay:
    """A bar in a terminal, and everywhere a line for each run that ends.

    Args:
        console: Where to show it.
        name: The study's.
        total: Its runs.
        missing: Those of them that are not finished yet.
        steps: Agent steps per run.
    """

    def __init__(self, console: Terminal, name: str, total: int, missing: int, steps: int) -> None:
        self._console = console
        self._total, self._missing, self._steps = total, missing, steps
        self._ended = 0
        self._started = time.monotonic()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=32),
            TextColumn("{task.fields[text]}", markup=False),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task(name, total=max(missing * steps, 1), text="")

    def __enter__(self) -> "StudyDisplay":
        before = self._total - self._missing
        self._console.print(
            f"{self._total} runs of {self._steps:,} steps" + (f", {before} of them finished before" if before else ""),
        )
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, update: Update) -> None:
        """Shows what is going on now."""
        taken = min(update.steps, update.running * self._steps)
        taken += (self._ended + len(update.ended)) * self._steps
        left = self._left(taken)
        for outcome in update.ended:
            self._ended += 1
            done = self._total - self._missing + self._ended
            begin = f"{done}/{self._total} {outcome.run_id}"
            if outcome.error is None:
                self._console.print(f"{begin} finished{left}")
            else:
                self._console.print_failure(f"{begin} failed:", f"{outcome.error}{left}")
        done = self._total - self._missing + self._ended
        text = f"{done}/{self._total} runs done, {update.running} running{left}"
        self._bar.update(self._task, completed=taken, text=text)

    def _left(self, taken: int) -> str:
        if not taken:
            return ""
        seconds = (time.monotonic() - self._started) * (self._missing * self._steps / taken - 1.0)
        minutes = round(seconds / 60)
        return f", about {minutes} min left" if minutes else ", less than a minute left" if seconds > 1 else ""
