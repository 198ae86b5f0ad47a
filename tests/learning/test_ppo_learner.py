"""PPO's updates beside the next steps: what they learn, who acts meanwhile, and what is kept."""

import threading

import numpy as np
import pytest
import torch

from corridor_server.protocol.agents import Agents, Behavior, Sensor
from trainer.behavior_settings import BehaviorSettings
from trainer.errors import TrainerError
from trainer.learning.ppo_learner import PPOLearner
from trainer.learning.ppo_update import PPOUpdate
from trainer.learning.rewards import build_signals

NAME, AGENTS = "Agent?team=0", 4
KINDS = {
    "vectors": Behavior(NAME, (Sensor.of("vector", (3,)),), 1, (3,)),
    "pictures": Behavior(NAME, (Sensor.of("picture", (8, 8, 2)),), 1, (3,)),
}


def learner_of(kind: str, threaded: bool) -> PPOLearner:
    settings = BehaviorSettings.from_mapping(
        {
            "threaded": threaded,
            "hyperparameters": {"batch_size": 16, "buffer_size": 64, "learning_rate": 0.01},
            "network_settings": {"hidden_units": 16},
            "reward_signals": {"extrinsic": {}, "curiosity": {"strength": 0.1}},
        }
    )
    torch.set_num_threads(1)
    torch.manual_seed(0)
    return PPOLearner(KINDS[kind], settings, build_signals(KINDS[kind], settings, 0), 0)


class Play:
    """Agents that see and get what is drawn, however they act."""

    def __init__(self, kind: str) -> None:
        self.behavior, self.rng = KINDS[kind], np.random.default_rng(0)

    def message(self) -> Agents:
        seen = tuple(self.rng.random((AGENTS, *each.shape), np.float32) for each in self.behavior.sensors)
        return Agents.that_ask(np.arange(AGENTS), seen, self.rng.random(AGENTS).astype(np.float32))

    def fill(self, learner: PPOLearner) -> Agents:
        """Until there is enough for an update; who waits for an action then."""
        while True:
            waiting = self.message()
            learner.take(0, NAME, None, waiting)
            if learner.is_full:
                return waiting
            learner.act()


def most_likely(learner: PPOLearner, behavior: Behavior) -> np.ndarray:
    """What it would have agents do; nobody waits for it afterwards."""
    seen = tuple(torch.linspace(0, 1, 5 * np.prod(each.shape)).reshape(5, *each.shape) for each in behavior.sensors)
    observed = learner.observations.of(Agents.that_ask(np.arange(5), tuple(each.numpy() for each in seen), np.zeros(5)))
    return learner._decide(observed, deterministic=True).continuous


@pytest.fixture
def gate(monkeypatch):
    """Holds updates until it is opened."""
    opened, update = threading.Event(), PPOUpdate.update

    def held(*given):
        assert opened.wait(10)
        return update(*given)

    monkeypatch.setattr(PPOUpdate, "update", held)
    yield opened
    opened.set()


@pytest.mark.parametrize("kind", KINDS)
def test_agents_are_decided_for_with_the_policy_before_until_the_next_update_is_due(kind, gate):
    learner, play = learner_of(kind, threaded=True), Play(kind)
    play.fill(learner)
    before = most_likely(learner, play.behavior)
    assert learner.learn() is False
    play.fill(learner)  # while the gate is shut
    np.testing.assert_array_equal(most_likely(learner, play.behavior), before)
    gate.set()
    assert learner.finish() is True
    assert learner.finish() is False
    after = most_likely(learner, play.behavior)
    assert not np.allclose(after, before)
    there = learner_of(kind, threaded=False)
    there.load_policy(learner.state_dict())
    np.testing.assert_array_equal(most_likely(there, play.behavior), after)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_is_learned_of_the_same_steps(kind):
    beside, here = learner_of(kind, threaded=True), learner_of(kind, threaded=False)
    for learner in (beside, here):
        torch.manual_seed(1)
        Play(kind).fill(learner)
        learner.learn()
    beside.finish()
    assert beside.updates == here.updates == 1
    assert beside.metrics == here.metrics
    for name, value in here.weights().items():
        np.testing.assert_array_equal(beside.weights()[name], value)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_saved_while_it_runs_goes_on_as_if_nothing_had_been(kind):
    learner, play = learner_of(kind, threaded=True), Play(kind)
    waiting = play.fill(learner)
    learner.learn()
    state = learner.state_dict()  # waits for the update, and lets nobody act by it yet
    restored = learner_of(kind, threaded=True)
    restored.load_state_dict(state)
    restored.take(0, NAME, None, waiting, again=True)
    ends = []
    for each in (learner, restored):
        torch.manual_seed(2)
        each.act()
        Play(kind).fill(each)
        each.finish()
        each.learn()
        ends.append(each.state_dict())
    assert ends[0].keys() == ends[1].keys()
    for name, value in ends[0].items():
        if isinstance(value, np.ndarray) and not name.startswith(("experience/", "recent/")):
            np.testing.assert_array_equal(ends[1][name], value, err_msg=name)


def test_the_last_update_is_made_at_once():
    learner, play = learner_of("vectors", threaded=True), Play("vectors")
    learner.learned = learner.settings.max_steps - 64
    play.fill(learner)
    assert learner.learn() is True
    assert learner.is_done
    assert learner.updates == 1


def test_a_learner_that_only_plays_from_here_on_plays_what_was_learned():
    learner, play = learner_of("vectors", threaded=True), Play("vectors")
    play.fill(learner)
    before = most_likely(learner, play.behavior)
    learner.learn()
    learner.play()
    assert not np.allclose(most_likely(learner, play.behavior), before)


def test_numbers_that_go_bad_beside_end_the_run_in_one_sentence():
    learner, play = learner_of("vectors", threaded=True), Play("vectors")
    play.fill(learner)
    with torch.no_grad():
        learner.policy.value_net.bias.fill_(float("nan"))
    learner.learn()
    with pytest.raises(TrainerError, match="has diverged"):
        learner.finish()
