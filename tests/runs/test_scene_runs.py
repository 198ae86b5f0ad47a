"""Runs of any behavior that end early, go on, change their lessons, or have episodes without an end."""

import csv
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from asked import asked
from raw_player import write_player
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from corridor_server.protocol.agents import Agents, Behavior, Sensor
from trainer.curriculum import Curricula
from trainer.errors import TrainerError
from trainer.main import main
from trainer.players.scene import Message
from trainer.runs import scene_training
from trainer.runs.behavior_learners import BehaviorLearners
from trainer.runs.checkpoint import read_checkpoint
from trainer.runs.counters import Counters
from trainer.runs.folder import RunFolder
from trainer.runs.scene_evaluation import evaluate_scene, summarise_scene
from trainer.runs.scene_training import SceneTraining

WALKER = Behavior("Walker?team=0", (Sensor.of("seen", (2,)),), 1)
SETTINGS = {
    "max_steps": 80,
    "summary_freq": 20,
    "hyperparameters": {"batch_size": 4, "buffer_size": 8},
    "network_settings": {"hidden_units": 4},
}


class Walkers:
    """As much of a ``Scene`` as a run needs: two agents in one player, with episodes of a length; 0 is for ever."""

    exchange_seconds, restarts = 0.0, 0
    took_up_its_state = True

    def __init__(self, length: int = 3, says_its_state: bool = False, dies_after: int = 10**9) -> None:
        self.behaviors = {WALKER.name: WALKER}
        self.says_its_state = says_its_state
        self._length, self._dies_after, self._step, self._received = length, dies_after, 0, 0

    def __len__(self) -> int:
        return 1

    def reset(self) -> list[Message]:
        self._step = 0
        return [Message({}, {WALKER.name: self._asking()}, anew=True)]

    def send(self, actions) -> None:
        assert actions[0][WALKER.name].continuous.shape == (2, 1)

    def receive(self) -> list[Message]:
        self._step, self._received = self._step + 1, self._received + 1
        if self._received > self._dies_after:
            raise TrainerError("The player is gone.")
        ended = {}
        if self._length and self._step % self._length == 0:
            last = (np.ones((2, 2), np.float32),)
            ended[WALKER.name] = Agents.that_ended([0, 1], last, [1.0, 2.0], [False, False])
        return [Message(ended, {WALKER.name: self._asking()})]

    def _asking(self) -> Agents:
        return Agents.that_ask([0, 1], (np.full((2, 2), self._step, np.float32),), [0.0, 0.0])

    def ask_states(self) -> None:
        pass

    def set_parameters(self, values) -> None:
        pass

    def statistics(self) -> dict[str, list[float]]:
        return {}

    def state_dict(self) -> dict[str, list[int]]:
        return {"lives": [0]}


class Sightless(Walkers):
    """Agents that see the same at any time."""

    def _asking(self) -> Agents:
        return Agents.that_ask([0, 1], (np.zeros((2, 2), np.float32),), [0.0, 0.0])


@pytest.fixture
def config(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text(yaml.safe_dump({"default_settings": SETTINGS}))
    return asked("r", file, env="Other.x86_64").run_config()


def train(config, folder: Path, scene: Walkers, resume: bool = False) -> SceneTraining:
    checkpoint = read_checkpoint(folder / "checkpoints") if resume else None
    counters = Counters(**checkpoint.facts["counters"]) if checkpoint else Counters()
    training = SceneTraining(config, RunFolder(folder), scene, counters, Curricula({}), checkpoint)
    training.train(lambda agents: folder.mkdir(exist_ok=True))
    return training


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "progress.csv").open(newline="") as file:
        return [{name: row[name] for name in ("env_steps", "mean_return")} for row in csv.DictReader(file)]


@pytest.mark.parametrize("says_its_state", [False, True])
def test_what_a_finished_run_has_learned_is_saved_however_long_its_checkpoints_take(
    config, tmp_path, monkeypatch, says_its_state
):
    monkeypatch.setattr(scene_training, "SAVING_SHARE", 1e-9)
    training = train(config, tmp_path / "r", Walkers(says_its_state=says_its_state))
    saved = read_checkpoint(tmp_path / "r" / "checkpoints").part("learner Walker")
    ((_, learner),) = training.learners
    assert learner.steps == 80
    for name, value in learner.weights().items():
        np.testing.assert_array_equal(saved[f"policy/{name}"], value)


def test_a_cut_run_whose_player_says_its_state_counts_only_what_a_resumed_one_goes_on_from(
    config, tmp_path, monkeypatch
):
    monkeypatch.setattr(scene_training, "SAVING_SHARE", 1e-9)
    counters = Counters()
    scene = Walkers(says_its_state=True, dies_after=12)
    training = SceneTraining(config, RunFolder(tmp_path / "r"), scene, counters, Curricula({}))
    with pytest.raises(TrainerError, match="is gone"):
        training.train(lambda agents: None)
    assert counters.env_steps == read_checkpoint(tmp_path / "r" / "checkpoints").facts["env_steps"] == 8


def test_updates_beside_the_next_steps_have_a_row_each_and_the_last_two_one(config, tmp_path):
    beside = replace(config, default_settings={**SETTINGS, "threaded": True, "summary_freq": 1})
    training = train(beside, tmp_path / "r", Walkers())
    ((_, learner),) = training.learners
    assert learner.updates == 10
    assert [row["env_steps"] for row in rows(tmp_path / "r")] == [str(8 * number) for number in range(2, 11)]


@pytest.mark.parametrize("cut_after", [9, 10, 13])
def test_a_run_that_was_cut_has_the_rows_of_one_that_was_not(config, tmp_path, cut_after):
    """Cut between a row's time, 20 steps, and the update that writes it, or within the update before, or after it."""
    train(config, tmp_path / "whole", Walkers())
    with pytest.raises(TrainerError, match="is gone"):
        train(config, tmp_path / "cut", Walkers(dies_after=cut_after))
    train(config, tmp_path / "cut", Walkers(), resume=True)
    steps = [[row["env_steps"] for row in rows(tmp_path / name)] for name in ("whole", "cut")]
    assert steps[0] == ["24", "40", "64", "80"]
    assert len(steps[1]) == len(set(steps[1])) == 4
    assert steps[1][-1] == "80"


def test_episodes_do_not_go_on_where_the_player_has_not_said_so_though_it_shows_the_same_again(
    config, tmp_path, capsys
):
    with pytest.raises(TrainerError, match="is gone"):
        train(config, tmp_path / "r", Sightless(dies_after=13))
    train(config, tmp_path / "r", Sightless(), resume=True)
    assert "new episodes begin" in capsys.readouterr().out


def test_episodes_do_not_go_on_where_the_player_has_refused_its_state_though_it_shows_the_same_again(
    config, tmp_path, capsys
):
    class Refusing(Sightless):
        took_up_its_state = True

        def state_dict(self):
            return {"lives": [0], "state_0": np.zeros(1, np.uint8)}

    for name, takes_up in (("taken", True), ("refused", False)):
        with pytest.raises(TrainerError, match="is gone"):
            train(config, tmp_path / name, Refusing(says_its_state=True, dies_after=13))
        again = Refusing(says_its_state=True)
        again.took_up_its_state = takes_up
        capsys.readouterr()
        train(config, tmp_path / name, again, resume=True)
        assert ("new episodes begin" in capsys.readouterr().out) != takes_up


def test_returns_that_no_lesson_has_counted_yet_are_saved(config):
    learners, again = (BehaviorLearners(config, Walkers()) for _ in range(2))
    scene = Walkers(length=1)
    learners.take(scene.reset())
    learners.act()
    learners.take(scene.receive())
    again.take(scene.reset())
    ((_, former),), ((_, later),) = learners, again
    assert former.ended_returns == [1.0, 2.0]
    later.load_state_dict(former.state_dict())
    assert later.ended_returns == [1.0, 2.0]


def test_a_lesson_of_progress_ends_though_no_episode_does(config, tmp_path):
    criteria = {"behavior": "Walker", "measure": "progress", "threshold": 0.5}
    height = [{"name": "low", "value": 1, "completion_criteria": criteria}, {"name": "high", "value": 2}]
    curricula = Curricula({"height": {"curriculum": height}})
    training = SceneTraining(config, RunFolder(tmp_path / "r"), Walkers(length=0), Counters(), curricula, None)
    training.train(lambda agents: None)
    assert curricula.numbers == {"height": 1}


def test_a_smoothed_reward_comes_nearer_at_every_step_as_in_mlagents(config, tmp_path):
    """The mean return is 1.5 from the second step on, and 1.5 (1 - 0.25^n) is above 1.499 from n = 6 on."""
    criteria = {"behavior": "Walker", "threshold": 1.499, "min_lesson_length": 2}
    height = [{"name": "low", "value": 1, "completion_criteria": criteria}, {"name": "high", "value": 2}]
    curricula = Curricula({"height": {"curriculum": height}})
    scene = Walkers(length=2)
    reached = []
    scene.set_parameters = lambda values: reached.append(scene._step)
    SceneTraining(config, RunFolder(tmp_path / "r"), scene, Counters(), curricula, None).train(lambda agents: None)
    assert reached == [7]


def test_rewards_are_logged_by_their_signals_times_their_strengths(config, tmp_path):
    for signals, tags in (
        ({"extrinsic": {"strength": 0.5}, "rnd": {}}, {"Policy/Extrinsic Reward", "Policy/Rnd Reward"}),
        ({"extrinsic": {"strength": 0.5}, "curiosity": {}}, {"Policy/Extrinsic Reward", "Policy/Curiosity Reward"}),
        ({"extrinsic": {"strength": 0.5}}, {"Policy/Extrinsic Reward"}),
    ):
        folder = tmp_path / "-".join(signals)
        train(replace(config, default_settings={**SETTINGS, "reward_signals": signals}), folder, Walkers())
        events = EventAccumulator(str(folder / "tensorboard"))
        events.Reload()
        found = set(events.Tags()["scalars"])
        assert {each for each in found if each.startswith("Policy/") and each.endswith(" Reward")} == tags
        assert not {each for each in found if "Lesson Number" in each}, "those of the preset's corridor were not told"
        last = [events.Scalars(tag)[-1].value for tag in ("Policy/Extrinsic Reward", "rollout/ep_rew_mean")]
        assert last[0] == pytest.approx(0.5 * last[1])
        column = [row["curiosity_return"] for row in csv.DictReader((folder / "progress.csv").open())][-1]
        assert bool(column) == (len(signals) > 1)


def test_another_runs_policy_begins_one_of_other_reward_signals_but_for_the_value_heads(config, tmp_path, capsys):
    run = tmp_path / "former"
    train(config, run, Walkers())
    given = {**SETTINGS, "init_path": str(run)}
    both = {**given, "reward_signals": {"extrinsic": {}, "curiosity": {}}}
    train(replace(config, default_settings={**SETTINGS, "reward_signals": {"rnd": {}}}), tmp_path / "rnd", Walkers())
    heads = {"value_net.weight", "value_net.bias"}
    other = {**given, "init_path": str(tmp_path / "rnd"), "reward_signals": {"curiosity": {}}}
    for settings, anew in ((given, set()), (both, heads), (other, heads)):
        saved = read_checkpoint(Path(settings["init_path"]) / "checkpoints").part("learner Walker")
        learners, scene = BehaviorLearners(replace(config, default_settings=settings), Walkers()), Walkers()
        learners.take(scene.reset())
        ((_, learner),) = learners
        weights = learner.weights()
        same = {name for name, value in weights.items() if np.array_equal(saved[f"policy/{name}"], value)}
        assert set(weights) - same == anew
        assert ("The value heads of Walker begin anew" in capsys.readouterr().out) == bool(anew)
    wide = {**given, "network_settings": {"hidden_units": 5}}
    with pytest.raises(TrainerError, match=r"other settings: .* is \(4, 2\) there and \(5, 2\) here; give it the netw"):
        BehaviorLearners(replace(config, default_settings=wide), Walkers()).take(Walkers().reset())


def test_a_linear_schedule_is_at_its_end_in_the_last_update(config, tmp_path):
    train(config, tmp_path / "r", Walkers())
    events = EventAccumulator(str(tmp_path / "r" / "tensorboard"))
    events.Reload()
    rates = [each.value for each in events.Scalars("Policy/Learning Rate")]
    assert rates == pytest.approx([3e-4 * (1 - steps / 80) for steps in (24, 40, 64, 80)], abs=1e-9)


def test_an_evaluation_ends_though_episodes_do_not(config):
    scene = Walkers(length=0)
    played = evaluate_scene(BehaviorLearners(config, scene), scene, 5, most_length=30)
    values = summarise_scene(played)["Walker"]
    assert (values["episodes"], values["unfinished"], values["mean_episode_length"]) == (2, 2, 30)


CURRICULUM = {
    "curriculum": [
        {
            "name": "light",
            "value": 1.0,
            "completion_criteria": {"behavior": "Raw", "measure": "progress", "threshold": 0.2},
        },
        {"name": "heavy", "value": 9.0},
    ]
}


def test_every_player_that_is_started_begins_in_the_present_lesson(tmp_path, free_port):
    player, log = write_player(tmp_path)
    file = tmp_path / "lessons.yaml"

    def train_for(steps: int, *more: str) -> None:
        settings = {**SETTINGS, "max_steps": steps}
        file.write_text(
            yaml.safe_dump({"default_settings": settings, "environment_parameters": {"gravity": CURRICULUM}})
        )
        given = ["--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--eval-episodes", 2]
        assert main(["train", str(file), *map(str, given), "--env", str(player), *more]) == 0

    def first_told() -> list[float]:
        """By each player in turn, at its first reset."""
        told = [what for kind, what in map(json.loads, log.read_text().splitlines()) if kind in ("arguments", "reset")]
        return [after["gravity"] for before, after in itertools.pairwise(told) if isinstance(before, list)]

    train_for(80)
    assert first_told() == [1.0, 9.0], "training, evaluation"
    train_for(120, "--resume")
    assert first_told()[2:] == [9.0, 9.0], "training that goes on, evaluation"
    assert main(["evaluate", str(tmp_path / "r"), "--episodes", "2", "--base-port", str(free_port)]) == 0
    assert first_told()[4:] == [9.0]


@pytest.mark.parametrize(("numbers", "branches"), [(0, (2,)), (1, ()), (1, (3,)), (0, ())])
def test_a_learner_of_any_actions_goes_on_from_its_checkpoint(config, numbers, branches):
    behavior = Behavior("Any?team=0", (Sensor.of("seen", (2,)),), numbers, branches)
    scene = Walkers()
    scene.behaviors = {WALKER.name: behavior}
    learners, again = (BehaviorLearners(config, scene) for _ in range(2))
    learners.take(scene.reset())
    while not learners.learn():
        learners.act()
        learners.take(scene.receive())
    again.take(scene.reset())
    ((_, former),), ((_, later),) = learners, again
    later.load_state_dict(former.state_dict())
    assert later.learned == former.learned == 8
    for name, value in later.state_dict().items():
        np.testing.assert_array_equal(value, former.state_dict()[name])
