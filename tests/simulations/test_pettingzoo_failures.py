"""PettingZoo environments that raise, or give what can't be used."""

import numpy as np
import pytest
from simulations.foxes_and_hares import Together
from simulations.pettingzoo_moments import answer

from corridor_server.simulations.simulation import SimulationError


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("__init__", r"mine.parallel_env can't be made \(ValueError: no fuel\)"),
        ("observation_space", r"mine doesn't say what its agents are \(ValueError: no fuel\)"),
        ("reset", r"mine failed in a reset \(ValueError: no fuel\)"),
        ("step", r"mine failed in a step \(ValueError: no fuel\)"),
    ],
)
def test_an_environment_that_raises_is_named_with_its_own_words(method, said, play_pettingzoo):
    def failing(*arguments, **options):
        raise ValueError("no\nfuel")

    def run(simulation):
        answer(simulation, simulation.reset())

    with pytest.raises(SimulationError, match=said) as caught:
        run(play_pettingzoo(type("Failing", (Together,), {method: failing})))
    assert isinstance(caught.value.__cause__, ValueError)


def test_an_environment_without_possible_agents_is_refused(play_pettingzoo):
    class Unsaid(Together):
        possible_agents = property(lambda self: self.unsaid, lambda self, value: None)

    with pytest.raises(SimulationError, match=r"mine doesn't say what its agents are \(AttributeError"):
        play_pettingzoo(Unsaid)


def test_an_environment_that_raises_when_it_is_closed_does_no_harm(play_pettingzoo, caplog):
    class Unclosable(Together):
        def close(self):
            raise RuntimeError("never")

    play_pettingzoo(Unclosable).close()
    assert "mine failed when it was closed (RuntimeError: never)." in caplog.text


@pytest.mark.parametrize(
    ("observation", "said"),
    [
        (np.array([0, np.nan]), r"gave agent 5 observation\[1\] = nan, but finite"),
        (np.array([-np.inf, 0]), r"gave agent 5 observation\[0\] = -inf, but finite"),
        (
            np.zeros(3),
            r"mine gave in a .* what can't be used \(ValueError: observation of shape \(3,\) came, but \(2,\) was exp",
        ),
        (None, r"mine gave in a (reset|step) what can't be used"),
        ("here", r"mine gave in a (reset|step) what can't be used"),
    ],
)
@pytest.mark.parametrize("when", ["reset", "step"])
def test_an_observation_that_is_none_of_the_space_is_refused(observation, said, when, play_pettingzoo):
    class Bad(Together):
        def reset(self, seed=None, options=None):
            seen, infos = super().reset(seed, options)
            return (seen | {"hare_0": observation} if when == "reset" and seed == 1 else seen), infos

        def step(self, actions):
            seen, *rest = super().step(actions)
            return (seen | {"hare_0": observation} if self.seeds[0] == 1 else seen, *rest)

    simulation = play_pettingzoo(Bad, num_areas=2)
    with pytest.raises(SimulationError, match=said):
        answer(simulation, simulation.reset())


@pytest.mark.parametrize("reward", [np.nan, np.inf, -np.inf])
def test_a_reward_that_is_no_number_is_named(reward, play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together(rewards={"hare_0": reward}))
    with pytest.raises(SimulationError, match=f"The environment gave agent 2 a reward = {reward}, but finite"):
        answer(simulation, simulation.reset())


WHAT = ["observation", "reward", "termination", "truncation"]


@pytest.mark.parametrize("index", range(4), ids=WHAT)
def test_what_is_not_told_of_an_agent_that_acted_is_named(index, play_pettingzoo):
    class Silent(Together):
        def step(self, actions):
            told = super().step(actions)
            del told[index]["hare_0"]
            return told

    simulation = play_pettingzoo(Silent)
    with pytest.raises(
        SimulationError, match=f"^The environment gave no {WHAT[index]} of agent hare_0, who was to have"
    ):
        answer(simulation, simulation.reset())


def test_a_reward_in_a_list_is_one_as_behind_gymnasium(play_pettingzoo):
    class Listed(Together):
        def step(self, actions):
            seen, rewards, *rest = super().step(actions)
            return (seen, {agent: np.array([reward + 0.5]) for agent, reward in rewards.items()}, *rest)

    simulation = play_pettingzoo(Listed)
    moment = answer(simulation, simulation.reset())
    assert all((agents.rewards % 1 == 0.5).all() for agents in moment.values())
