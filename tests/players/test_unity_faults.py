"""What Unity's own runtime does and this trainer once tripped over, on the stand-in for it (``tests/unity``)."""

import csv
import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import BIN
from mlagents_envs.exception import UnityCommunicatorStoppedException
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel

from trainer.main import main
from trainer.players.gym_wrapper import UnityGymException, UnityToGymWrapper
from trainer.players.opening import open_environment
from trainer.players.vec_env import UnityVecEnv

BUILD = Path(__file__).parents[1] / "unity" / "Build.x86_64"
# Two agents in step, and one that is disabled again and again before it ever decides.
NEVER_DECIDES = """
[[behaviors]]
name = "Hasty"
continuous = 1
agents = [
  { period = 5, max_step = 60 },
  { period = 5, max_step = 60 },
  { period = 100000, offset = 99999, lives = 3, away = 5 },
]
"""


@pytest.fixture(autouse=True)
def _python_on_the_path(monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")
    monkeypatch.setenv("COLUMNS", "200")


@pytest.fixture
def opened(free_port) -> Callable[..., Any]:
    def open_one(spec: object, areas: int = 1, **options: Any) -> Any:
        given = {"timeout_wait": 60, "env_args": ["--spec", str(spec)], **options}
        return open_environment(str(BUILD), seed=0, num_areas=areas, port=free_port, **given)

    return open_one


@pytest.fixture
def train(tmp_path, free_port, capsys) -> Callable[..., str]:
    """Trains the run ``r`` on a scene; what was printed."""

    def train(spec: str, *arguments: object) -> str:
        given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--env", BUILD)
        typed = [*map(str, (*given, *arguments)), "--env-args", "--spec", spec]
        assert main(["train", *typed]) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    return train


def play(env: UnityVecEnv, steps: int) -> int:
    """How many episodes ended."""
    env.action_space.seed(0)
    return sum(
        int(env.step(np.array([env.action_space.sample() for _ in range(env.num_envs)]))[2].sum()) for _ in range(steps)
    )


def step_to_the_end(environment: Any) -> None:
    while True:
        environment.step()


def test_resets_in_the_middle_of_episodes_are_played_on_from(opened):
    env = UnityVecEnv(opened("corridor_like", 4))
    for _ in range(5):
        assert env.reset().shape == (4, 13)
        play(env, 7)
    env.close()


def test_agents_that_never_decide_are_dropped(opened, tmp_path):
    (tmp_path / "scene.toml").write_text(NEVER_DECIDES)
    env = UnityVecEnv(opened(tmp_path / "scene.toml"), StatsSideChannel())
    env.reset()
    assert env.num_envs == 2
    assert play(env, 60) > 0
    env.close()


def test_agents_that_take_turns_are_no_gymnasium_environment(opened):
    env = UnityToGymWrapper(opened("single_turns"))
    env.reset()
    with pytest.raises(UnityGymException, match="several agents that take turns"):
        env.step(env.action_space.sample())
    env.close()


def test_pictures_with_their_channels_first_come_with_their_channels_last(opened):
    env = UnityToGymWrapper(opened("pictures"), allow_multiple_obs=True)
    observation, _ = env.reset()
    assert [part.shape for part in observation] == [(6, 10, 1), (6, 10, 3), (6, 10, 5), (6, 10, 2), (2,)]
    assert [(part[0] != part[-1]).any() for part in observation[:4]] == [True] * 4, "rows differ in their brightness"
    for _ in range(60):
        assert env.observation_space.contains(observation)
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            observation, _ = env.reset()
    env.close()


@pytest.mark.slow
def test_a_build_that_announced_its_end_ends_by_itself(opened, caplog):
    environment = opened("announces_its_end")
    process = environment._process
    environment.reset()
    with pytest.raises(UnityCommunicatorStoppedException):
        step_to_the_end(environment)
    with caplog.at_level(logging.WARNING):
        environment.kill()
    assert process.returncode == 0
    assert "timed out shutting down" not in caplog.text


def test_a_scene_without_a_replicator_trains_with_the_agent_that_it_has(train, tmp_path):
    said = train("no_replicator", "--num-areas", 64, "--steps", 100, "--eval-episodes", 1)
    assert "Areas asked for: 64 per player (--num-areas); agents that came, and are trained with: 1" in said
    record = yaml.safe_load((tmp_path / "r" / "configuration.yaml").read_text())
    assert (record["run"]["num_areas"], record["agents_per_player"]) == (64, 1)


def test_a_step_limit_without_statistics_leaves_success_unknown(train, tmp_path):
    said = train("step_limit_without_statistics", "--num-areas", 8, "--steps", 4_000, "--eval-episodes", 8)
    assert "success 0%" not in said
    assert "success 100%" not in said
    with (tmp_path / "r" / "progress.csv").open(newline="") as file:
        assert {row["success_rate"] for row in csv.DictReader(file)} <= {""}
    evaluation = json.loads((tmp_path / "r" / "summary.json").read_text())["evaluation"]
    assert evaluation["success_unknown"] > 0
    assert evaluation["success_rate"] is None
