"""Processes that begin with everything imported: they are forked from one that did it once, as it takes seconds.

Each is a process of its own, with its signals, its exit code and its end. Only the imports came before it, and the
kernel shows another command line of it than a shell's.
"""

import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

IMPORTED = (
    "pytest",
    "corridor_server.main",
    "trainer.main",
    "trainer.command_line",
    "trainer.runs.run",
    "trainer.runs.figures",
    "compiled",
)
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload([*IMPORTED])


class Prepared:
    """As much of a ``subprocess.Popen`` as the tests need, of a Python script such as ``corridor``.

    Args:
        command: The script and its arguments.
    """

    def __init__(self, command: Sequence[object]) -> None:
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - as long as it is asked for
        output = f"/proc/{os.getpid()}/fd/{self._output.fileno()}"
        self._process = _FORKS.Process(target=_run, args=([*map(str, command)], dict(os.environ), output))
        self._process.start()
        self.pid: int = self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired("a prepared process", timeout or 0.0)
        return self.returncode

    def said(self) -> str:
        """What it wrote so far, to whichever stream."""
        return os.pread(self._output.fileno(), 1 << 24, 0).decode()

    def communicate(self, timeout: float | None = None) -> tuple[str, None]:
        self.wait(timeout)
        return self.said(), None

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it ended in between, and the one that forks has not said so yet
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _run(command: list[str], environment: dict[str, str], output: str) -> None:
    """What ``python SCRIPT ARGUMENT ...`` does, in the new process."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run under nohup
    os.environ.clear()
    os.environ.update(environment)
    written = os.open(output, os.O_WRONLY | os.O_APPEND)
    os.dup2(written, 1)
    os.dup2(written, 2)
    sys.argv[:] = command
    sys.path.insert(0, str(Path(command[0]).parent))
    runpy.run_path(command[0], run_name="__main__")
