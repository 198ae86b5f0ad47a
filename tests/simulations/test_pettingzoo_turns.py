"""Agents of a PettingZoo environment that act one after the other, and the timing of Unity with them."""

import pytest
from simulations.pettingzoo_moments import answer, asking, ended, envs, rewards, zeros
from simulations.turns import Turns

from corridor_server.decision_timing import Apart
from corridor_server.simulations.agent_areas import TurnsArea
from corridor_server.simulations.pettingzoo_simulation import PettingZooEnvironment
from corridor_server.simulations.simulation import SimulationError


def test_the_agent_whose_turn_it_is_asks_with_what_it_got_since_its_last_turn(take_turns):
    simulation = take_turns()
    moment = simulation.reset()
    assert not simulation.acts_when_idle
    assert asking(moment) == {"player": [0]}
    assert rewards(moment) == {0: (0, 0)}
    moment = answer(simulation, moment, choice=1)
    assert rewards(moment) == {1: (2, 0)}
    moment = answer(simulation, moment, choice=0)
    assert rewards(moment) == {0: (3, 0)}


def test_the_mask_is_of_the_agent_whose_turn_it_is(take_turns):
    simulation = take_turns()
    moment = simulation.reset()
    assert moment["player?team=0"].masks[0].tolist() == [[False, False, False]]
    assert answer(simulation, moment)["player?team=0"].masks[0].tolist() == [[True, False, False]]


def test_a_games_end_ends_every_agent_once_with_what_it_saw_and_the_next_game_begins(take_turns):
    simulation = take_turns()
    moment = simulation.reset()
    for _ in range(3):
        moment = answer(simulation, moment)
        assert ended(moment) == {}
    moment = answer(simulation, moment)
    assert ended(moment) == {0: ([1, 4], False), 1: ([1, -1], False)}
    assert asking(moment) == {"player": [0]}
    assert moment["player?team=0"].deciding.observations[0].tolist() == [[2, 0]]


def test_an_agent_that_dies_is_passed_and_the_others_go_on(take_turns):
    simulation = take_turns(
        lambda: Turns({1: {"b": "truncated"}, 3: {"a": "both", "c": "terminated"}}, agents=("a", "b", "c"))
    )
    moment = answer(simulation, simulation.reset())
    assert ended(moment) == {1: ([1, 1], True)}
    assert asking(moment) == {"player": [2]}
    moment = answer(simulation, moment)
    assert asking(moment) == {"player": [0]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {0, 2}


def test_agents_that_end_in_a_reset_are_passed_and_a_game_that_does_is_refused(take_turns):
    assert asking(take_turns(lambda: Turns(first_ends=("a",))).reset()) == {"player": [1]}
    with pytest.raises(SimulationError, match="The environment began an episode in which no agent acts"):
        take_turns(lambda: Turns(first_ends=("a", "b"))).reset()


def test_several_copies_take_their_turns_by_themselves(take_turns):
    simulation = take_turns(num_areas=2)
    envs(simulation)[1].ends = {1: {"a": "terminated", "b": "terminated"}}
    moment = simulation.reset()
    assert asking(moment) == {"player": [0, 2]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {2, 3}
    assert asking(moment) == {"player": [1, 2]}


def test_an_action_goes_to_the_agent_that_asked_wherever_its_behavior_stands(play_pettingzoo):
    """In one copy it is the first player's turn, in the other the second's: behaviors of their own."""

    class Telling(Turns):
        def step(self, action):
            self.told = [*getattr(self, "told", []), (self.agent_selection, action)]
            super().step(action)

    simulation = play_pettingzoo(Telling, function="env", num_areas=2)
    simulation.reset()
    envs(simulation)[1].step(0)
    simulation._areas[1]._pass_ended()
    moment = simulation._told([(n, e) for n, area in enumerate(simulation._areas) for e in area.asking()], "a step")
    assert asking(moment) == {"a": [0], "b": [3]}
    actions = zeros(simulation, moment)
    actions["b?team=0"].discrete[:] = 2
    simulation.step(actions)
    assert envs(simulation)[0].told == [("a", 0)]
    assert envs(simulation)[1].told[1:] == [("b", 2)]


def test_an_agent_that_stays_after_its_end_would_be_passed_for_ever_and_is_refused(take_turns):
    class Staying(Turns):
        def step(self, action):
            if action is not None:
                super().step(action)

    simulation = take_turns(Staying)
    moment = simulation.reset()
    for _ in range(3):
        moment = answer(simulation, moment)
    with pytest.raises(SimulationError, match="Agent a ended, but is still one of agents after a step with None"):
        answer(simulation, moment)


def test_agents_that_take_turns_have_no_groups(take_turns):
    with pytest.raises(SimulationError, match="--group needs agents that act together, but those of mine take turns"):
        take_turns(groups=frozenset({"*"}))


def test_unitys_timing_sends_ends_alone_and_lets_nobody_act_idly_out_of_turn(take_turns):
    simulation = take_turns(lambda: Turns({1: {"a": "terminated", "b": "terminated"}}), num_areas=1)
    timing = Apart(simulation)
    moment, _ = timing.reset()
    assert rewards(moment) == {0: (0, 0)}
    assert envs(simulation)[0].turn == 0
    moment, _ = timing.step(zeros(simulation, moment))
    assert ended(moment).keys() == {0, 1}
    assert moment["player?team=0"].done.all()
    moment, _ = timing.step({})
    assert asking(moment) == {"player": [0]}
    moment, _ = timing.step(zeros(simulation, moment))
    assert moment["player?team=0"].done.all()


def test_unitys_timing_lets_agents_that_act_together_act_once_after_a_reset(play_pettingzoo):
    simulation = play_pettingzoo()
    moment, _ = Apart(simulation).reset()
    assert moment["hare?team=0"].observations[0].tolist() == [[1, 1]]


def test_a_module_with_only_an_env_is_played_in_turns_and_one_with_neither_is_refused(monkeypatch):
    assert isinstance(PettingZooEnvironment("pettingzoo.classic.tictactoe_v3").area(), TurnsArea)
    with pytest.raises(
        SimulationError, match="--pettingzoo is 'json', but a module with parallel_env or env was expec"
    ):
        PettingZooEnvironment("json").area()
