"""SAC for a behavior: when it updates, what its critics are told, what is kept and refused; whole runs from YAML."""

import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from conftest import BIN, corridor_here
from stable_baselines3.common.utils import set_random_seed

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import stop_with
from prepared_run import PreparedRun

from corridor_server.protocol.agents import Agents, Behavior, Sensor
from trainer.behavior_settings import BehaviorSettings
from trainer.errors import TrainerError
from trainer.learning.algorithm_state import RandomStreams, weights_sha256
from trainer.learning.rewards import build_signals
from trainer.learning.sac_learner import SACLearner

NAME = "Agent?team=0"
BEHAVIOR = Behavior(NAME, (Sensor.of("vector", (2,)),), continuous_actions=1)
SMALL = {"batch_size": 4, "buffer_size": 64}


@pytest.fixture(autouse=True)
def seeds() -> None:
    torch.set_num_threads(1)
    set_random_seed(0)


def sac(behavior: Behavior = BEHAVIOR, hyper: dict[str, Any] | None = None, **settings: Any) -> SACLearner:
    given = BehaviorSettings.from_mapping(
        {
            "trainer_type": "sac",
            "hyperparameters": {**SMALL, **(hyper or {})},
            "network_settings": {"hidden_units": 8, "num_layers": 1, **settings.pop("network", {})},
            **settings,
        }
    )
    return SACLearner(behavior, given, build_signals(behavior, given, 0, torch.device("cpu")))


def asking(seen: list[float], reward: float = 0.0, behavior: Behavior = BEHAVIOR) -> Agents:
    count = len(seen)
    columns = tuple(
        np.broadcast_to(
            np.array(seen, np.float32).reshape(count, *([1] * len(sensor.shape))), (count, *sensor.shape)
        ).copy()
        for sensor in behavior.sensors
    )
    return Agents.that_ask(np.arange(count), columns, np.full(count, reward))


def go(learner: SACLearner, messages: int, agents: int = 2, first: int = 0) -> None:
    """So many messages of agents that see and get what their number says."""
    for number in range(first, first + messages):
        learner.take(0, NAME, None, asking([0.1 * number + agent for agent in range(agents)], float(number)))
        if learner.is_full:
            learner.learn()
        learner.act()


@pytest.mark.parametrize(
    ("hyper", "updates"),
    [
        ({}, [0, 0, 4, 6, 8]),  # those that were due before the buffer had a minibatch are made up for
        ({"steps_per_update": 4}, [0, 0, 1, 1, 2]),
        ({"steps_per_update": 0.5}, [0, 0, 8, 12, 16]),
        ({"buffer_init_steps": 6}, [0, 0, 0, 0, 2]),
    ],
)
def test_an_update_comes_every_steps_per_update_once_there_is_enough(hyper, updates):
    learner, found = sac(hyper=hyper), []
    for number in range(5):
        go(learner, 1, first=number)
        found.append(learner.updates)
    assert found == updates
    assert learner.steps == 8


def test_reward_signals_have_updates_of_their_own_number():
    learner = sac(hyper={"reward_signal_steps_per_update": 4}, reward_signals={"rnd": {}})
    made: list[int] = []
    module = learner._signals[0].module
    learn = module.learn
    module.learn = lambda *columns: made.append(len(columns[1])) or learn(*columns)
    go(learner, 5)
    assert (learner.updates, made) == (8, [4, 4])
    assert {"Losses/RND Loss", "rollout/intrinsic_reward"} <= learner.metrics.keys()


def test_it_is_done_after_its_steps_and_then_only_acts():
    learner = sac(max_steps=5)
    go(learner, 4)
    assert (learner.is_done, learner.steps, learner.progress) == (True, 6, 1.0)
    before = weights_sha256(learner.weights())
    go(learner, 4)
    assert (learner.steps, weights_sha256(learner.weights())) == (6, before)


def test_a_step_limit_is_no_end_to_the_critics():
    """What follows an interrupted episode is worth something, and what follows a terminated one is not."""
    learner = sac(hyper={"buffer_init_steps": 100})
    go(learner, 1, agents=3)
    last = (np.array([[7, 7], [8, 8]], np.float32),)
    learner.take(0, NAME, Agents.that_ended([0, 1], last, [1.0, 2.0], [False, True]), asking([5.0, 5.0, 5.0], 3.0))
    learner.learn()
    stored = learner.replay
    assert stored.size() == 3
    assert stored.rewards[:3, 0].tolist() == [1.0, 2.0, 3.0]
    assert stored.dones[:3, 0].tolist() == [1.0, 0.0, 0.0]
    assert stored.next_observations["obs_0"][:3, 0, 0].tolist() == [7.0, 8.0, 5.0]
    assert (learner.episodes, learner.ended_returns) == (2, [1.0, 2.0])


def test_rewards_are_those_that_signals_pay_when_a_sample_is_drawn():
    learner = sac(reward_signals={"extrinsic": {"strength": 2.0}, "rnd": {"strength": 10.0}})
    go(learner, 6)
    rows = np.arange(learner.replay.size())

    def intrinsic() -> torch.Tensor:
        drawn = learner.replay._get_samples(rows)
        outer = 2.0 * torch.from_numpy(learner.replay.rewards[rows])
        found = drawn.rewards - outer
        paid = learner._signals[1].module.reward(list(drawn.observations.values()), drawn.actions, None, [])
        torch.testing.assert_close(found[:, 0], 10.0 * torch.from_numpy(paid), rtol=1e-4, atol=1e-4)
        return found

    before = intrinsic()
    go(learner, 20, first=6)
    assert not torch.allclose(before, intrinsic(), rtol=1e-3)


def test_observations_are_scaled_by_the_statistics_of_the_moment_when_they_are_drawn():
    learner = sac(network={"normalize": True})
    go(learner, 4)
    stored = learner.replay.observations["obs_0"][:2, 0].copy()
    assert stored[:, 0].tolist() == [0.0, 1.0], "as they came"
    (drawn,) = learner.observations.scaled((stored,))
    np.testing.assert_array_equal(learner.replay._get_samples(np.arange(2)).observations["obs_0"].numpy(), drawn)
    go(learner, 4, first=100)
    assert not np.allclose(learner.replay._get_samples(np.arange(2)).observations["obs_0"].numpy(), drawn)


def test_settings_reach_stable_baselines3():
    learner = sac(
        hyper={"tau": 1.0, "init_entcoef": 0.25, "learning_rate": 0.5, "learning_rate_schedule": "linear"},
        reward_signals={"extrinsic": {"gamma": 0.7}},
        max_steps=16,
    )
    assert learner._sac.log_ent_coef.exp().item() == pytest.approx(0.25)
    assert learner._sac.gamma == 0.7
    go(learner, 5)
    assert learner.metrics["Policy/Learning Rate"] == pytest.approx(0.25), "half of the run is over"
    critic, target = learner._sac.critic.state_dict(), learner._sac.critic_target.state_dict()
    assert all(torch.equal(critic[name], target[name]) for name in critic)


def test_it_sees_pictures_buffers_and_goals_and_keeps_to_the_range_of_actions():
    sensors = (
        Sensor.of("vector", (2,)),
        Sensor.of("camera", (8, 8, 1)),
        Sensor.of("buffer", (3, 2)),
        Sensor("goal", (2,), (1,), 1),
    )
    behavior = Behavior(NAME, sensors, continuous_actions=3)
    learner = sac(behavior)
    for number in range(5):
        learner.take(0, NAME, None, asking([0.1 * number, 0.2], 1.0, behavior))
        if learner.is_full:
            learner.learn()
        batch = learner.act()[0, NAME]
        assert batch.continuous.shape == (2, 3)
        assert np.abs(batch.continuous).max() <= 1.0
    assert learner.updates == 8
    learner.play()
    acted = []
    for _ in range(2):
        learner.take(0, NAME, None, asking([0.3], behavior=behavior))
        acted.append(learner.act()[0, NAME].continuous.tolist())
    assert acted[0] == acted[1], "the most likely action"


@pytest.mark.parametrize("keeps", [False, True])
def test_what_was_saved_goes_on_bit_for_bit_if_the_buffer_is_kept(keeps):
    options = {"hyper": {"save_replay_buffer": keeps, "buffer_size": 10}, "network": {"normalize": True}}
    first, random = sac(reward_signals={"extrinsic": {}, "curiosity": {}}, **options), RandomStreams()
    go(first, 9)
    random.note()
    state = {
        name: value.copy() if isinstance(value, np.ndarray) else value for name, value in first.state_dict().items()
    }
    streams = random.state_dict()
    go(first, 4, first=9)
    second = sac(reward_signals={"extrinsic": {}, "curiosity": {}}, **options)
    second.load_state_dict(state)
    assert (second.steps, second.replay.size()) == (16, 10 if keeps else 0)
    random.load_state_dict(streams)
    go(second, 1, first=9)
    assert (second.updates > 16) is keeps, "an empty buffer has to fill first"
    go(second, 3, first=10)
    assert (weights_sha256(second.weights()) == weights_sha256(first.weights())) is keeps
    assert second.updates == first.updates, "and then makes up for it"


@pytest.mark.parametrize(
    ("behavior", "has"),
    [
        (Behavior(NAME, BEHAVIOR.sensors, 0, (2, 3)), r"discrete branches \[2, 3\]"),
        (Behavior(NAME, BEHAVIOR.sensors, 1, (2,)), r"discrete branches \[2\]"),
        (Behavior(NAME, BEHAVIOR.sensors), "no actions"),
    ],
)
def test_actions_that_are_not_continuous_are_refused(behavior, has):
    with pytest.raises(TrainerError, match=rf"^Behavior Agent has {has}, but .*; give it trainer_type: ppo\.$"):
        sac(behavior)


def test_rewards_with_different_discount_factors_are_refused():
    with pytest.raises(TrainerError, match=r"Agent have .* \(extrinsic 0.99, rnd 0.5\), .* the same gamma\.$"):
        sac(reward_signals={"extrinsic": {}, "rnd": {"gamma": 0.5}})


@pytest.mark.filterwarnings("ignore:This system does not have")
def test_a_replay_buffer_that_no_machine_has_room_for_is_refused():
    huge = Behavior(NAME, (Sensor.of("camera", (512, 512, 1)),), continuous_actions=1)
    with pytest.raises(
        TrainerError, match=r"^The replay buffer of behavior Agent .*; lower its buffer_size of 10{9}\.$"
    ):
        sac(huge, {"buffer_size": 10**9})


def test_a_policy_that_is_no_number_any_more_ends_the_run_in_a_sentence():
    learner = sac()
    go(learner, 3)
    with torch.no_grad():
        next(learner.policy.actor.mu.parameters()).fill_(float("nan"))
    for _ in range(2):  # where it learns, and where it acts
        with pytest.raises(TrainerError, match="numbers that are not finite"):
            go(learner, 1)
        learner.play()


def settings_file(folder: Path, text: str) -> Path:
    path = folder / "sac.yaml"
    path.write_text(text)
    return path


def test_a_served_environment_with_choices_is_refused_before_anything_is_written(tmp_path, free_port):
    file = settings_file(tmp_path, "default_settings: {trainer_type: sac}")
    where = ("--results-dir", tmp_path, "--base-port", free_port, "--env", BIN / "corridor-server")
    ended = corridor_here("train", file, "--run-id", "r", *where, "--env-args", "--gym", "CartPole-v1")
    assert ended.returncode == 1
    assert "Behavior CartPole-v1 has discrete branches [2], but" in " ".join(ended.stderr.split())
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_a_run_that_was_killed_and_resumed_is_the_same_run(tmp_path, free_port):
    """On the corridor, whose player can say where its areas are."""
    file = settings_file(
        tmp_path,
        """
default_settings:
  trainer_type: sac
  hyperparameters: {batch_size: 32, steps_per_update: 4, save_replay_buffer: true}
  network_settings: {hidden_units: 16, normalize: true}
  max_steps: 800
  summary_freq: 200
""",
    )
    options = (file, "--num-areas", 4, "--eval-episodes", 1)
    whole, cut = (PreparedRun(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGKILL, 200, 0.01) == -signal.SIGKILL
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)


@pytest.mark.slow
def test_a_served_pendulum_is_learned(tmp_path, free_port):
    """Returns near -1,200 are those of a policy that has learned nothing, and -150 of one that balances."""
    file = settings_file(
        tmp_path,
        f"""
env_settings:
  env_path: {BIN / "corridor-server"}
  env_args: [--gym, Pendulum-v1]
  num_areas: 4
behaviors:
  Pendulum-v1:
    trainer_type: sac
    hyperparameters:
      learning_rate: 2.0e-3
      buffer_init_steps: 400
      save_replay_buffer: true
    network_settings:
      hidden_units: 64
    max_steps: 3600
    summary_freq: 400
""",
    )
    run = PreparedRun(tmp_path, "r", free_port, file, "--eval-episodes", 8)
    assert run.finish() == 0, run.output
    summary = run.summary()
    assert summary["env_steps"] >= 3600
    assert float(run.rows()[1]["mean_return"]) < -900
    assert summary["evaluation"]["mean_return"] > -500
