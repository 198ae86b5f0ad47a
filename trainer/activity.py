"""What a command says while it works: what it is doing, how far that is, and that it is still doing it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from rich.cells import cell_len
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task
from rich.table import Column
from rich.text import Text

from trainer.terminal import Terminal

BAR = 24  # characters
BETWEEN = "  "


class OneLine(ProgressColumn):
    """As much about a task as one line of the terminal has room for, however narrow that is.

    Args:
        console: The terminal.
        parts: What there is to say of a task, by name, in the order in which it stands.
        matters: Of a task, the names, those first that give way last.
    """

    def __init__(
        self,
        console: Terminal,
        parts: Callable[[Task], Mapping[str, str | Text]],
        matters: Callable[[Task], Sequence[str]],
    ) -> None:
        super().__init__(table_column=Column(no_wrap=True, overflow="crop"))
        self._console, self._parts, self._matters = console, parts, matters

    def render(self, task: Task) -> Text:
        """The line."""
        parts = {name: part if isinstance(part, Text) else Text(part) for name, part in self._parts(task).items()}
        room = self._console.width - 1  # a character in the last column would begin the next line
        shown: set[str] = set()
        for name in dict.fromkeys(name for name in self._matters(task) if name in parts):
            needed = cell_len(parts[name].plain) + len(BETWEEN) * bool(shown)
            if needed <= room:
                room -= needed
                shown.add(name)
        return Text(BETWEEN).join(part for name, part in parts.items() if name in shown)


def share_of(task: Task) -> float:
    """How much of a task is done, from 0 to 1."""
    return min(task.completed / task.total, 1.0) if task.total else 1.0


def percent(task: Task) -> str:
    """The same as a whole number; 100 only at the end."""
    return f"{int(100 * share_of(task)):3d}%"


def bar(task: Task, console: Terminal) -> Text:
    """The same as a picture."""
    full, empty = ("━", "─") if console.encoding.startswith("utf") else ("=", "-")
    done = int(BAR * share_of(task))
    return Text.assemble((full * done, "green"), (empty * (BAR - done), "dim"))


class _Doing(ProgressColumn):
    """What is being done, how many of how many, and since when; where there is little room, less of the first."""

    def __init__(self, console: Terminal) -> None:
        super().__init__(table_column=Column(no_wrap=True, overflow="crop"))
        self._console = console

    def render(self, task: Task) -> Text:
        of = "" if task.total is None else f"{task.completed:,.0f} of {task.total:,.0f}, "
        count = f"{BETWEEN}{of}{task.elapsed or 0:.0f} s"
        what = Text(task.description)
        what.truncate(max(self._console.width - len("* ") - len(count) - 1, 1), overflow="ellipsis")
        return what.append(count)


@contextmanager
def doing(what: str, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """Says what is being done for as long as it is: to a terminal in a line that moves and then goes, else in a line.

    Args:
        what: Such as "Starting the player".
        total: How many there are of what is counted; None if nothing is.

    Yields:
        To be told how many are done.
    """
    console = Terminal()
    if not console.is_terminal:
        console.print(f"{what} ...")
        yield _ignore
        return
    progress = Progress(
        SpinnerColumn("dots" if console.encoding.startswith("utf") else "line"),
        _Doing(console),
        console=console,
        transient=True,
    )
    with progress:
        task = progress.add_task(console.render_str(what).plain, total=total)
        yield lambda done: progress.update(task, completed=done)


def _ignore(_: int) -> None:
    pass
