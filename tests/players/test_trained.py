"""What a run trains on: the wrappers' agents, less what its policies have no use for, which is refused."""

from pathlib import Path

import numpy as np
import pytest
from conftest import BIN
from mlagents_envs.base_env import ActionSpec
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from scripted import Scripted, spec

from trainer.errors import TrainerError
from trainer.main import main
from trainer.players.gym_wrapper import UnityToGymWrapper
from trainer.players.trained import EpisodeStatistics, TrainedSlots

BUILD = Path(__file__).parents[1] / "unity" / "Build.x86_64"
DISCRETE = ActionSpec.create_discrete((3,))
ONE: tuple[dict[int, float], dict[int, tuple[float, bool]]] = ({1: 0.0}, {})
SAYS = "Agent 1 masks choice 2 of discrete branch 0"


def masks_from(first: int, *messages: object) -> Scripted:
    """An agent that masks its last choice from a message on."""
    return Scripted(
        spec([(2,)], DISCRETE), [ONE, *messages], forbids=lambda _, message: [[False, False, message >= first]]
    )


def test_a_masked_choice_ends_training_where_it_first_shows():
    with pytest.raises(TrainerError, match=SAYS):
        TrainedSlots(masks_from(0))
    slots = TrainedSlots(masks_from(2, ONE, ONE))
    slots.reset()
    slots.step([0])
    with pytest.raises(TrainerError, match=SAYS):
        slots.step([0])
    slots = TrainedSlots(masks_from(1, ONE))
    slots.reset()
    with pytest.raises(TrainerError, match=SAYS):
        slots.reset()


def test_so_it_does_through_the_gym_wrapper():
    env = EpisodeStatistics(UnityToGymWrapper(masks_from(0)), StatsSideChannel())
    with pytest.raises(TrainerError, match=SAYS):
        env.reset()
    env = EpisodeStatistics(UnityToGymWrapper(masks_from(1, ONE)), StatsSideChannel())
    env.reset()
    with pytest.raises(TrainerError, match=SAYS):
        env.step(0)


@pytest.mark.parametrize("wrap", [UnityToGymWrapper, TrainedSlots])
def test_a_groups_reward_reaches_learning_once(wrap):
    environment = Scripted(spec([(2,)], DISCRETE), [ONE, ({1: 0.5}, {}), ({1: 0.0}, {1: (-1.0, False)})])
    environment.group_reward = 0.25
    env = wrap(environment)
    if wrap is UnityToGymWrapper:
        env = EpisodeStatistics(env, StatsSideChannel())
    env.reset()
    action = [0] if wrap is TrainedSlots else 0
    assert [float(np.sum(env.step(action)[1])) for _ in range(2)] == [0.75, -0.75]


@pytest.mark.parametrize(
    ("shapes", "actions", "says"),
    [
        ([(4, 4, 3)], DISCRETE, r"takes vector observations, not shapes \[\(4, 4, 3\)\]"),
        ([(2,), (5, 3)], DISCRETE, r"takes vector observations, not shapes \[\(2,\), \(5, 3\)\]"),
        (
            [(2,)],
            ActionSpec(1, (3,)),
            "1 continuous actions and 1 discrete branches, but Stable-Baselines3's policies take",
        ),
    ],
)
def test_other_observations_and_both_kinds_of_actions_are_refused(shapes, actions, says):
    with pytest.raises(TrainerError, match=says):
        TrainedSlots(Scripted(spec(shapes, actions), [ONE]))


def test_the_papers_preset_refuses_both_kinds_of_actions_too(tmp_path, free_port, capsys, monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")
    monkeypatch.setenv("COLUMNS", "300")
    one = 'name = "One"\ncontinuous = 2\ndiscrete = [3]\nagents = [{}]\n'
    (tmp_path / "hybrid.toml").write_text(f"[[behaviors]]\n{one}")
    scene = ("--env", BUILD, "--env-args", "--spec", tmp_path / "hybrid.toml")
    given = ("--run-id", "r", "--preset", "paper", "--results-dir", tmp_path, "--base-port", free_port, *scene)
    assert main(["train", *map(str, given)]) == 1
    assert (
        "2 continuous actions and 1 discrete branches, but Stable-Baselines3's policies take" in capsys.readouterr().err
    )
