"""Runs the kit on one player and says, sentence by sentence, what holds."""

import inspect
import subprocess
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from rich.table import Table
from rich.text import Text

from corridor_server.shared.addresses import PortInUse, authority, free_addresses
from trainer.conformance import TOPICS, CorridorContract
from trainer.conformance.suite import Conformance, is_strict
from trainer.conformance.verdicts import NotApplicable
from trainer.corridor import is_corridor
from trainer.errors import TrainerError
from trainer.players.location import launch_path, place
from trainer.terminal import Terminal

MARKS = {"pass": Text("pass", "green"), "fail": Text("fail", "bold red"), "not applicable": Text("n/a", "dim")}
NOT_COUNTED = " (more than Unity's runtime keeps, so no part of the exit code)"
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


def sentences(topic: type[Conformance], strict: bool = False) -> list[str]:
    """The names of a topic's tests on one level, in the order in which they stand: the strict ones or the others."""
    tests = inspect.getmembers(topic, inspect.isfunction)
    tests = [test for test in tests if test[0].startswith("test_") and is_strict(test[1]) == strict]
    return [name for name, _ in sorted(tests, key=lambda test: inspect.unwrap(test[1]).__code__.co_firstlineno)]


def check(
    topics: Iterable[type[Conformance]],
    start: Start,
    report: Callable[[Result], None],
    strict: bool = False,
    **hooks: object,
) -> bool:
    """Runs every test of the topics, on one level, on a player.

    Args:
        topics: Abstract classes of the kit.
        start: Starts the player, as ``Conformance.start_player``.
        report: Called with each result as it comes.
        strict: Run the strict sentences instead of the protocol's.
        **hooks: Other attributes of the topics, such as ``port``.

    Returns:
        Whether nothing failed.
    """
    passed = True
    for topic in topics:
        own = {"start_player": staticmethod(start), "strict": strict, **hooks}
        suite = type(topic.__name__, (topic,), own)()
        title = (topic.__doc__ or topic.__name__).splitlines()[0]
        for name in sentences(topic, strict):
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


def check_player(env: str, env_args: Sequence[str], timeout: float, strict: bool, console: Terminal) -> bool:
    """Runs the kit on a player and prints a table for each part: the protocol, for a Corridor its contract, strict.

    Args:
        env: As ``corridor train --env`` takes it.
        env_args: Its own arguments, if it is started here.
        timeout: Seconds to wait for each message.
        strict: Run the strict sentences too.
        console: Where to print.

    Returns:
        Whether nothing failed of the protocol and the contract; the strict sentences are reported only.

    Raises:
        TrainerError: There is no such player, or it can't be started.
    """
    file_name, host, port = place(env, 0)
    launch = None if file_name is None else launch_path(file_name)
    if launch is None:
        try:
            free_addresses(host, port)
        except (PortInUse, ValueError) as error:
            raise TrainerError(str(error)) from error
        console.print(f"Start the player now, and again whenever it ends: it is awaited on {authority(host, port)}.")

    def start(trainer_port: int, *arguments: str) -> "subprocess.Popen[bytes] | None":
        if launch is None:
            return None
        command = [launch, "-nographics", "-batchmode", "--mlagents-port", str(trainer_port), *env_args, *arguments]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)

    hooks = {"timeout": timeout, "port": port, "host": host}
    parts: dict[str, list[Result]] = {}
    with console.status("Checking") as status:

        def run(part: str, topics: Iterable[type[Conformance]], strict: bool = False) -> bool:
            results = parts.setdefault(part, [])

            def report(result: Result) -> None:
                results.append(result)
                status.update(f"{part}: {result.topic} {len(results)} sentences checked")

            return check(topics, start, report, strict, **hooks)

        behaviors = _behaviors(start, hooks)
        passed = run("protocol", TOPICS)
        is_a_corridor = any(is_corridor(name) for name in behaviors)
        if is_a_corridor:
            passed &= run("contract", [CorridorContract])
        if strict:
            run("strict", TOPICS, strict=True)
    for part, results in parts.items():
        _print(console, f"{part}: {env}: {', '.join(behaviors)}", results)
    for part, results in parts.items():
        counts = {verdict: sum(result.verdict == verdict for result in results) for verdict in MARKS}
        said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        console.print(f"{part}: {said}{NOT_COUNTED if part == 'strict' else ''}")
    if not is_a_corridor:
        console.print("No behavior is called Corridor, so the corridor's contract was not checked.")
    return passed


def _print(console: Terminal, title: str, results: Iterable[Result]) -> None:
    table = Table("", "sentence", "seen", title=title, title_justify="left")
    topic = ""
    for result in results:
        if result.topic != topic:
            topic = result.topic
            table.add_row("", Text(topic, "bold"), "")
        table.add_row(MARKS[result.verdict], result.sentence, result.detail)
    console.print(table, soft_wrap=False)


def _behaviors(start: Start, hooks: dict[str, object]) -> list[str]:
    probe = type("Probe", (Conformance,), {"start_player": staticmethod(start), **hooks})()
    try:
        with probe.playing() as session:
            for _ in session.play(20):
                pass
            return list(session.specs)
    except AssertionError as error:
        raise TrainerError(f"The player does not play: {error} after it was started.") from error
