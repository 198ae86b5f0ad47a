"""Agents of a PettingZoo environment as a player's: their behaviors and ids, and how they end, die and come later."""

import re

import numpy as np
import pytest
from gymnasium import spaces
from simulations.foxes_and_hares import FOXES_AND_HARES, Together
from simulations.pettingzoo_moments import answer, asking, ended, envs

from corridor_server.protocol.agents import ActionBatch
from corridor_server.simulations.simulation import SimulationError

# Agents, behaviors and ids.


def test_a_behavior_is_named_after_its_agents_less_their_numbers(play_pettingzoo):
    assert play_pettingzoo().behaviors.keys() == {"fox?team=0", "hare?team=0"}
    assert play_pettingzoo(lambda: Together(agents=("a_b_12", "_7", "x1"))).behaviors.keys() == {
        "a_b?team=0",
        "_7?team=0",
        "x1?team=0",
    }


def test_an_agents_id_is_its_place_among_all_possible_of_its_copy_after_those_before(play_pettingzoo):
    simulation = play_pettingzoo(num_areas=2)
    moment = simulation.reset()
    for _ in range(7):
        assert asking(moment) == {"fox": [0, 1, 3, 4], "hare": [2, 5]}
        moment = answer(simulation, moment)


def test_patterns_give_behaviors_and_the_first_that_fits_counts(play_pettingzoo):
    simulation = play_pettingzoo(behaviors=(("leader", re.compile("fox_0")), ("animal", re.compile("fox_.*|hare_.*"))))
    assert asking(simulation.reset()) == {"leader": [0], "animal": [1, 2]}


def test_a_pattern_fits_the_whole_name(play_pettingzoo):
    with pytest.raises(SimulationError, match="--behavior 'a' fits none of the agents of mine: fox_0, fox_1, hare_0"):
        play_pettingzoo(behaviors=(("a", re.compile("fox")),))


def test_agents_that_are_numbers_have_behaviors_too(play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together(agents=(0, 1)), behaviors=(("agent", re.compile(r"\d+")),))
    moment = simulation.reset()
    assert asking(moment) == {"agent": [0, 1]}
    assert asking(answer(simulation, moment)) == {"agent": [0, 1]}


def test_a_behaviors_team_is_in_its_name(play_pettingzoo):
    assert play_pettingzoo(teams={"hare": 1}).behaviors.keys() == {"fox?team=0", "hare?team=1"}


@pytest.mark.parametrize(("option", "given"), [("--team", {"teams": {"cat": 1}}), ("--group", {"groups": {"cat"}})])
def test_a_team_or_group_of_no_behavior_is_refused(option, given, play_pettingzoo):
    with pytest.raises(SimulationError, match=f"{option} names behavior 'cat', but mine has fox, hare"):
        play_pettingzoo(**given)


def test_agents_of_a_behavior_have_the_same_spaces(play_pettingzoo):
    class Unequal(Together):
        def action_space(self, agent):
            return spaces.Discrete(2 if agent == "fox_1" else 3)

    with pytest.raises(
        SimulationError, match="agents of behavior 'fox' of mine differ in their spaces, fox_1 from those"
    ):
        play_pettingzoo(Unequal)
    simulation = play_pettingzoo(Unequal, behaviors=(("second", re.compile("fox_1")),))
    assert simulation.behaviors["second?team=0"].discrete_branches == (2,)


def test_every_agent_gets_its_own_action(play_pettingzoo):
    class Telling(Together):
        def step(self, actions):
            self.told = actions
            return super().step(actions)

    simulation = play_pettingzoo(Telling, num_areas=2)
    simulation.reset()
    none = np.zeros((4, 0), np.float32)
    foxes = ActionBatch(none, np.array([[0], [1], [2], [0]], np.int32))
    hares = ActionBatch(none[:2], np.array([[1], [2]], np.int32))
    simulation.step({"fox?team=0": foxes, "hare?team=0": hares})
    assert [env.told for env in envs(simulation)] == [
        {"fox_0": 0, "fox_1": 1, "hare_0": 1},
        {"fox_0": 2, "fox_1": 0, "hare_0": 2},
    ]


# Ends and beginnings.


@pytest.mark.parametrize(
    ("what", "interrupted"), [("terminated", False), ("truncated", True), ("both", False), ("gone", True)]
)
def test_an_agent_that_dies_ends_with_its_last_observation_and_asks_again_in_the_next_episode(
    what, interrupted, play_pettingzoo
):
    simulation = play_pettingzoo(lambda: Together({1: {"fox_1": what}}))
    moment = answer(simulation, simulation.reset())
    assert ended(moment) == {1: ([1, 1], interrupted)}
    assert asking(moment) == {"fox": [0], "hare": [2]}
    moment = answer(simulation, moment)
    assert ended(moment) == {}
    moment = answer(simulation, moment)
    assert ended(moment) == {0: ([1, 3], False), 2: ([1, 3], False)}
    assert asking(moment) == {"fox": [0, 1], "hare": [2]}
    assert moment["fox?team=0"].deciding.observations[0].tolist() == [[2, 0], [2, 0]]


def test_ends_stand_before_requests_in_every_behavior_and_copies_go_on_by_themselves(play_pettingzoo):
    simulation = play_pettingzoo(num_areas=2)
    envs(simulation)[1].length = 1
    moment = answer(simulation, simulation.reset())
    assert {name: agents.ids.tolist() for name, agents in moment.items()} == {
        "fox?team=0": [3, 4, 0, 1, 3, 4],
        "hare?team=0": [5, 2, 5],
    }
    assert moment["fox?team=0"].done.tolist() == [True, True, False, False, False, False]


def test_an_end_is_what_was_even_if_the_reset_writes_into_the_same_array(play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together(length=1))
    moment = answer(simulation, simulation.reset())
    assert ended(moment) == dict.fromkeys(range(3), ([1, 1], False))


def test_an_agent_that_comes_in_mid_episode_asks_from_then_on(play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together({2: {"hare_0": "comes"}}, first=("fox_0",)))
    moment = simulation.reset()
    assert asking(moment) == {"fox": [0]}
    moment = answer(simulation, answer(simulation, moment))
    assert asking(moment) == {"fox": [0], "hare": [2]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {0, 2}
    assert asking(moment) == {"fox": [0], "hare": []}


def test_an_agent_that_comes_may_have_no_reward_or_end_said_of_it(play_pettingzoo):
    class Terse(Together):
        def step(self, actions):
            return tuple(
                each if number == 0 else {agent: each[agent] for agent in actions}
                for number, each in enumerate(super().step(actions))
            )

    simulation = play_pettingzoo(lambda: Terse({1: {"hare_0": "comes"}}, first=("fox_0",)))
    assert asking(answer(simulation, simulation.reset())) == {"fox": [0], "hare": [2]}


def test_what_an_environment_still_says_of_dead_agents_is_not_heard(play_pettingzoo):
    class Chatty(Together):
        """Keeps all agents among its agents, and says of each that ended in every step that it did."""

        def reset(self, seed=None, options=None):
            self.over = set()
            return super().reset(seed, options)

        def step(self, actions):
            assert actions.keys() == set(self.possible_agents) - self.over
            self.agents = [agent for agent in self.agents if agent not in self.over]
            _, got, terminated, truncated, infos = super().step(dict(actions))
            self.over |= {agent for agent in terminated if terminated[agent]}
            self.agents = list(self.possible_agents)
            everybody = dict.fromkeys(self.possible_agents)
            return (
                {agent: self.seen[agent] for agent in everybody},
                {agent: got.get(agent, 9.0) for agent in everybody},
                {agent: agent in self.over for agent in everybody},
                {agent: truncated.get(agent, False) for agent in everybody},
                infos,
            )

    simulation = play_pettingzoo(lambda: Chatty({1: {"fox_1": "terminated"}}))
    moment = answer(simulation, simulation.reset())
    assert ended(moment).keys() == {1}
    moment = answer(simulation, moment)
    assert ended(moment) == {}
    assert asking(moment) == {"fox": [0], "hare": [2]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {0, 2}
    assert asking(moment) == {"fox": [0, 1], "hare": [2]}  # nobody was left, so that a new episode began


def test_a_reset_begins_an_episode_but_keeps_one_that_began_by_itself_once(play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together(length=1), num_areas=2)
    envs(simulation)[1].length = 3
    answer(simulation, simulation.reset())
    kept = simulation.reset()["hare?team=0"]
    assert kept.observations[0].tolist() == [[2, 0], [2, 0]]
    assert not kept.done.any()
    assert simulation.reset()["hare?team=0"].observations[0].tolist() == [[3, 0], [3, 0]]


@pytest.mark.parametrize(("seed", "expected"), [(5, [5, 6]), (-1, [2**32 - 1, 0]), (-(2**31), [2**31, 2**31 + 1])])
def test_a_copys_seed_is_the_trainers_and_its_number_and_only_its_first_reset_has_it(seed, expected, play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together(length=1), num_areas=2, seed=seed)
    answer(simulation, simulation.reset())
    assert [env.seeds for env in envs(simulation)] == [[expected[0], None], [expected[1], None]]


def test_an_episode_in_which_nobody_acts_is_refused(play_pettingzoo):
    class Empty(Together):
        def reset(self, seed=None, options=None):
            super().reset(seed, options)
            self.agents = []
            return {}, {}

    with pytest.raises(SimulationError, match="The environment began an episode in which no agent acts"):
        play_pettingzoo(Empty).reset()


def test_an_agent_that_is_none_of_the_possible_is_refused(play_pettingzoo):
    class More(Together):
        def __init__(self):
            super().__init__(agents=(*FOXES_AND_HARES, "hare_1"))
            self.possible_agents.remove("hare_1")

    with pytest.raises(SimulationError, match="mine has an agent 'hare_1', which is not one of its possible"):
        play_pettingzoo(More).reset()
