"""``corridor train`` on scenes of our own: everything that agents did is learned from, and nothing else."""

import json
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN, corridor_here

from trainer.learning.ppo_learner import PPOLearner
from trainer.runs.checkpoint import read_checkpoint

SCENES = Path(__file__).parents[1] / "scenes"
UNEVEN = """
default_settings:
  max_steps: 600
  time_horizon: 16
  hyperparameters: {batch_size: 32, buffer_size: 128}
  network_settings: {hidden_units: 16, num_layers: 1}
behaviors:
  Walker: {max_steps: 3000}
"""


@pytest.fixture(autouse=True)
def _python_on_the_path(monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")  # the scenes run on the first python3 found


def train(folder: Path, port: int, scene: str, settings: str, *arguments: object) -> dict:
    """Trains the run ``r``; its summary."""
    (folder / "settings.yaml").write_text(settings)
    given = ("--run-id", "r", "--results-dir", folder, "--base-port", port, "--env", SCENES / scene)
    done = corridor_here("train", folder / "settings.yaml", *given, *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "r" / "summary.json").read_text())


def lines(folder: Path, player: int, logs: str = "run_logs") -> list[dict]:
    """What a player has logged as JSON, message by message."""
    said = (folder / "r" / logs / f"Player-{player}.log").read_text().splitlines()
    return [json.loads(line[line.index("{") :]) for line in said if "{" in line]


@pytest.fixture
def learned(monkeypatch) -> dict[str, list]:
    """The transitions of every update from here on, by behavior."""
    found: dict[str, list] = {}
    rewards = PPOLearner._rewards

    def noting(learner, transitions):
        found.setdefault(learner.behavior.name.partition("?")[0], []).append(transitions)
        return rewards(learner, transitions)

    monkeypatch.setattr(PPOLearner, "_rewards", noting)
    return found


def told(transitions) -> list[tuple]:
    """Transitions as the scene writes them down."""
    columns = (
        transitions.observed[0][:, 0] * 2.0**14,
        np.clip(transitions.decided.continuous[:, 0], -1, 1),
        transitions.decided.discrete[:, 0],
        transitions.rewards,
        transitions.next_observed[0][:, 0] * 2.0**14,
        transitions.terminated,
    )
    return list(zip(*(column.tolist() for column in columns), strict=True))


@pytest.mark.slow
def test_agents_that_come_and_go_lose_no_step_and_no_reward(tmp_path, free_port, learned):
    players = ("--num-areas", 1, "--num-envs", 2)
    summary = train(tmp_path, free_port, "logged_agents.py", UNEVEN, *players, "--eval-episodes", 2)
    logs = [lines(tmp_path, player) for player in range(2)]
    checkpoint = read_checkpoint(tmp_path / "r" / "checkpoints")
    messages = [message for pair in zip(*logs, strict=False) for message in pair]
    assert sum(message["undecided"] for message in messages) > 30, "some ended before they had decided"
    for name, most in (("Walker", 3000), ("Late", 600)):
        taken = [row for update in learned[name] for row in told(update)]
        own = summary["behaviors"][name]
        assert len(taken) == own["env_steps"] >= most
        steps, returns = [], []
        for message in messages:  # of one player and then of the other one; its teams one after the other
            steps += [tuple(row[1:]) for row in message["steps"] if row[0].startswith(name)]
            returns += [row[1] for row in sorted(message["episodes"], key=itemgetter(0)) if row[0].startswith(name)]
            if len(steps) >= len(taken):
                break
        assert sorted(taken) == sorted(steps), "each once, with what the player got and gave"
        assert own["episodes"] == len(returns)
        recent = checkpoint.part(f"learner {name}")["recent/returns"].tolist()
        assert recent == returns[-100:]
        for update in learned[name]:
            rows = told(update)
            for row, previous in zip(rows, update.previous.tolist(), strict=True):
                assert previous < 0 or (rows[previous][4], rows[previous][5]) == (row[0], False)
    assert summary["env_steps"] == sum(len(update) for updates in learned.values() for update in updates)


CHOOSER = """
behaviors:
  Chooser:
    max_steps: 4000
    hyperparameters: {batch_size: 64, buffer_size: 512, learning_rate: 0.003}
"""


@pytest.mark.slow
def test_no_forbidden_choice_is_ever_taken(tmp_path, free_port):
    train(tmp_path, free_port, "forbidden_choices.py", CHOOSER, "--num-areas", 16, "--eval-episodes", 64)
    for folder, least in (("run_logs", 4000), ("run_logs/evaluation", 64 * 16)):
        (counts,) = lines(tmp_path, 0, folder)
        assert counts["decisions"] >= least
        assert counts["forbidden"] == 0


OPTIMA = """
default_settings:
  hyperparameters: {batch_size: 256, buffer_size: 2048, learning_rate: 0.002, beta: 0.001, num_epoch: 4}
  network_settings: {hidden_units: 64}
behaviors:
  Aim: {max_steps: 60000, hyperparameters: {learning_rate: 0.003}}
  Herd: {max_steps: 40000, hyperparameters: {learning_rate: 0.001}}
  Errand: {max_steps: 20000}
"""


@pytest.mark.slow
def test_hybrid_actions_buffers_and_goal_signals_come_close_to_their_optimum(tmp_path, free_port):
    summary = train(tmp_path, free_port, "known_optima.py", OPTIMA, "--num-areas", 64, "--eval-episodes", 500)
    reached = {name: each["evaluation"]["mean_return"] for name, each in summary["behaviors"].items()}
    assert len(reached) == 3
    assert min(reached.values()) > 0.95, reached
