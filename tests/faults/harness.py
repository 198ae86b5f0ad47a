"""What breaks a training run, and what is looked at afterwards; for tests/runs/test_faults.py and campaign.py."""

import csv
import ctypes
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from trainer.runs.checkpoint import checkpoints, from_bytes

BIN = Path(sys.executable).parent
TIMING = {"steps_per_second", "wall_seconds"}
PIDFD_GETFD = 438  # the system call's number, which Python does not wrap
SHORT = ("--num-areas", 8, "--steps", 3_000, "--eval-episodes", 2, "--timeout-wait", 120)
STARTING_SECONDS = 180.0  # on a machine that does ten other things


def _default_hangup() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class Run:
    """One run id, and the command that trains it."""

    def __init__(self, results: Path, run_id: str, port: int, *options: object) -> None:
        self.folder, self.port = results / run_id, port
        self._command = [str(BIN / "corridor"), "train", "--run-id", run_id, "--results-dir", str(results)]
        self._command += ["--base-port", str(port), *map(str, options)]
        self.output = ""

    def start(self, *options: object) -> "subprocess.Popen[str]":
        """Starts the trainer."""
        return subprocess.Popen(
            [*self._command, *map(str, options)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            # Where the tests themselves run under nohup, the trainer would rightly ignore a SIGHUP.
            preexec_fn=_default_hangup,
        )

    def finish(self, *options: object) -> int:
        """Runs the trainer to its end; returns its exit code."""
        return self.wait(self.start(*options))

    def wait(self, process: "subprocess.Popen[str]", timeout: float = 600.0) -> int:
        """Waits for the trainer; returns its exit code."""
        self.output, _ = process.communicate(timeout=timeout)
        return process.returncode

    def steps(self) -> int:
        """Steps of the newest checkpoint; 0 without one."""
        found = checkpoints(self.folder / "checkpoints")
        return int(found[-1].stem.rpartition("-")[2]) if found else 0

    def wait_for_steps(self, process: "subprocess.Popen[str]", steps: int) -> None:
        """Waits until a checkpoint has so many steps, or the trainer has ended."""
        deadline = time.monotonic() + STARTING_SECONDS
        while self.steps() < steps and process.poll() is None:
            assert time.monotonic() < deadline, "the trainer gets nowhere"
            time.sleep(0.005)

    def players(self) -> list[int]:
        """Process ids of the run's players."""
        found = subprocess.run(["pgrep", "-f", f"mlagents-port {self.port}"], capture_output=True, text=True)
        return [int(line) for line in found.stdout.split()]

    def summary(self) -> dict[str, Any]:
        """``summary.json``."""
        read: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return read

    def rows(self) -> list[dict[str, str]]:
        """``progress.csv`` without its timing columns."""
        with (self.folder / "progress.csv").open(newline="") as file:
            return [{name: value for name, value in row.items() if name not in TIMING} for row in csv.DictReader(file)]

    def events(self) -> dict[str, list[tuple[int, float]]]:
        """Every TensorBoard scalar's steps and values, without the rate."""
        log = EventAccumulator(str(self.folder / "tensorboard"), size_guidance={"scalars": 0})
        log.Reload()
        tags = [tag for tag in log.Tags()["scalars"] if tag != "time/fps"]
        return {tag: [(event.step, event.value) for event in log.Scalars(tag)] for tag in tags}

    def leaves_nothing_behind(self) -> None:
        """No player lives on (a moment is allowed), the port is free, and every checkpoint is whole."""
        deadline = time.monotonic() + 30.0
        while self.players() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not self.players(), "a player lives on"
        listening = subprocess.run(["ss", "-Hltn", f"sport = :{self.port}"], capture_output=True, text=True).stdout
        assert not listening, listening
        for path in checkpoints(self.folder / "checkpoints"):
            from_bytes(path.read_bytes())

    def equals(self, uncut: "Run") -> None:
        """The same weights, evaluation, rows and TensorBoard values as another run's."""
        mine, theirs = self.summary(), uncut.summary()
        for name in ("policy_sha256", "evaluation", "env_steps", "episodes"):
            assert mine[name] == theirs[name], name
        assert self.rows() == uncut.rows()
        assert self.events() == uncut.events()


def train_with_kills(run: Run, kills: int, steps: int, generator: random.Random) -> list[int]:
    """Trains a run that is killed at random moments, start and end included; returns where it was each time."""
    moments: list[int] = []
    while len(moments) < kills:
        process = run.start(*(["--resume"] if moments else []))
        _wait_for(lambda: (run.folder / "configuration.yaml").exists())
        if generator.random() < 0.1:
            time.sleep(generator.uniform(0.0, 4.0))  # while it starts
        else:
            left = max(1, (steps - run.steps()) // (kills - len(moments)))
            run.wait_for_steps(process, run.steps() + generator.randint(1, 2 * left))
            time.sleep(generator.uniform(0.0, 0.03))
        process.kill()
        run.wait(process)
        run.leaves_nothing_behind()
        moments.append(run.steps())
    assert run.finish("--resume") == 0, run.output
    run.leaves_nothing_behind()
    return moments


def stop_with(run: Run, number: signal.Signals, steps: int, seconds: float, *options: object) -> int:
    """Starts a run, sends a signal a moment after so many steps, and waits; returns the exit code."""
    process = run.start(*options)
    run.wait_for_steps(process, steps)
    time.sleep(seconds)
    process.send_signal(number)
    return run.wait(process)


def hurt_player(run: Run, fault: Callable[[int], None], steps: int, seconds: float) -> int:
    """Starts a run and does something to its player a moment after so many steps; returns the trainer's exit code."""
    process = run.start()
    run.wait_for_steps(process, steps)
    time.sleep(seconds)
    for player in run.players():
        fault(player)
    return run.wait(process)


def kill_players_every(seconds: float, run: Run) -> int:
    """Starts a run and kills its players again and again; returns the trainer's exit code."""
    process = run.start()
    run.wait_for_steps(process, 1)
    while process.poll() is None:
        for player in run.players():
            os.kill(player, signal.SIGKILL)
        with suppress(subprocess.TimeoutExpired):
            process.wait(seconds)
    return run.wait(process)


def train_with_pauses(run: Run, times: int, seconds: float, generator: random.Random) -> int:
    """Trains a run that is paused again and again, every other time with its players; returns its exit code."""
    process = run.start()
    run.wait_for_steps(process, 1)
    for number in range(times):
        time.sleep(generator.uniform(0.2, 0.6))
        assert process.poll() is None, "the run is over; it takes more steps"
        paused = [process.pid, *(run.players() if number % 2 else [])]
        for number_of_signal in (signal.SIGSTOP, signal.SIGCONT):
            for each in paused:
                with suppress(ProcessLookupError):  # a player that training is done with
                    os.kill(each, number_of_signal)
            time.sleep(seconds if number_of_signal == signal.SIGSTOP else 0.0)
    return run.wait(process)


def send(number: signal.Signals) -> Callable[[int], None]:
    """A fault: the player gets a signal."""
    return lambda player: os.kill(player, number)


def cut_connection(player: int) -> None:
    """A fault: the player lives, its connection does not. Takes the right to reach into another process (root)."""
    process = os.pidfd_open(player)
    for each in Path(f"/proc/{player}/fd").iterdir():
        if not os.readlink(each).startswith("socket:"):
            continue
        number = ctypes.CDLL(None, use_errno=True).syscall(PIDFD_GETFD, process, int(each.name), 0)
        if number < 0:
            raise OSError(ctypes.get_errno(), "pidfd_getfd")
        with socket.socket(fileno=number) as connection:
            if connection.family in (socket.AF_INET, socket.AF_INET6):
                connection.shutdown(socket.SHUT_RDWR)
    os.close(process)


@contextmanager
def close_folder(folder: Path) -> Iterator[bool]:
    """Makes a folder read-only for a while; gives False where that is not allowed (it takes root)."""
    if subprocess.run(["mount", "--bind", str(folder), str(folder)], capture_output=True).returncode:
        yield False
        return
    try:
        subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)
        yield True
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def _wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + STARTING_SECONDS
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def mount_small(folder: Path, size: str, options: Sequence[str] = ()) -> bool:
    """Mounts a small tmpfs; False where that is not allowed."""
    folder.mkdir(parents=True, exist_ok=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", ",".join([f"size={size}", *options]), "tmpfs", str(folder)], capture_output=True
    )
    return done.returncode == 0
