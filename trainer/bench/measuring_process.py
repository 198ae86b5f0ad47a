"""Programs that measure in a process of their own, when told to."""

import shlex
import subprocess
import sys
from pathlib import Path
from types import TracebackType

from trainer.errors import TrainerError

CLIENT_PROGRAM = Path(__file__).with_name("client_program.py")
ECHO_PROGRAM = Path(__file__).with_name("echo_program.py")
END_SECONDS = 20


class MeasuringProcess:
    """One of the two programs, running.

    Args:
        program: Its file.
        *arguments: Its arguments.
        python: The interpreter.

    Raises:
        TrainerError: It ended before it was ready.
    """

    def __init__(self, program: Path, *arguments: object, python: str = sys.executable) -> None:
        self._command = [python, str(program), *map(str, arguments)]
        try:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except OSError as error:
            raise TrainerError(f"{python} can't be started ({error.strerror}); give a Python interpreter.") from error
        self._line()

    def __enter__(self) -> "MeasuringProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(END_SECONDS)

    def rate(self, seconds: float) -> float:
        """Has it measure for so long; returns exchanges per second.

        Raises:
            TrainerError: It ended instead.
        """
        assert self._process.stdin is not None
        self._process.stdin.write(f"{seconds}\n")
        self._process.stdin.flush()
        return float(self._line())

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise TrainerError(f"{shlex.join(self._command)} ended before it measured anything; run it by hand.")
        return line
