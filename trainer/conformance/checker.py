"""Runs the kit on one player and says, sentence by sentence, what holds."""

import inspect
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from trainer.conformance import PROTOCOL, CorridorContract
from trainer.conformance.suite import Conformance, NotApplicable
from trainer.corridor import is_corridor
from trainer.errors import TrainerError
from trainer.players.location import launch_path, place

MARKS = {"pass": "[green]pass[/]", "fail": "[bold red]fail[/]", "not applicable": "[dim]n/a[/]"}
Verdict = Literal["pass", "fail", "not applicable"]
Start = Callable[..., "subprocess.Popen[bytes] | None"]


@dataclass(frozen=True)
class Result:
    """One sentence about a player.

    Attributes:
        topic: What it is about.
        sentence: What should hold.
        verdict: Whether it does.
        detail: What was seen instead, or why it does not apply.
    """

    topic: str
    sentence: str
    verdict: Verdict
    detail: str = ""


def sentences(topic: type[Conformance]) -> list[str]:
    """The names of a topic's tests, in the order in which they stand."""
    tests = inspect.getmembers(topic, inspect.isfunction)
    tests = [test for test in tests if test[0].startswith("test_")]
    return [name for name, _ in sorted(tests, key=lambda test: test[1].__code__.co_firstlineno)]


def check(topics: Iterable[type[Conformance]], start: Start, report: Callable[[Result], None], **hooks: object) -> bool:
    """Runs every test of the topics on a player.

    Args:
        topics: Abstract classes of the kit.
        start: Starts the player, as ``Conformance.start_player``.
        report: Called with each result as it comes.
        **hooks: Other attributes of the topics, such as ``port``.

    Returns:
        Whether nothing failed.
    """
    passed = True
    for topic in topics:
        suite = type(topic.__name__, (topic,), {"start_player": staticmethod(start), **hooks})()
        title = (topic.__doc__ or topic.__name__).splitlines()[0]
        for name in sentences(topic):
            sentence = name.removeprefix("test_").replace("_", " ")
            try:
                getattr(suite, name)()
            except NotApplicable as reason:
                result = Result(title, sentence, "not applicable", str(reason))
            except (
                Exception
            ) as error:  # whatever a player provokes is a finding, and the next sentence is still checked
                detail = str(error).splitlines()[0] if str(error) else type(error).__name__
                result = Result(title, sentence, "fail", detail)
            else:
                result = Result(title, sentence, "pass")
            passed &= result.verdict != "fail"
            report(result)
    return passed


def check_player(env: str, timeout: float, console: Console) -> bool:
    """Runs the whole kit on a player and prints a table: the protocol, then, for a Corridor, its contract.

    Args:
        env: As ``corridor train --env`` takes it.
        timeout: Seconds to wait for each message.
        console: Where to print.

    Returns:
        Whether nothing failed.

    Raises:
        TrainerError: There is no such player, or it can't be started.
    """
    file_name, host, port = place(env, 0)
    launch = None if file_name is None else launch_path(file_name)
    if launch is None:
        console.print(f"Start the player now, and again whenever it ends: it is awaited on {host}:{port}.")

    def start(trainer_port: int, *arguments: str) -> "subprocess.Popen[bytes] | None":
        if launch is None:
            return None
        command = [launch, "-nographics", "-batchmode", "--mlagents-port", str(trainer_port), *arguments]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)

    hooks = {"timeout": timeout, "port": port, "host": host}
    results: list[Result] = []
    with console.status("Checking") as status:

        def report(result: Result) -> None:
            results.append(result)
            status.update(f"{result.topic} {len(results)} sentences checked")

        behaviors = _behaviors(start, hooks)
        passed = check(PROTOCOL, start, report, **hooks)
        if any(is_corridor(name) for name in behaviors):
            passed &= check([CorridorContract], start, report, **hooks)
    table = Table("", "sentence", "seen", title=f"{env}: {', '.join(behaviors)}", title_justify="left")
    topic = ""
    for result in results:
        if result.topic != topic:
            topic = result.topic
            table.add_row("", f"[bold]{topic}[/]", "")
        table.add_row(MARKS[result.verdict], result.sentence, escape(result.detail))
    console.print(table)
    counts = {verdict: sum(result.verdict == verdict for result in results) for verdict in MARKS}
    console.print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()), highlight=False)
    if not any(is_corridor(name) for name in behaviors):
        console.print("No behavior is called Corridor, so the corridor's contract was not checked.", highlight=False)
    return passed


def _behaviors(start: Start, hooks: dict[str, object]) -> list[str]:
    probe = type("Probe", (Conformance,), {"start_player": staticmethod(start), **hooks})()
    try:
        with probe.playing() as session:
            return list(session.specs)
    except AssertionError as error:
        raise TrainerError(f"The player does not play: {error} after it was started.") from error
