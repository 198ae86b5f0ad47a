"""docker/players.py: a player is started again as long as a trainer listens, whatever its exit code was."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

PLAYERS = Path(__file__).parents[2] / "docker" / "players.py"


class Players:
    """``docker/players.py`` with a player that notes its start and ends with a code at once."""

    def __init__(self, folder: Path, port: int, code: int) -> None:
        self._starts = folder / "starts"
        player = ["sh", "-c", f"echo started >> {self._starts}; exit {code}"]
        environment = {**os.environ, "BASE_PORT": str(port), "NUM_ENVS": "1", "TRAINER_PATIENCE": "1"}
        self.process = subprocess.Popen([sys.executable, str(PLAYERS), *player], env=environment)

    def starts(self) -> int:
        return len(self._starts.read_text().splitlines()) if self._starts.exists() else 0


def reaches(condition: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + 20
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return condition()


@pytest.mark.parametrize("code", [0, 1])
def test_a_player_is_started_again_while_a_trainer_listens_and_its_last_code_is_the_verdict(tmp_path, free_port, code):
    with socket.create_server(("127.0.0.1", free_port)):
        players = Players(tmp_path, free_port, code)
        assert reaches(lambda: players.starts() >= 2)
    assert players.process.wait(30) == code


def test_a_trainer_that_never_comes_is_a_failure(tmp_path, free_port):
    players = Players(tmp_path, free_port, 0)
    assert players.process.wait(30) == 1
    assert players.starts() == 0
