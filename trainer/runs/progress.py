"""What a person sees while a run trains: a progress bar in a terminal, a line now and then elsewhere."""

from dataclasses import dataclass
from types import TracebackType

from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from trainer.terminal import Terminal

LINES = 15  # printed over a whole run where there is no terminal


@dataclass(frozen=True)
class Snapshot:
    """A run at one moment; means are over the last episodes, None before there are any.

    The success rate is None, too, if the player has not reported success for ``unknown`` of the last ``episodes``.
    """

    steps: int
    mean_return: float | None
    success_rate: float | None
    mean_length: float | None
    intrinsic_reward: float | None
    unknown: int = 0
    episodes: int = 0

    def text(self) -> str:
        """Return, success rate, episode length and intrinsic reward."""
        some = 0 < self.unknown < self.episodes
        success = f"unknown for {self.unknown} of {self.episodes}" if some else _number(self.success_rate, ".0%")
        return (
            f"return {_number(self.mean_return, '+.2f')}  success {success}  "
            f"length {_number(self.mean_length, '.0f')}  curiosity {_number(self.intrinsic_reward, '.5f')}"
        )


class _SpeedColumn(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text("- steps/s" if task.speed is None else f"{task.speed:,.0f} steps/s")


class ProgressDisplay:
    """Shows snapshots of a run.

    Args:
        run_id: The run's name.
        total: Its agent steps.
        done_before: Steps that a resumed run already has.
    """

    def __init__(self, run_id: str, total: int, done_before: int) -> None:
        self._console = Terminal()
        self._total = total
        self._next_line = done_before
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
        self._task = self._bar.add_task(run_id, total=total, completed=done_before, text="")

    def __enter__(self) -> "ProgressDisplay":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, snapshot: Snapshot) -> None:
        """Shows a newer snapshot."""
        self._bar.update(self._task, completed=min(snapshot.steps, self._total), text=snapshot.text())
        if not self._console.is_terminal and snapshot.steps >= self._next_line:
            self._next_line += max(self._total // LINES, 1)
            self._console.print(f"{snapshot.steps:>9,} steps  {snapshot.text()}")


def _number(value: float | None, layout: str) -> str:
    return "-" if value is None else format(value, layout)
