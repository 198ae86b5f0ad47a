"""What a person sees while a study runs: runs done and running, and the time left."""

import time
from types import TracebackType

from rich.progress import Progress, Task
from rich.text import Text

from trainer.activity import OneLine, bar, percent
from trainer.studies.executors import Update
from trainer.terminal import Terminal

# What there should be room for first.
MATTERS = ("share", "left", "done", "running", "bar", "name")


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
            OneLine(console, self._parts, lambda task: MATTERS), console=console, disable=not console.is_terminal
        )
        self._task = self._bar.add_task(name, total=max(missing * steps, 1), done=total - missing, running=0, left="")

    def _parts(self, task: Task) -> dict[str, str | Text]:
        return {
            "name": task.description,
            "share": percent(task),
            "bar": bar(task, self._console),
            **({"left": task.fields["left"]} if task.fields["left"] else {}),
            "done": f"{task.fields['done']}/{self._total} runs done",
            "running": f"{task.fields['running']} running",
        }

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
                self._console.print(f"{begin} finished{left and f', {left}'}")
            else:
                self._console.print_failure(f"{begin} failed:", f"{outcome.error}{left and f', {left}'}")
        done = self._total - self._missing + self._ended
        self._bar.update(self._task, completed=taken, done=done, running=update.running, left=left)

    def _left(self, taken: int) -> str:
        if not taken:
            return ""
        seconds = (time.monotonic() - self._started) * (self._missing * self._steps / taken - 1.0)
        minutes = round(seconds / 60)
        return f"about {minutes} min left" if minutes else "less than a minute left" if seconds > 1 else ""
