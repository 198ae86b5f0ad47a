"""Standard output and error that can't be written cost what was to be printed, and nothing else."""

import errno
import json
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from conftest import BIN

from trainer.errors import TrainerError
from trainer.main import main
from trainer.runs.folder import RunFolder
from trainer.runs.run import _written_to

PRINTS = """
import os, sys
from corridor_server.shared.standard_streams import drop_failing_output
drop_failing_output()
with open(sys.argv[1], "w") as file:
    print("x" * 100_000, flush=True)
    print("error", file=sys.stderr)
    os.system("echo from a child; echo and its error >&2")
    file.write("whole")
print("left to the interpreter to write")
"""


@contextmanager
def full_disk() -> Iterator[int]:
    with open("/dev/full", "wb") as file:
        yield file.fileno()


@contextmanager
def pipe_without_reader() -> Iterator[int]:
    reader, writer = os.pipe()
    os.close(reader)
    yield writer
    os.close(writer)


@contextmanager
def terminal_that_is_gone() -> Iterator[int]:
    terminal, output = pty.openpty()
    os.close(terminal)
    yield output
    os.close(output)


@contextmanager
def closed() -> Iterator[None]:
    yield None


OUTPUTS = [full_disk, pipe_without_reader, terminal_that_is_gone, closed]


def run(command: list[object], output: int | None, timeout: float = 60.0) -> int:
    """With standard output and error there, and standard input closed, too, where they are."""
    if output is None:
        return subprocess.run(["sh", "-c", '"$0" "$@" <&- >&- 2>&-', *map(str, command)], timeout=timeout).returncode
    return subprocess.run([str(each) for each in command], stdout=output, stderr=output, timeout=timeout).returncode


@pytest.mark.parametrize("output", OUTPUTS)
def test_output_that_fails_is_dropped_and_files_are_written(output, tmp_path):
    with output() as descriptor:
        assert run([sys.executable, "-c", PRINTS, tmp_path / "file"], descriptor) == 0
    assert (tmp_path / "file").read_text() == "whole"


def test_a_reader_that_does_not_keep_up_is_waited_for(tmp_path):
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    process = subprocess.Popen([sys.executable, "-c", PRINTS, tmp_path / "file"], stdout=writer)
    os.close(writer)
    with open(reader) as file:
        assert file.read() == "x" * 100_000 + "\nfrom a child\nleft to the interpreter to write\n"
    assert process.wait(30) == 0


@pytest.mark.parametrize(
    ("command", "exit_code"),
    [
        (["corridor", "--help"], 0),
        (["corridor", "train", "--nonsense"], 2),
        (["corridor", "export", "nobody", "--onnx", "nowhere"], 1),
        (["corridor-server", "--help"], 0),
        (["corridor-server", "--timeout-wait", "0", "--mlagents-port", "1"], 1),
    ],
)
def test_a_command_ends_with_the_exit_code_that_it_has_in_a_terminal(command, exit_code):
    with full_disk() as descriptor:
        assert run([BIN / command[0], *command[1:]], descriptor) == exit_code


@pytest.mark.slow
def test_a_run_whose_terminal_is_closed_goes_on_to_its_end(tmp_path, free_port):
    command = [BIN / "corridor", "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port]
    terminal, output = pty.openpty()
    process = subprocess.Popen(
        [*map(str, command), "--steps", "1000", "--num-areas", "8", "--eval-episodes", "4"],
        stdout=output,
        stderr=output,
    )
    os.close(output)
    assert os.read(terminal, 1)  # the progress bar is there, which is drawn by a thread
    os.close(terminal)
    assert process.wait(120) == 0
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["evaluation"]["episodes"] == 4


def test_what_the_system_refuses_is_one_sentence(monkeypatch, capsys):
    def refused(*_):
        raise PermissionError(errno.EACCES, "Permission denied", "/some/file")

    monkeypatch.setattr("trainer.commands.export.Export.run", refused)
    assert main(["export", "r", "--onnx", "r.onnx"]) == 1
    assert capsys.readouterr().err == "error: The system refuses /some/file: Permission denied.\n"


def test_the_results_folder_is_blamed_only_for_what_it_did(tmp_path):
    folder = RunFolder(tmp_path / "r")
    for error in (OSError(errno.ENOSPC, "full"), PermissionError(errno.EACCES, "closed", str(folder.progress))):
        with (
            pytest.raises(TrainerError, match=r"r can't be written \((full|closed)\); nothing is saved"),
            _written_to(folder),
        ):
            raise error
    for error in (OSError(errno.EMFILE, "many"), PermissionError(errno.EACCES, "closed", str(tmp_path / "other"))):
        with pytest.raises(OSError), _written_to(folder):  # noqa: PT011 - which is the one that was raised
            raise error
