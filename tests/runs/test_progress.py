"""What is seen of work that goes on, in terminals of several widths: real ones, read as a person would."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time

import pytest
from conftest import BIN, corridor_here

LEARNING = """
import sys, time
from trainer.runs.progress import ProgressDisplay, Snapshot
with ProgressDisplay() as display:
    for name in sys.argv[1:]:
        display.add(name, 1_500_000, 0)
    time.sleep(0.2)
    for steps in (400_000, 800_000, 1_499_999):
        for name in sys.argv[1:]:
            display.move(name, steps - 10_000)
            display.update(name, Snapshot(steps, 0.93, 0.98, 41.0, 0.00123))
        time.sleep(0.2)
"""
STUDY = """
import time
from trainer.studies.display import StudyDisplay
from trainer.studies.executors import Update
from trainer.terminal import Terminal
with StudyDisplay(Terminal(), "case-studies", 60, 30, 1_500_000) as display:
    time.sleep(0.3)
    display.update(Update(2, 500_000, ()))
    time.sleep(0.2)
"""
DOING = """
import time
from trainer.activity import doing
with doing("Playing the evaluation's 200 episodes", 200) as tell:
    tell(134)
    time.sleep(0.3)
print("done")
"""
WITHOUT_TORCH = """
import sys
from trainer.main import main
class NoTorch:
    def find_spec(name, *_):
        if name == "torch":
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, NoTorch)
sys.exit(main(sys.argv[1:]))
"""


class Screen:
    """As much of a terminal as shows lines that are written over each other.

    Args:
        columns: Its width.
    """

    def __init__(self, columns: int) -> None:
        self._columns, self._row, self._column = columns, 0, 0
        self.lines = [""]

    def write(self, text: str) -> None:
        """Takes what a program writes."""
        for code, up, character in re.findall(r"\x1b\[([0-9;?]*)([A-Za-z])|([^\x1b])", text):
            if up == "A":
                self._row -= int(code or 1)
            elif up == "K":
                self.lines[self._row] = ""
            elif character == "\r":
                self._column = 0
            elif character == "\n":
                self._down()
            elif character:
                self._put(character)

    def _put(self, character: str) -> None:
        if self._column == self._columns:
            self._column = 0
            self._down()
        line = self.lines[self._row].ljust(self._column)
        self.lines[self._row] = line[: self._column] + character + line[self._column + 1 :]
        self._column += 1

    def _down(self) -> None:
        self._row += 1
        if self._row == len(self.lines):
            self.lines.append("")


def seen(command: list[object], columns: int) -> list[list[str]]:
    """The screens that somebody sees while a command runs in a terminal, one for each time that it writes."""
    terminal, output = pty.openpty()
    fcntl.ioctl(output, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        [*map(str, command)], stdin=output, stdout=output, stderr=output, env={**environment, "TERM": "xterm"}
    )
    os.close(output)
    screen, screens = Screen(columns), []
    while True:
        try:
            data = os.read(terminal, 1 << 16)
        except OSError:  # the command has ended
            break
        if not data:
            break
        screen.write(data.decode(errors="replace"))
        screens.append([line.rstrip() for line in screen.lines if line.strip()])
    os.close(terminal)
    assert process.wait(60) == 0, screens[-1:]
    return screens


def program(text: str, *arguments: object) -> list[object]:
    return [sys.executable, "-c", text, *arguments]


@pytest.mark.parametrize("columns", [40, 80, 200])
@pytest.mark.parametrize("names", [["mine"], ["Fox", "a-very-long-name-of-a-behavior-of-somebody"]])
def test_training_has_one_line_for_each_behavior_with_what_matters_most(columns, names):
    screens = seen(program(LEARNING, *names), columns)
    assert max(map(len, screens)) == len(names)  # lines that are wrapped would be more
    for line in screens[-1]:
        assert " 99%" in line
        assert re.search(r"(?:left|0\.93|98%|41|0\.00123|steps|steps/s)$", line)  # what is there is whole
        assert "left" in line
        assert ("return +0.93" in line) == (columns >= 80 or (columns == 40 and len(names) == 1))
        assert ("steps/s" in line) == ("curiosity 0.00123" in line) == (columns == 200)
    if len(names) > 1:
        assert [line[:3] for line in screens[-1]] == ["Fox", "a-v"]
        assert len({line.index("99%") for line in screens[-1]}) == 1  # in columns
    assert any("  0%" in line for screen in screens for line in screen)


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_a_study_has_one_line_with_its_share_and_the_time_left(columns):
    screens = seen(program(STUDY), columns)
    assert max(sum("%" in line for line in screen) for screen in screens) == 1
    assert "runs of 1,500,000" in screens[-1][0]
    assert screens[-1][-2] == screens[-1][0] or columns == 40  # nothing is wrapped
    assert "  1%" in screens[-1][-1]
    assert "left" in screens[-1][-1]
    assert ("case-studies" in screens[-1][-1]) == (columns >= 80)


@pytest.mark.parametrize("columns", [40, 80])
def test_what_is_being_done_is_one_line_with_its_count_and_goes_at_the_end(columns):
    screens = seen(program(DOING), columns)
    assert max(map(len, screens)) == 1
    assert any("134 of 200" in line for screen in screens for line in screen)
    assert any("Pl" in line for screen in screens for line in screen)
    assert screens[-1] == ["done"]


def test_without_a_terminal_it_is_a_line():
    done = subprocess.run(program(DOING), capture_output=True, text=True, timeout=60)
    assert done.stdout == "Playing the evaluation's 200 episodes ...\ndone\n"


def test_a_command_says_what_it_does_before_it_loads_what_takes_long(tmp_path):
    command = program(WITHOUT_TORCH, "train", "--run-id", "r", "--results-dir", tmp_path)
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=60)
    assert done.stdout == "Loading PyTorch ...\n"
    assert "corridor needs torch" in done.stderr


@pytest.mark.slow
def test_a_run_is_never_silent_from_its_first_moment_to_the_commands_that_it_ends_with(tmp_path, free_port):
    options = ["--steps", 20_000, "--num-areas", 64, "--eval-episodes", 20, "--base-port", free_port]
    options += ["--env-param", "max_episode_steps=200"]
    begun = time.monotonic()
    screens = seen([BIN / "corridor", "train", "--run-id", "r", "--results-dir", tmp_path, *options], 80)
    assert len(screens) > 3 * (time.monotonic() - begun)  # a fan of three or more pictures a second
    last_lines = [screen[-1] for screen in screens if screen]
    for said in (
        "Loading PyTorch",
        "Starting the player",
        "first update",
        "return -",
        "Playing the eval",
        "Drawing the",
    ):
        assert any(said in line for line in last_lines), said
    assert "wall_contact_rate" in "\n".join(screens[-1])
    said = [" ".join(line.split()) for line in screens[-1]]
    at = said.index("What next?")
    pasted = "".join(screens[-1][at + 1 :])
    assert f"corridor replay {tmp_path}/r --open" in pasted
    assert f"corridor watch --open --results-dir {tmp_path}" in pasted
    assert f"corridor export {tmp_path}/r --onnx r.onnx" in pasted


def test_what_a_run_says_at_its_end_can_be_pasted(tmp_path, free_port, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(BIN), prepend=os.pathsep)
    short = ["--steps", 2000, "--num-areas", 8, "--eval-episodes", 2, "--env-param", "max_episode_steps=20"]
    done = corridor_here("train", "--run-id", "r", "--base-port", free_port, *short)
    assert done.returncode == 0, done.stderr
    commands = [line.partition(": ")[2].split() for line in done.stdout.partition("What next?\n")[2].splitlines()]
    assert commands == [
        ["corridor", "replay", "r", "--open"],
        ["corridor", "watch", "--open"],
        ["corridor", "export", "r", "--onnx", "r.onnx"],
    ]
    assert corridor_here(*commands[2][1:]).returncode == 0
