"""What a person sees while a run trains: in a terminal a line that moves, a line now and then elsewhere."""

import time
from dataclasses import dataclass
from datetime import timedelta
from types import TracebackType

from rich.cells import cell_len, set_cell_size
from rich.progress import Progress, Task, TaskID
from rich.text import Text

from trainer.activity import BETWEEN, OneLine, bar, percent
from trainer.terminal import Terminal

LINES = 15  # printed over a whole run where there is no terminal
MOVES = 0.25  # seconds, at least, between two that are shown before an update
NAME = 20  # characters, at most
# What there should be room for first; of several lines, the name is to tell them apart.
MATTERS = ("share", "left", "return", "name", "success", "bar", "steps", "speed", "length", "curiosity")


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

    def parts(self) -> dict[str, str]:
        """Return, success rate, episode length and intrinsic reward as they are shown, by name."""
        some = 0 < self.unknown < self.episodes
        success = f"unknown for {self.unknown} of {self.episodes}" if some else _number(self.success_rate, ".0%")
        parts = {"return": _number(self.mean_return, "+.2f")}
        if some or self.success_rate is not None or self.reports_success:
            parts["success"] = success
        parts["length"] = _number(self.mean_length, ".0f")
        if self.is_curious:
            parts["curiosity"] = _number(self.intrinsic_reward, ".5f")
        return {name: f"{name} {value}" for name, value in parts.items()}


class ProgressDisplay:
    """Shows snapshots of what is trained, a line each."""

    def __init__(self) -> None:
        self._console = Terminal()
        self._bar = Progress(
            OneLine(self._console, self._parts, self._matters),
            console=self._console,
            speed_estimate_period=10.0,
            disable=not self._console.is_terminal,
        )
        self._lines: dict[str, _Line] = {}

    def _parts(self, task: Task) -> dict[str, str | Text]:
        snapshot = task.fields["snapshot"]
        left = "-:--:--" if task.time_remaining is None else timedelta(seconds=int(task.time_remaining))
        speed = "-" if task.speed is None else f"{task.speed:,.0f}"
        return {
            "name": self._name(task),
            "share": percent(task),
            "bar": bar(task, self._console),
            "left": f"{left} left",
            **({"return": "first update to come"} if snapshot is None else snapshot.parts()),
            "steps": f"{task.completed:,.0f}/{task.total:,.0f} steps",
            "speed": f"{speed} steps/s",
        }

    def _name(self, task: Task) -> str:
        """The task's name, as wide as the others', which takes a quarter of the room at most."""
        most = min(NAME, self._console.width // 4)
        names = {each.id: each.description for each in self._bar.tasks}
        cut = {id: set_cell_size(name, most - 1) + "…" if cell_len(name) > most else name for id, name in names.items()}
        return set_cell_size(cut[task.id], max(map(cell_len, cut.values())))

    def _matters(self, _: Task) -> tuple[str, ...]:
        return MATTERS if len(self._lines) < 2 else ("share", "name", *MATTERS)

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
        task = self._bar.add_task(
            self._console.render_str(name).plain, total=total, completed=done_before, snapshot=None
        )
        self._lines[name] = _Line(task, total, done_before)
        if not self._console.is_terminal:
            before = f", {done_before:,} of them done before" if done_before else ""
            self._console.print(f"Training {name} for {total:,} steps{before} ...")

    def move(self, name: str, steps: int) -> None:
        """Shows how many steps a line has taken by now, between updates; may be called at every step."""
        line, now = self._lines[name], time.monotonic()
        if now >= line.next_move:
            line.next_move = now + MOVES
            self._bar.update(line.task, completed=min(steps, line.total))

    def update(self, name: str, snapshot: Snapshot) -> None:
        """Shows a newer snapshot of a line."""
        line = self._lines[name]
        self._bar.update(line.task, completed=min(snapshot.steps, line.total), snapshot=snapshot)
        if not self._console.is_terminal and snapshot.steps >= line.next_printed:
            line.next_printed += max(line.total // LINES, 1)
            whose = f"  {name}" if len(self._lines) > 1 else ""
            self._console.print(f"{snapshot.steps:>9,} steps{whose}  {BETWEEN.join(snapshot.parts().values())}")


@dataclass
class _Line:
    task: TaskID
    total: int
    next_printed: int
    next_move: float = 0.0


def _number(value: float | None, layout: str) -> str:
    return "-" if value is None else format(value, layout)
