"""Runs on any behaviors that are killed, and players that say what can't be learned from."""

import os
import re
import signal
from pathlib import Path

import pytest
from conftest import BIN, corridor_here
from prepared_run import PreparedRun
from raw_player import write_player

from trainer.learning.ppo_learner import PPOLearner
from trainer.runs.checkpoint import checkpoints, read_checkpoint

SCENE = Path(__file__).parents[1] / "scenes" / "logged_agents.py"
SMALL = """
default_settings:
  max_steps: {steps}
  summary_freq: 500
  hyperparameters: {{batch_size: 32, buffer_size: 128}}
  network_settings: {{hidden_units: 16, num_layers: 1}}
"""
LISTED = SMALL + "behaviors:\n  {name}: {{}}\n"


@pytest.fixture(autouse=True)
def _python_on_the_path(monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")  # the scene runs on the first python3 found


def write(folder: Path, text: str, **values: object) -> Path:
    path = folder / "settings.yaml"
    path.write_text(text.format(**values))
    return path


def kill(run: PreparedRun, steps: int) -> None:
    """Starts a run and kills it, and its player, a moment after so many steps."""
    process = run.start()
    run.wait_for_steps(process, steps)
    process.send_signal(signal.SIGKILL)
    run.wait(process)
    for player in run.players():
        os.kill(player, signal.SIGKILL)


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_last_checkpoint(tmp_path, free_port, monkeypatch):
    settings = write(tmp_path, SMALL, steps=3000)
    options = (settings, "--env", SCENE, "--num-areas", 1, "--eval-episodes", 2)
    kill(PreparedRun(tmp_path, "r", free_port, *options), 1000)
    saved = read_checkpoint(tmp_path / "r" / "checkpoints").part("learner Walker")
    learned, restored, rewards = [], [], PPOLearner._rewards
    load = PPOLearner.load_state_dict

    def noting(learner, transitions):
        if learner.behavior.name.startswith("Walker"):
            learned.append(len(transitions))
        return rewards(learner, transitions)

    def loading(learner, state):
        load(learner, state)
        restored.append((learner.updates, learner.episodes, list(learner.recent["returns"])))

    monkeypatch.setattr(PPOLearner, "_rewards", noting)
    monkeypatch.setattr(PPOLearner, "load_state_dict", loading)
    given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--resume")
    done = corridor_here("train", *options, *given)
    assert done.returncode == 0, done.stderr
    steps, updates, episodes = saved["counts"]
    assert steps >= 512
    assert restored[0] == (updates, episodes, saved["recent/returns"].tolist())
    ended = read_checkpoint(tmp_path / "r" / "checkpoints").part("learner Walker")["counts"]
    assert ended[:2] == [steps + sum(learned), updates + len(learned)]
    assert ended[2] > episodes


@pytest.mark.slow
def test_a_killed_run_of_the_corridor_ends_as_one_that_was_not(tmp_path, free_port):
    settings = write(tmp_path, LISTED, steps=3000, name="Corridor")
    options = (settings, "--num-areas", 4, "--num-envs", 2, "--eval-episodes", 2)
    whole, cut = (PreparedRun(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    kill(cut, 1000)
    assert 1000 <= cut.steps() < 3000
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)
    mine, theirs = cut.summary(), whole.summary()
    for name in ("policy_sha256", "evaluation", "env_steps", "episodes"):
        assert mine[name] == theirs[name], name


DISCRETE = """
agents = message.unity_output.rl_output.agentInfos['Raw?team=0'].value
for brain in message.unity_output.rl_initialization_output.brain_parameters:
    brain.action_spec.num_continuous_actions, brain.action_spec.num_discrete_actions = 0, 1
    brain.action_spec.discrete_branch_sizes.append(3)
else:
    if not message.unity_output.rl_initialization_output.brain_parameters:
        agents[-1].action_mask.extend([True] * 3)
"""
AGENT = "agent = message.unity_output.rl_output.agentInfos['Raw?team=0'].value[-1]\n"
LATER = 150
SHAPE = r"agent 1 of behavior Raw\?team=0 with observation of shape \(4,\), but \(3,\) was expected"


@pytest.mark.parametrize(
    ("spoil", "spoiled", "says"),
    [
        (DISCRETE, (0, LATER), r"Agent 1 of Raw\?team=0 masks all 3 choices of discrete branch 0, but one that"),
        (
            AGENT + "agent.observations[0].shape[0] = 4\nagent.observations[0].float_data.data.append(0)",
            (LATER,),
            SHAPE,
        ),
        (AGENT + "agent.reward = float('nan')", (LATER,), "reward = nan of agent 1, but finite numbers were expected"),
    ],
    ids=["mask", "shape", "nan"],
)
def test_what_cant_be_learned_from_is_one_sentence_and_costs_no_checkpoint(tmp_path, free_port, spoil, spoiled, says):
    player, _ = write_player(tmp_path, agents=2, spoil=spoil, spoiled=spoiled)
    settings = write(tmp_path, SMALL, steps=3000)
    given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--env", player)
    done = corridor_here("train", settings, *given)
    assert done.returncode == 1
    (message,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert re.search(says, message), message
    saved = checkpoints(tmp_path / "r" / "checkpoints")
    assert saved, "what was learned until then is there"
    assert read_checkpoint(tmp_path / "r" / "checkpoints").part("learner Raw")["counts"][0] >= 128


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("behaviors: {{Cooked: {{}}}}", "has the behavior 'Raw', which is not among the behaviors .*; list it there"),
        (LISTED, "behaviors has 'Cooked', which the environment doesn't have .*; rename it, or take it out"),
    ],
)
def test_behaviors_of_the_file_and_of_the_build_that_differ_are_refused_before_anything_is_written(
    tmp_path, free_port, text, says
):
    player, _ = write_player(tmp_path, agents=2)
    settings = write(tmp_path, text, steps=500, name="Cooked")
    given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--env", player)
    done = corridor_here("train", settings, *given)
    assert done.returncode == 1
    assert re.search(says, done.stderr.replace("\n", " ")), done.stderr
    assert not (tmp_path / "r").exists()
