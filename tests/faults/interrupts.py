"""Ends every command with signals at random moments, and checks that each time it is one clean end.

python tests/faults/interrupts.py --times 200                # of each command
python tests/faults/interrupts.py train evaluate --times 20

Half are SIGINT and half SIGTERM; one in three comes twice; every other SIGINT goes to the whole process group, as a
terminal's Ctrl-C does. A signal that comes before Python has reached the command's first line is not the command's to
answer: such are counted, and looked at for nothing but what is left.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

BIN = Path(sys.executable).parent
MARK = "CORRIDOR_INTERRUPTED"  # in the environment of a command and of all that it starts
SECONDS = 6.0  # after the start, at most
LIMIT = 2.0  # seconds for the end, on a machine that does nothing else
HUNG = 45.0
LONG = ("--steps", "5000000", "--num-areas", "8")
SHORT = ("--steps", "1024", "--num-areas", "8", "--eval-episodes", "2")


@dataclass(frozen=True)
class Interrupt:
    """One signal, or two, to one command.

    Attributes:
        number: The signal.
        moment: Seconds after the start.
        again: Seconds until it comes once more; None for once.
        group: Whether it goes to the whole process group.
    """

    number: signal.Signals
    moment: float
    again: float | None
    group: bool

    def __str__(self) -> str:
        twice = "" if self.again is None else f" and again after {self.again:.2f} s"
        return f"{self.number.name}{' (group)' if self.group else ''} at {self.moment:.3f} s{twice}"


@dataclass(frozen=True)
class End:
    """How a command ended.

    Attributes:
        kind: ``clean``; ``early``, when no line of ours had run; ``over``, when it had ended by itself before.
        seconds: From the signal to the end.
        faults: What was wrong.
        output: What it wrote.
    """

    kind: str
    seconds: float
    faults: tuple[str, ...]
    output: str


def commands(results: Path, port: int) -> dict[str, Sequence[Sequence[str]]]:
    """The arguments of each command, in one or more ways of using it. ``trained`` is a run that has been trained."""
    place, players = ("--results-dir", str(results)), ("--base-port", str(port))
    train = ("train", "--run-id", "new", "--force", *place, *players)
    replay = ("replay", "trained", "--checkpoint", "step-1024", *place)
    study = ("study", "curiosity-ratio", "--seeds", "2", "--jobs", "2", "--steps", "100000", *place)
    return {
        "train": [(*train, *LONG), (*train, *SHORT), (*train, *LONG, "--num-envs", "2")],
        "evaluate": [("evaluate", "trained", "--episodes", "100000", *place, *players)],
        "replay": [("replay", "trained", *place), (*replay, "--episodes", "100000", *players)],
        "study": [study, ("study", "generalise", "trained", *place)],
        "check": [("check",)],
        "bench": [("bench", *players)],
        "watch": [("watch", "--port", "0", *place)],
    }


def interrupts(times: int, generator: random.Random, seconds: float = SECONDS) -> Iterator[Interrupt]:
    """Random ones, in the seconds after the start."""
    for index in range(times):
        number = (signal.SIGINT, signal.SIGTERM)[index % 2]
        again = generator.uniform(0.0, 0.5) if generator.random() < 1 / 3 else None
        yield Interrupt(number, generator.uniform(0.0, seconds), again, number == signal.SIGINT and index % 4 == 0)


def interrupted(arguments: Sequence[str], interrupt: Interrupt, folder: Path) -> End:
    """Starts a command, interrupts it, and looks at its end and at what it leaves.

    Args:
        arguments: The command's.
        interrupt: What it gets.
        folder: For its temporary files.
    """
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    temporary = folder / f"tmp-{mark}"
    temporary.mkdir()
    began = time.monotonic()
    process = subprocess.Popen(
        [str(BIN / "corridor"), *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, MARK: mark, "TMPDIR": str(temporary)},
        start_new_session=True,
        preexec_fn=_as_from_a_terminal,
    )
    with suppress(subprocess.TimeoutExpired):
        process.wait(interrupt.moment)
    time.sleep(max(0.0, began + interrupt.moment - time.monotonic()))
    kind = _kind(process)
    sent = time.monotonic()
    _send(process, interrupt)
    if interrupt.again is not None:
        with suppress(subprocess.TimeoutExpired):
            process.wait(interrupt.again)
        _send(process, interrupt)
    faults = []
    try:
        process.wait(HUNG)
    except subprocess.TimeoutExpired:
        faults.append("hung")
        process.kill()
    seconds = time.monotonic() - sent
    time.sleep(0.1)  # for whom it has killed
    for left in _marked(mark):
        faults.append(f"left process {left}")
        with suppress(OSError):
            os.kill(left, signal.SIGKILL)
    output, _ = process.communicate()
    if kind == "clean":
        if process.returncode != 130:
            faults.append(f"exit code {process.returncode}")
        if "Traceback" in output or "Exception ignored" in output:
            faults.append("traceback")
        faults += [f"left file {path.name}" for path in temporary.iterdir()]
    return End(kind, seconds, tuple(faults), output)


def _as_from_a_terminal() -> None:
    """Where this runs in the background or under nohup, these are ignored, and would be until the first line."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def _kind(process: "subprocess.Popen[str]") -> str:
    if process.poll() is not None:
        return "over"
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = int(next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:")), 16)
    return "clean" if caught >> (signal.SIGTERM - 1) & 1 else "early"


def _send(process: "subprocess.Popen[str]", interrupt: Interrupt) -> None:
    with suppress(OSError):
        (os.killpg if interrupt.group else os.kill)(process.pid, interrupt.number)


def _marked(mark: str) -> list[int]:
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found.append(int(folder.name))
    return found


def prepare(results: Path, port: int) -> None:
    """Trains the run that commands are about."""
    options = ("--results-dir", str(results), "--base-port", str(port), *SHORT)
    done = subprocess.run([str(BIN / "corridor"), "train", "--run-id", "trained", *options], capture_output=True)
    assert done.returncode == 0, done


def main() -> None:
    """Runs the campaign, and says how it went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", help="all if none is named")
    parser.add_argument("--times", type=int, default=200, help="signals for each command")
    parser.add_argument("--base-port", type=int, default=6800)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results"
        prepare(results, options.base_port)
        known = commands(results, options.base_port)
        for name in options.commands or known:
            generator, kinds, faults, slowest = random.Random(options.seed), Counter[str](), Counter[str](), 0.0
            for index, interrupt in enumerate(interrupts(options.times, generator)):
                end = interrupted(known[name][index % len(known[name])], interrupt, Path(folder))
                found = [*end.faults, *(["slow"] if end.kind == "clean" and end.seconds > LIMIT else [])]
                kinds[end.kind] += 1
                slowest = max(slowest, end.seconds if end.kind == "clean" else 0.0)
                faults.update(fault.rstrip("0123456789") for fault in found)
                if found:
                    busy = os.getloadavg()[0]
                    said = f"{name}: {interrupt}: {', '.join(found)} ({end.seconds:.2f} s, load {busy:.1f})"
                    print(f"{said}\n{end.output}", flush=True)
                if (index + 1) % 50 in (0, options.times % 50):
                    print(
                        f"{name}: {dict(kinds)}, slowest {slowest:.2f} s; faults: {dict(faults) or 'none'}", flush=True
                    )


if __name__ == "__main__":
    main()
