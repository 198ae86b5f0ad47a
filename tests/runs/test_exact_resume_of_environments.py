"""A run on environments of others that was killed and resumed is as one that was not, bit for bit."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from conftest import BIN

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import stop_with
from prepared_run import PreparedRun

NEW_EPISODES = "new episodes begin"
SETTINGS = {
    "max_steps": 1600,
    "summary_freq": 400,
    "time_horizon": 16,
    "hyperparameters": {"batch_size": 32, "buffer_size": 128, "num_epoch": 2},
    "network_settings": {"hidden_units": 16, "num_layers": 1},
}
TAG = {"adversary": {**SETTINGS, "max_steps": 2400, "threaded": True}, "agent": {**SETTINGS, "max_steps": 800}}
GRAVITY = {
    "gravity": {
        "curriculum": [
            {
                "name": "heavy",
                "value": {
                    "sampler_type": "uniform",
                    "sampler_parameters": {"min_value": 9.0, "max_value": 11.0},
                },
                "completion_criteria": {
                    "behavior": "CartPole-v1",
                    "measure": "progress",
                    "threshold": 0.7,
                    "require_reset": True,
                },
            },
            {"name": "light", "value": 5.0},
        ]
    }
}
RESTORED = {
    "masks": (["--gym", "Taxi-v4"], {"behaviors": {"Taxi-v4": SETTINGS}}),
    "pictures": (["--gym", "minatar.gym:MinAtar/Breakout-v1"], {"default_settings": SETTINGS}),
    "two behaviors, updates of one beside the next steps": (
        ["--pettingzoo", "mpe2.simple_tag_v3", "--team", "agent=1"],
        {"behaviors": TAG},
    ),
    "turns": (["--pettingzoo", "pettingzoo.classic.tictactoe_v3"], {"default_settings": SETTINGS}),
    "a curriculum in mid-lesson": (
        ["--gym", "CartPole-v1", "--parameters", "gravity"],
        {"behaviors": {"CartPole-v1": SETTINGS}, "environment_parameters": GRAVITY},
    ),
}
# Whose random numbers are nobody's that can be seen.
DRAWING = """
import gymnasium
import numpy as np

draw = np.random.default_rng().random


class Drawing(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(0, 1, (2,))
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        self.step_number = 0
        return draw(2, np.float32), {}

    def step(self, action):
        self.step_number += 1
        return draw(2, np.float32), float(action), self.step_number == 20, False, {}


gymnasium.register("Drawing-v0", Drawing)
"""


def write(folder: Path, port: int, served: list[str], settings: dict) -> Callable[[str], PreparedRun]:
    """Makes runs of a name."""
    file = folder / "settings.yaml"
    file.write_text(yaml.safe_dump(settings))
    player = folder / "player"
    player.write_text(
        f'#!/bin/sh\nPYTHONPATH="{folder}:$PYTHONPATH" exec {BIN / "corridor-server"} {" ".join(served)} "$@"\n'
    )
    player.chmod(0o755)
    options = (file, "--num-areas", 4, "--eval-episodes", 2, "--env", player)
    return lambda name: PreparedRun(folder, name, port, *options)


def kill(run: PreparedRun, steps: int) -> None:
    assert stop_with(run, signal.SIGKILL, steps, 0.01) == -signal.SIGKILL
    run.leaves_nothing_behind()
    assert steps <= run.steps() < 1600


@pytest.mark.slow
@pytest.mark.parametrize("what", RESTORED)
def test_it_ends_as_the_one_that_was_not_killed(what, tmp_path, free_port):
    run_of = write(tmp_path, free_port, *RESTORED[what])
    whole, cut = run_of("whole"), run_of("cut")
    assert whole.finish() == 0, whole.output
    kill(cut, 600)
    assert cut.finish("--resume") == 0, cut.output
    assert NEW_EPISODES not in cut.output
    mine, theirs = cut.summary(), whole.summary()
    assert mine["resumes"] == 1
    assert mine["behaviors"] == theirs["behaviors"], "policy_sha256, evaluation, steps and episodes of each"


@pytest.mark.slow
def test_where_episodes_cant_be_played_again_it_says_so_and_begins_new_ones(tmp_path, free_port):
    (tmp_path / "drawing.py").write_text(DRAWING)
    cut = write(tmp_path, free_port, ["--gym", "drawing:Drawing-v0"], {"default_settings": SETTINGS})("cut")
    kill(cut, 600)
    assert cut.finish("--resume") == 0, cut.output
    assert NEW_EPISODES in cut.output
    said = (cut.folder / "run_logs" / "Player-0.log").read_text()
    assert "(played once more, its episodes are others): new episodes begin." in said
    assert cut.summary()["env_steps"] == 1600
