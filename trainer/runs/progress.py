"""What a person sees while a run trains: a progress bar in a terminal, a line now and then elsewhere."""

from dataclasses import dataclass
from types import TracebackType

from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from trainer.terminal import Terminal

LINES = 15  # printed over a whole run where there is no terminal


@dataclass(frozen=True)
class Snapshot:
    """A run at one moment; means are over the last episodes, None before there are any.

    The success rate is None, too, if the player has not reported success for ``unknown`` of the last ``episodes``; what
    the run is not about is left out.
    """

    steps: int
    mean_return: float | None
    success_rate: float | None
    mean_length: float | None
    intrinsic_reward: float | None
    unknown: int = 0
    episodes: int = 0
    reports_success: bool = True
    is_curious: bool = True

    def text(self) -> str:
        """Return, success rate, episode length and intrinsic reward."""
        some = 0 < self.unknown < self.episodes
        success = f"unknown for {self.unknown} of {self.episodes}" if some else _number(self.success_rate, ".0%")
        known = some or self.success_rate is not None or self.reports_success
        parts = [
            f"return {_number(self.mean_return, '+.2f')}",
            f"success {success}" if known else None,
            f"length {_number(self.mean_length, '.0f')}",
            f"curiosity {_number(self.intrinsic_reward, '.5f')}" if self.is_curious else None,
        ]
        return "  ".join(part for part in parts if part is not None)


class _SpeedColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text("- steps/s" if task.speed is None else f"{task.speed:,.0f} steps/s")


class ProgressDisplay:
    """Shows snapshots of what is trained, a line each."""

    def __init__(self) -> None:
        self._console = Terminal()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.completed:,.0f}/{task.total:,.0f} steps", markup=False),
            _SpeedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[text]}", markup=False),
            console=self._console,
            speed_estimate_period=10.0,
            disable=not self._console.is_terminal,
        )
        self._lines: dict[str, _Line] = {}

    def __enter__(self) -> "ProgressDisplay":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._bar.stop()

    def add(self, name: str, total: int, done_before: int) -> None:
        """Begins a line.

        Args:
            name: What it is about.
            total: Agent steps in all.
            done_before: Steps that a resumed run already has.
        """
        task = self._bar.add_task(name, total=total, completed=done_before, text="")
        self._lines[name] = _Line(task, total, done_before)

    def update(self, name: str, snapshot: Snapshot) -> None:
        """Shows a newer snapshot of a line."""
        line = self._lines[name]
        self._bar.update(line.task, completed=min(snapshot.steps, line.total), text=snapshot.text())
        if not self._console.is_terminal and snapshot.steps >= line.next_printed:
            line.next_printed += max(line.total // LINES, 1)
            whose = f"  {name}" if len(self._lines) > 1 else ""
            self._console.print(f"{snapshot.steps:>9,} steps{whose}  {snapshot.text()}")


@dataclass
class _Line:
    task: TaskID
    total: int
    next_printed: int


def _number(value: float | None, layout: str) -> str:
    return "-" if value is None else format(value, layout)
