"""A build that shares no code with this package, swapped in through ``--env``, and what its author can get wrong."""

import json
import re
import subprocess
from pathlib import Path

import onnxruntime
import pytest
import yaml
from conftest import BIN, corridor_here

from trainer.conformance import Observations, checker

BUILD = Path(__file__).parents[1] / "unity" / "Build.x86_64"
CORRIDOR = """
[[behaviors]]
name = "Corridor"
world = "corridor"
continuous = 2
sensors = [{ size = 13 }]
agents = [{ period = 5 }]
"""


@pytest.fixture(autouse=True)
def _python_on_the_path(monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")  # the build runs on the first python3 found


def train(results: Path, port: int, *arguments: object, env: Path = BUILD) -> subprocess.CompletedProcess[str]:
    given = ("--run-id", "r", "--results-dir", results, "--base-port", port, "--env", env)
    return corridor_here("train", *given, *arguments)


@pytest.mark.slow
def test_corridor_check_takes_the_build_and_finds_nothing(monkeypatch):
    """That the build keeps all topics is test_conformance_of_unity's."""
    monkeypatch.setattr(checker, "TOPICS", [Observations])
    done = corridor_here("check", "--env", BUILD)
    assert done.returncode == 0, done.stdout
    assert "protocol: 4 pass, 0 fail" in done.stdout
    assert "contract: 19 pass, 0 fail" in done.stdout


def test_two_processes_of_it_train_with_parameters_and_engine_settings(tmp_path, free_port):
    (tmp_path / "settings.yaml").write_text("environment_parameters: {opponent_speed: 1.5, goal_x: 8}")
    options = ("--num-envs", 2, "--num-areas", 8, "--steps", 2_000, "--eval-episodes", 8, "--time-scale", 7)
    given = ("--config", tmp_path / "settings.yaml", "--env-param", "goal_x=8.5")
    done = train(tmp_path, free_port, *options, *given)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert summary["env_steps"] >= 2_000
    assert summary["restarts"] == 0
    assert summary["evaluation"]["success_rate"] is not None
    assert summary["evaluation"]["mean_return"] < 0
    seeds = set()
    for number in range(2):
        log = (tmp_path / "r" / "run_logs" / f"Player-{number}.log").read_text()
        for line in ("time scale 7", "parameter opponent_speed: 1.5", "parameter goal_x: 8.5", "8 areas asked for"):
            assert line in log
        lines = [json.loads(line) for line in log.splitlines() if line.startswith("{")]
        assert [each["id"] for each in lines[1:]] == list(range(8))
        seeds |= set(re.findall(r"^seed (\d+)", log, re.MULTILINE))
    assert len(seeds) == 2


def test_discrete_actions_and_two_sensors_train_and_export(tmp_path, free_port):
    own = ("--env-args", "--spec", "corridor_discrete")
    done = train(tmp_path, free_port, "--c", 0, "--num-areas", 8, "--steps", 1_000, "--eval-episodes", 1, *own)
    assert done.returncode == 0, done.stderr
    record = yaml.safe_load((tmp_path / "r" / "configuration.yaml").read_text())
    assert record["run"]["env_args"] == list(own[1:])
    assert record["behavior"]["discrete_branches"] == [3, 3]
    done = corridor_here("export", tmp_path / "r", "--onnx", tmp_path / "Drive.onnx")
    assert done.returncode == 0, done.stderr
    model = onnxruntime.InferenceSession(str(tmp_path / "Drive.onnx"))
    assert [(each.name, each.shape[1]) for each in model.get_inputs()] == [
        ("obs_0", 6), ("obs_1", 7), ("action_masks", 6),
    ]  # fmt: skip


@pytest.mark.parametrize("how", [(), ("--preset", "fast"), ("settings.yaml",)])
def test_a_penalty_that_the_build_is_not_told_of_is_refused(tmp_path, free_port, monkeypatch, how):
    monkeypatch.chdir(tmp_path)
    Path("settings.yaml").write_text("default_settings: {max_steps: 100}")
    Path("spec.toml").write_text(CORRIDOR if how == ("settings.yaml",) else CORRIDOR.replace('"Corridor"', '"Walker"'))
    done = train(tmp_path, free_port, *how, "--penalty", "0", "--env-args", "--spec", "spec.toml")
    assert done.returncode == 1
    assert "--penalty is 0, but only the corridor has one, and only in runs that train as a preset does" in done.stderr


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        (
            CORRIDOR + CORRIDOR.replace("Corridor", "Corridor1"),
            r"has 2 behaviors \(Corridor\?team=0, Corridor1\?team=0\), but one was expected; give all agents the same",
        ),
        (
            CORRIDOR.replace("continuous = 2", "discrete = [3]"),
            "1 discrete branches, but 2 continuous .*; set Continuous Actions to 2 and Discrete",
        ),
        (
            CORRIDOR.replace("13", "11"),
            r"observations of shapes \[\(11,\)\], .*; set the vector observation's Space Size",
        ),
        (
            CORRIDOR.replace("{ period = 5 }", "{ period = 5 }, { period = 5 }"),
            "has 2 agents, but preset paper trains one, .*; leave one agent in the scene, or take",
        ),
    ],
)
def test_a_scene_that_does_not_fit(tmp_path, free_port, scene, says):
    (tmp_path / "scene.toml").write_text(scene)
    done = train(tmp_path, free_port, "--preset", "paper", "--env-args", "--spec", tmp_path / "scene.toml")
    message = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1
    assert message.startswith("error: ")
    assert re.search(says, message), message


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("Corridor.exe", b"MZ", "is a build for Windows, but this machine runs Linux; choose Linux as the target"),
        ("Corridor.app", b"", "is a build for macOS, but this machine runs Linux"),
        ("Corridor.x86_64", b"\x7fELF of another processor", "does not run on this machine .*; build the player for"),
    ],
)
def test_a_build_for_another_platform(tmp_path, free_port, name, content, says):
    path = tmp_path / name
    path.write_bytes(content)
    path.chmod(0o755)
    done = train(tmp_path, free_port, env=path)
    message = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1
    assert message.startswith("error: ")
    assert re.search(says, message), message


def test_a_builds_folder_instead_of_its_executable(tmp_path, free_port):
    (tmp_path / "build").mkdir()
    done = train(tmp_path, free_port, env=tmp_path / "build")
    assert done.returncode == 1
    assert "is a folder; give the path of the executable in it." in done.stderr
