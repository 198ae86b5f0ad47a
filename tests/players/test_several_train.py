"""``corridor train`` with several players, launched or dialling in, some of which die."""

import csv
import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from conftest import BIN, WITH_ROWS, corridor_here
from prepared import Prepared

from trainer.main import main

TIMING = {"steps_per_second", "wall_seconds"}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [{name: text for name, text in row.items() if name not in TIMING} for row in csv.DictReader(file)]


def wait_for_a_row(run: Path) -> None:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not ((run / "progress.csv").exists() and rows(run / "progress.csv")):
        time.sleep(0.1)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_run_with_three_players(tmp_path, free_port, monkeypatch):
    monkeypatch.setattr("trainer.runs.callbacks.ROW_STEPS", 500)
    found = []
    for name in ("one", "two"):
        done = corridor_here(
            "train", "--run-id", name, "--results-dir", tmp_path, "--base-port", free_port, "--num-envs", 3,
            "--num-areas", 5, "--steps", 2_000, "--eval-episodes", 6,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append(
            (rows(tmp_path / name / "progress.csv"), json.loads((tmp_path / name / "summary.json").read_text()))
        )
    assert len(found[0][0]) >= 2
    assert found[0][0] == found[1][0]
    assert found[0][1]["evaluation"] == found[1][1]["evaluation"]


@pytest.mark.slow
def test_training_goes_on_when_a_player_is_killed(tmp_path, free_port):
    process = Prepared(
        [WITH_ROWS, "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port,
         "--num-envs", 2, "--num-areas", 4, "--steps", 4_000, "--eval-episodes", 4]
    )  # fmt: skip
    wait_for_a_row(tmp_path / "r")
    found = subprocess.run(["pgrep", "-f", f"mlagents-port {free_port + 1}"], capture_output=True, text=True).stdout
    os.kill(int(found), signal.SIGKILL)
    errors, _ = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert "It is started again (restart 1)." in errors
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert summary["restarts"] == 1
    assert summary["env_steps"] >= 4_000
    assert summary["evaluation"]["episodes"] == 4


def dial_in(port: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [str(BIN / "corridor-server"), "--mlagents-port", str(port), "-logFile", os.devnull],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.slow
def test_players_that_dial_in_from_elsewhere_and_one_that_dials_in_again(tmp_path, free_port):
    process = Prepared(
        [WITH_ROWS, "train", "--run-id", "r", "--results-dir", tmp_path, "--env", f"localhost:{free_port}",
         "--num-envs", 2, "--num-areas", 4, "--steps", 4_000, "--eval-episodes", 4]
    )  # fmt: skip
    away = [dial_in(free_port + number) for number in range(2)]
    wait_for_a_row(tmp_path / "r")
    away[1].kill()
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and "Waiting for it to dial in again (restart 1)." not in process.said():
        time.sleep(0.05)
    away.append(dial_in(free_port + 1))
    errors, _ = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["restarts"] == 1
    assert "Waiting for it to dial in again (restart 1)." in errors
    assert [each.wait(20) for each in away] == [0, -signal.SIGKILL, 0]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--num-envs", 0), "--num-envs is 0, but a whole number from 1 up was expected"),
        (("--num-envs", 2, "--env", "editor"), "the Unity editor is one player"),
        (("--num-envs", 2, "--preset", "paper"), "--num-envs is 2, but preset paper trains one area"),
        (("--num-envs", 2, "--base-port", 65535), "ports end at 65535"),
        (
            ("--num-envs", 2, "--env", "localhost:65535"),
            "2 players from port 65535 on need ports above 65535; begin lower.",
        ),
        (("--max-lifetime-restarts", -2), "--max-lifetime-restarts is -2, but a whole number from 0 up"),
        (("--restarts-rate-limit-period-s", 0), "--restarts-rate-limit-period-s is 0, but seconds above 0"),
        (("--time-scale", 0.5), "time_scale is 0.5, but a number from 1 to 1000 was expected"),
    ],
)
def test_options_out_of_their_range(tmp_path, options, says, capsys):
    given = ("--run-id", "r", "--results-dir", tmp_path, "--timeout-wait", 1, *options)
    assert main(["train", *map(str, given)]) == 1
    assert says in capsys.readouterr().err
