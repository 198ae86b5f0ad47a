"""Running episodes of environments of others, written down and played again in copies that were made anew."""

import itertools
import random

import numpy as np
import pytest
from gymnasium import spaces
from simulations.counting import Count
from simulations.foxes_and_hares import Together
from simulations.turns import Turns

from corridor_server.protocol import side_channels
from corridor_server.protocol.agents import ActionBatch
from corridor_server.protocol.samplers import Uniform
from corridor_server.simulations.simulation import NotRestored


class Rolling(Count):
    """Draws in every step, and keeps a number, an array, a generator and lists over its episodes."""

    action_space = spaces.Tuple([spaces.Discrete(3), spaces.Box(-1, 1, (1,))])

    def __init__(self, length=3, ends="terminated", render_mode=None):
        super().__init__(length, ends, render_mode)
        self.own = {"games": [np.random.RandomState(), random.Random()]}
        self.former = {"action": 0, "sums": [0.0, np.zeros(2)]}
        self.born = np.random.default_rng().random()  # otherwise in every process

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.own["games"][0].seed(seed)
        seen, info = super().reset(seed=seed)
        self.length = int(self.np_random.integers(2, 9))
        return seen, info

    def step(self, action):
        seen, _, terminated, truncated, info = super().step(action[0])
        numpys, pythons = self.own["games"]
        self.former["sums"][1] += action[1]
        reward = self.former["action"] + self.former["sums"][1][0] + numpys.rand() + pythons.random() + self.born
        self.former["action"] = int(action[0])
        seen[2] = self.np_random.random() + self.gravity
        return seen, reward, terminated, truncated, info


class Chancy(Together):
    """Its agents' episode has a length of chance; the agents observe what is drawn."""

    def reset(self, seed=None, options=None):
        told = super().reset(seed=seed)
        self.length = int(self.np_random.integers(2, 6))
        return told

    def step(self, actions):
        for seen in self.seen.values():
            seen[0] = self.np_random.random()
        return super().step(actions)


def told(moment):
    return [
        (name, *(values.tolist() for values in (agents.ids, agents.rewards, agents.done, *agents.observations)))
        for name, agents in sorted(moment.items())
        if len(agents)
    ]


def play(simulation, moment, steps, generator):
    """What is told in steps of drawn actions, and the last moment."""
    found = []
    for _ in range(steps):
        actions = {}
        for name, agents in moment.items():
            behavior, count = simulation.behaviors[name], len(agents.deciding)
            numbers = generator.uniform(-1, 1, (count, behavior.continuous_actions)).astype(np.float32)
            choices = generator.integers(0, behavior.discrete_branches, (count, len(behavior.discrete_branches)))
            if count:
                actions[name] = ActionBatch(numbers, choices.astype(np.int32))
        moment, _ = simulation.step(actions)
        found.append(told(moment))
    return found, moment


def over_the_wire(simulation, into):
    """Puts the state of one into the other, as the protocol carries it."""
    [(_, payload)] = side_channels.split(side_channels.write_state(simulation.snapshot()))
    into.restore(side_channels.read_state(payload, into.snapshot()))


@pytest.fixture(params=["gymnasium", "gymnasium made anew", "together", "turns"])
def make(request, register_gymnasium, play_gymnasium, play_pettingzoo):
    """Makes the same simulation again and again, with parameters that are set where it has any."""
    name = register_gymnasium(Rolling if request.param == "gymnasium" else Count)

    def made():
        if request.param == "turns":
            return play_pettingzoo(Turns, function="env", num_areas=2)
        play, kind = (play_pettingzoo, Chancy) if request.param == "together" else (play_gymnasium, name)
        simulation = play(kind, num_areas=3, parameters=("gravity",), arguments={"length": 3})
        if request.param != "gymnasium":
            simulation.set_parameter("length", 7.0)
        simulation.set_parameter("gravity", Uniform(3, 1.0, 2.0))
        return simulation

    return made


@pytest.mark.parametrize("steps", [0, 1, 2, 25])
def test_they_go_on_as_those_that_were_saved_and_can_be_saved_again(make, steps):
    first, generator = make(), np.random.default_rng(0)
    _, moment = play(first, first.reset(), steps, generator)
    again = make()
    over_the_wire(first, again)
    assert again.restored
    shown = again.reset()
    assert told(shown) == told({name: agents.deciding for name, agents in moment.items()})
    assert told(again.reset()) == told(shown), "resets keep what has not moved"
    for _ in range(2):
        state = generator.bit_generator.state
        expected, moment = play(first, moment, 20, generator)
        generator.bit_generator.state = state
        found, _ = play(again, shown, 20, generator)
        assert found == expected
        assert not again.restored
        third = make()
        over_the_wire(again, third)
        again, shown = third, third.reset()


def test_a_snapshot_changes_nothing(make):
    watched, alone, one, other = make(), make(), np.random.default_rng(0), np.random.default_rng(0)
    begun = watched.reset()
    over_the_wire(watched, alone)  # so that what only chance has made is alike
    moments = begun, alone.reset()
    for _ in range(20):
        watched.snapshot()
        seen, first = play(watched, moments[0], 1, one)
        expected, second = play(alone, moments[1], 1, other)
        moments = first, second
        assert seen == expected


def test_for_a_trainer_that_will_not_ask_nothing_is_kept(make):
    simulation = make()
    simulation.forgo_snapshots()
    play(simulation, simulation.reset(), 20, np.random.default_rng(0))
    assert simulation.snapshot() is None


def test_an_episode_that_was_restored_ends_at_a_reset_when_a_parameter_has_changed(make):
    first = make()
    play(first, first.reset(), 1, np.random.default_rng(0))
    if not first._parameters._names:
        return  # it has none
    again = make()
    over_the_wire(first, again)
    shown = told(again.reset())
    again.set_parameter("gravity", Uniform(3, 1.0, 2.0))
    assert told(again.reset()) == shown, "it had this value"
    again.set_parameter("gravity", 4.0)
    assert told(again.reset()) != shown


@pytest.mark.parametrize("other", [{"length": 6.0}, {"num_areas": 2}, {"arguments": {"length": 4}}])
def test_a_state_of_others_is_refused_and_other_episodes_begin(register_gymnasium, play_gymnasium, other):
    name = register_gymnasium(Count)

    def made(length=7.0, num_areas=3, arguments=None):
        simulation = play_gymnasium(name, num_areas=num_areas, arguments=arguments or {"length": 3})
        simulation.set_parameter("length", length)
        return simulation

    first, again = made(), made(**other)
    begun = told(first.reset())
    with pytest.raises(NotRestored, match="another environment|other environment parameters"):
        over_the_wire(first, again)
    assert not again.restored
    assert told(again.reset()) != begun, "its seeds are others than the run's first"
    play(again, again.reset(), 9, np.random.default_rng(0))


class FromNowhere(Count):
    """Draws from what nobody can see."""

    def reset(self, *, seed=None, options=None):
        self.draw = np.random.default_rng().random
        return super().reset(seed=seed)

    def step(self, action):
        seen, *rest = super().step(action)
        seen[2] = self.draw()
        return seen, *rest


class OfTheProcess(Count):
    """Draws from the random numbers of everybody."""

    def step(self, action):
        self.seen[2] = random.random()
        return super().step(action)


class Compiled(Count):
    """Keeps over its episodes what compiled code may remember in."""

    def __init__(self, length=3, ends="terminated", render_mode=None):
        super().__init__(length, ends, render_mode)
        self.hidden = itertools.count()

    def step(self, action):
        next(self.hidden)
        return super().step(action)


def test_episodes_that_are_others_when_played_again_are_refused_and_new_ones_begin(register_gymnasium, play_gymnasium):
    name = register_gymnasium(FromNowhere)
    first, again = play_gymnasium(name), play_gymnasium(name)
    play(first, first.reset(), 2, np.random.default_rng(0))
    with pytest.raises(NotRestored, match="^played once more, its episodes are others$"):
        over_the_wire(first, again)
    assert [row[1] for row in told(again.reset())[0][4]] == [0, 0], "they begin"
    play(again, again.reset(), 9, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("environment", "says"),
    [(OfTheProcess, "random generators of the whole process"), (Compiled, "hidden is compiled code's, lives on")],
)
def test_episodes_that_cant_be_played_again_have_no_state_and_one_sentence_says_why(
    play_gymnasium, caplog, environment, says
):
    simulation = play_gymnasium(environment)
    _, moment = play(simulation, simulation.reset(), 4, np.random.default_rng(0))
    assert simulation.snapshot() is None
    play(simulation, moment, 4, np.random.default_rng(0))
    assert simulation.snapshot() is None
    [message] = [record.getMessage() for record in caplog.records if "can't be saved" in record.getMessage()]
    assert says in message
    assert message.endswith("a resumed run will begin new ones.")


def test_an_episode_that_is_too_long_has_no_state_but_the_next_one_has(play_gymnasium, monkeypatch):
    monkeypatch.setattr("corridor_server.simulations.running_episodes._MOST_STEPS", 5)
    simulation = play_gymnasium(arguments={"length": 7})
    moment = simulation.reset()
    for step in range(1, 10):
        _, moment = play(simulation, moment, 1, np.random.default_rng(0))
        assert (simulation.snapshot() is None) == (step == 6)
