"""Agents of a PettingZoo environment as a player's: together or in turns, that die, come later and share rewards."""

import re
import sys
import types

import numpy as np
import pytest
from gymnasium import spaces

from corridor_server.decision_timing import Apart
from corridor_server.protocol.agents import ActionBatch
from corridor_server.protocol.samplers import Uniform
from corridor_server.simulations.agent_areas import TurnsArea
from corridor_server.simulations.pettingzoo_simulation import PettingZooEnvironment, PettingZooSimulation
from corridor_server.simulations.simulation import SimulationError

VECTOR = spaces.Box(-np.inf, np.inf, (2,))
FOXES_AND_HARES = ("fox_0", "fox_1", "hare_0")


class Together:
    """Observes [episode, step] in one array per agent that it goes on writing into; ``plot`` says who ends and comes.

    The plot is, by step, of whom what is said: "terminated", "truncated", "both", "gone" without a word, or "comes".
    """

    def __init__(self, plot=None, agents=FOXES_AND_HARES, first=None, rewards=None, length=3, gravity=1.0):
        self.plot, self.possible_agents, self.first = plot or {}, list(agents), list(first or agents)
        self.rewards, self.length, self.gravity, self.seeds = rewards or {}, length, gravity, []
        self.np_random = None
        self.seen = {agent: np.zeros(2, np.float32) for agent in agents}
        self.drawn = []

    @property
    def unwrapped(self):
        return self

    def observation_space(self, agent):
        return VECTOR

    def action_space(self, agent):
        return spaces.Discrete(3)

    def reset(self, seed=None, options=None):
        self.seeds.append(seed)
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self.drawn.append(self.np_random.random())
        self.agents, self.step_number = list(self.first), 0
        for seen in self.seen.values():
            seen[:] = seen[0] + 1, 0
        return {agent: self.seen[agent] for agent in self.agents}, {agent: self.info(agent) for agent in self.agents}

    def step(self, actions):
        assert actions.keys() == set(self.agents)
        self.step_number += 1
        said = dict(self.plot.get(self.step_number, {}))
        if self.step_number == self.length:
            said |= dict.fromkeys(self.agents, "terminated")
        told = list(self.agents) + [agent for agent, what in said.items() if what == "comes"]
        for agent in told:
            self.seen[agent][1] = self.step_number
        self.agents = [agent for agent in told if said.get(agent, "comes") == "comes"]
        return (
            {agent: self.seen[agent] for agent in told},
            {agent: self.rewards.get(agent, 0.0) + actions.get(agent, 0) for agent in told},
            {agent: said.get(agent) in ("terminated", "both") for agent in told},
            {agent: said.get(agent) in ("truncated", "both") for agent in told},
            {agent: self.info(agent) for agent in told},
        )

    def info(self, agent):
        return {}

    def close(self):
        pass


@pytest.fixture
def play(monkeypatch):
    """Serves a class as a module's parallel_env or env; its arguments are those of ``arguments``."""
    opened = []

    def one(kind=Together, num_areas=1, seed=0, function="parallel_env", arguments=None, **options):
        monkeypatch.setitem(sys.modules, "mine", types.SimpleNamespace(**{function: kind}))
        opened.append(PettingZooSimulation(PettingZooEnvironment("mine", arguments or {}, **options), seed, num_areas))
        return opened[-1]

    yield one
    for simulation in opened:
        simulation.close()


def envs(simulation):
    return [area._env for area in simulation._areas]


def zeros(simulation, moment, choice=0):
    return {
        name: ActionBatch(
            np.zeros((len(agents.deciding), simulation.behaviors[name].continuous_actions), np.float32),
            np.full((len(agents.deciding), len(simulation.behaviors[name].discrete_branches)), choice, np.int32),
        )
        for name, agents in moment.items()
        if len(agents.deciding)
    }


def answer(simulation, moment, choice=0):
    moment, statistics = simulation.step(zeros(simulation, moment, choice))
    assert statistics == {}
    return moment


def asking(moment):
    return {name.partition("?")[0]: agents.deciding.ids.tolist() for name, agents in moment.items()}


def ended(moment):
    """Of each that ended, by id: [episode, step] and whether it was interrupted."""
    return {
        number: (seen.tolist(), cut)
        for agents in moment.values()
        for number, seen, cut in zip(
            agents.ended.ids.tolist(), agents.ended.observations[0], agents.ended.interrupted.tolist(), strict=True
        )
    }


def rewards(moment):
    return {
        number: (float(own), float(shared))
        for agents in moment.values()
        for number, own, shared, done in zip(
            agents.ids.tolist(), agents.rewards, agents.group_rewards, agents.done, strict=True
        )
        if not done
    }


# Agents, behaviors and ids.


def test_a_behavior_is_named_after_its_agents_less_their_numbers(play):
    assert play().behaviors.keys() == {"fox?team=0", "hare?team=0"}
    assert play(lambda: Together(agents=("a_b_12", "_7", "x1"))).behaviors.keys() == {
        "a_b?team=0",
        "_7?team=0",
        "x1?team=0",
    }


def test_an_agents_id_is_its_place_among_all_possible_of_its_copy_after_those_before(play):
    simulation = play(num_areas=2)
    moment = simulation.reset()
    for _ in range(7):
        assert asking(moment) == {"fox": [0, 1, 3, 4], "hare": [2, 5]}
        moment = answer(simulation, moment)


def test_patterns_give_behaviors_and_the_first_that_fits_counts(play):
    simulation = play(behaviors=(("leader", re.compile("fox_0")), ("animal", re.compile("fox_.*|hare_.*"))))
    assert asking(simulation.reset()) == {"leader": [0], "animal": [1, 2]}


def test_a_pattern_fits_the_whole_name(play):
    with pytest.raises(SimulationError, match="--behavior 'a' fits none of the agents of mine: fox_0, fox_1, hare_0"):
        play(behaviors=(("a", re.compile("fox")),))


def test_agents_that_are_numbers_have_behaviors_too(play):
    simulation = play(lambda: Together(agents=(0, 1)), behaviors=(("agent", re.compile(r"\d+")),))
    moment = simulation.reset()
    assert asking(moment) == {"agent": [0, 1]}
    assert asking(answer(simulation, moment)) == {"agent": [0, 1]}


def test_a_behaviors_team_is_in_its_name(play):
    assert play(teams={"hare": 1}).behaviors.keys() == {"fox?team=0", "hare?team=1"}


@pytest.mark.parametrize(("option", "given"), [("--team", {"teams": {"cat": 1}}), ("--group", {"groups": {"cat"}})])
def test_a_team_or_group_of_no_behavior_is_refused(option, given, play):
    with pytest.raises(SimulationError, match=f"{option} names behavior 'cat', but mine has fox, hare"):
        play(**given)


def test_agents_of_a_behavior_have_the_same_spaces(play):
    class Unequal(Together):
        def action_space(self, agent):
            return spaces.Discrete(2 if agent == "fox_1" else 3)

    with pytest.raises(
        SimulationError, match="agents of behavior 'fox' of mine differ in their spaces, fox_1 from those"
    ):
        play(Unequal)
    simulation = play(Unequal, behaviors=(("second", re.compile("fox_1")),))
    assert simulation.behaviors["second?team=0"].discrete_branches == (2,)


def test_every_agent_gets_its_own_action(play):
    class Telling(Together):
        def step(self, actions):
            self.told = actions
            return super().step(actions)

    simulation = play(Telling, num_areas=2)
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
def test_an_agent_that_dies_ends_with_its_last_observation_and_asks_again_in_the_next_episode(what, interrupted, play):
    simulation = play(lambda: Together({1: {"fox_1": what}}))
    moment = answer(simulation, simulation.reset())
    assert ended(moment) == {1: ([1, 1], interrupted)}
    assert asking(moment) == {"fox": [0], "hare": [2]}
    moment = answer(simulation, moment)
    assert ended(moment) == {}
    moment = answer(simulation, moment)
    assert ended(moment) == {0: ([1, 3], False), 2: ([1, 3], False)}
    assert asking(moment) == {"fox": [0, 1], "hare": [2]}
    assert moment["fox?team=0"].deciding.observations[0].tolist() == [[2, 0], [2, 0]]


def test_ends_stand_before_requests_in_every_behavior_and_copies_go_on_by_themselves(play):
    simulation = play(num_areas=2)
    envs(simulation)[1].length = 1
    moment = answer(simulation, simulation.reset())
    assert {name: agents.ids.tolist() for name, agents in moment.items()} == {
        "fox?team=0": [3, 4, 0, 1, 3, 4],
        "hare?team=0": [5, 2, 5],
    }
    assert moment["fox?team=0"].done.tolist() == [True, True, False, False, False, False]


def test_an_end_is_what_was_even_if_the_reset_writes_into_the_same_array(play):
    simulation = play(lambda: Together(length=1))
    moment = answer(simulation, simulation.reset())
    assert ended(moment) == dict.fromkeys(range(3), ([1, 1], False))


def test_an_agent_that_comes_in_mid_episode_asks_from_then_on(play):
    simulation = play(lambda: Together({2: {"hare_0": "comes"}}, first=("fox_0",)))
    moment = simulation.reset()
    assert asking(moment) == {"fox": [0]}
    moment = answer(simulation, answer(simulation, moment))
    assert asking(moment) == {"fox": [0], "hare": [2]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {0, 2}
    assert asking(moment) == {"fox": [0], "hare": []}


def test_an_agent_that_comes_may_have_no_reward_or_end_said_of_it(play):
    class Terse(Together):
        def step(self, actions):
            return tuple(
                each if number == 0 else {agent: each[agent] for agent in actions}
                for number, each in enumerate(super().step(actions))
            )

    simulation = play(lambda: Terse({1: {"hare_0": "comes"}}, first=("fox_0",)))
    assert asking(answer(simulation, simulation.reset())) == {"fox": [0], "hare": [2]}


def test_what_an_environment_still_says_of_dead_agents_is_not_heard(play):
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

    simulation = play(lambda: Chatty({1: {"fox_1": "terminated"}}))
    moment = answer(simulation, simulation.reset())
    assert ended(moment).keys() == {1}
    moment = answer(simulation, moment)
    assert ended(moment) == {}
    assert asking(moment) == {"fox": [0], "hare": [2]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {0, 2}
    assert asking(moment) == {"fox": [0, 1], "hare": [2]}  # nobody was left, so that a new episode began


def test_a_reset_begins_an_episode_but_keeps_one_that_began_by_itself_once(play):
    simulation = play(lambda: Together(length=1), num_areas=2)
    envs(simulation)[1].length = 3
    answer(simulation, simulation.reset())
    kept = simulation.reset()["hare?team=0"]
    assert kept.observations[0].tolist() == [[2, 0], [2, 0]]
    assert not kept.done.any()
    assert simulation.reset()["hare?team=0"].observations[0].tolist() == [[3, 0], [3, 0]]


@pytest.mark.parametrize(("seed", "expected"), [(5, [5, 6]), (-1, [2**32 - 1, 0]), (-(2**31), [2**31, 2**31 + 1])])
def test_a_copys_seed_is_the_trainers_and_its_number_and_only_its_first_reset_has_it(seed, expected, play):
    simulation = play(lambda: Together(length=1), num_areas=2, seed=seed)
    answer(simulation, simulation.reset())
    assert [env.seeds for env in envs(simulation)] == [[expected[0], None], [expected[1], None]]


def test_an_episode_in_which_nobody_acts_is_refused(play):
    class Empty(Together):
        def reset(self, seed=None, options=None):
            super().reset(seed, options)
            self.agents = []
            return {}, {}

    with pytest.raises(SimulationError, match="The environment began an episode in which no agent acts"):
        play(Empty).reset()


def test_an_agent_that_is_none_of_the_possible_is_refused(play):
    class More(Together):
        def __init__(self):
            super().__init__(agents=(*FOXES_AND_HARES, "hare_1"))
            self.possible_agents.remove("hare_1")

    with pytest.raises(SimulationError, match="mine has an agent 'hare_1', which is not one of its possible"):
        play(More).reset()


# Groups.


def test_a_reward_that_all_of_a_group_get_is_the_groups(play):
    simulation = play(lambda: Together(rewards={"fox_0": 2.0, "fox_1": 2.0, "hare_0": 5.0}), groups=frozenset({"fox"}))
    moment = simulation.reset()
    assert rewards(moment) == {0: (0, 0), 1: (0, 0), 2: (0, 0)}
    assert rewards(answer(simulation, moment)) == {0: (0, 2), 1: (0, 2), 2: (5, 0)}


def test_unequal_rewards_of_a_group_are_each_ones_own(play):
    simulation = play(lambda: Together(rewards={"fox_0": 2.0, "fox_1": 1.0}), groups=frozenset({"fox"}))
    assert rewards(answer(simulation, simulation.reset())) == {0: (2, 0), 1: (1, 0), 2: (0, 0)}


def test_an_agent_that_just_came_has_no_part_in_what_the_group_got(play):
    simulation = play(
        lambda: Together({1: {"fox_1": "comes"}}, first=("fox_0",), rewards={"fox_0": 2.0, "fox_1": 7.0}),
        groups=frozenset({"fox"}),
    )
    assert rewards(answer(simulation, simulation.reset())) == {0: (0, 2), 1: (7, 0)}


def test_who_ended_and_who_goes_on_share_the_groups_reward(play):
    simulation = play(
        lambda: Together({1: {"fox_1": "terminated"}}, rewards={"fox_0": 2.0, "fox_1": 2.0}), groups={"fox"}
    )
    foxes = answer(simulation, simulation.reset())["fox?team=0"]
    assert foxes.ids.tolist() == [1, 0]
    assert (foxes.rewards.tolist(), foxes.group_rewards.tolist()) == ([0, 0], [2, 2])


def test_each_copy_and_behavior_is_a_group_of_its_own_if_all_are(play):
    simulation = play(num_areas=2, groups=frozenset({"*"}))
    moment = simulation.reset()
    assert moment["fox?team=0"].group_ids.tolist() == [1, 1, 3, 3]
    assert moment["hare?team=0"].group_ids.tolist() == [2, 4]
    assert play().reset()["fox?team=0"].group_ids.tolist() == [0, 0]


# Masks.


@pytest.mark.parametrize("mask", [np.array([0, 1, 1], np.int8), [0, 1, 1], (np.array([0, 1, 1]),)])
def test_an_infos_mask_is_of_its_agent_and_who_has_none_may_do_anything(mask, play):
    class Masked(Together):
        def info(self, agent):
            return {"action_mask": mask} if agent == "fox_1" else {}

    simulation = play(Masked)
    moment = simulation.reset()
    for _ in range(4):
        assert moment["fox?team=0"].deciding.masks[0].tolist() == [[False] * 3, [True, False, False]]
        assert moment["hare?team=0"].masks == ()
        moment = answer(simulation, moment)


def test_an_observed_mask_forbids_and_nobody_who_ended_is_forbidden_anything(play):
    class Observed(Together):
        def observation_space(self, agent):
            return spaces.Dict({"action_mask": spaces.MultiBinary(3), "observation": VECTOR})

        def reset(self, seed=None, options=None):
            seen, infos = super().reset(seed, options)
            return self.with_masks(seen), infos

        def step(self, actions):
            seen, *rest = super().step(actions)
            return (self.with_masks(seen), *rest)

        def with_masks(self, seen):
            return {
                who: {"action_mask": np.array([1, 1, 0], np.int8), "observation": what} for who, what in seen.items()
            }

    simulation = play(lambda: Observed(length=1))
    hares = answer(simulation, simulation.reset())["hare?team=0"]
    assert hares.done.tolist() == [True, False]
    assert hares.masks[0].tolist() == [[False] * 3, [False, False, True]]
    assert len(hares.observations) == 1


@pytest.mark.parametrize("mask", [np.ones(4), 1, {"a": [1]}])
def test_a_mask_that_cant_be_read_is_refused(mask, play):
    class Masked(Together):
        def info(self, agent):
            return {"action_mask": mask}

    with pytest.raises(SimulationError):
        play(Masked).reset()


# Turns.


class Turns:
    """Agents act one after the other; observes [episode, turn] in one array. An agent ends at its turn as it is told.

    ``ends`` says after how many turns of the game which agents end, and how.
    """

    def __init__(self, ends=None, agents=("a", "b"), first_ends=()):
        self.possible_agents, self.ends = (
            list(agents),
            {4: dict.fromkeys(agents, "terminated")} if ends is None else ends,
        )
        self.first_ends, self.seen, self.seeds = first_ends, np.zeros(2, np.float32), []

    unwrapped = property(lambda self: self)

    def observation_space(self, agent):
        return VECTOR

    def action_space(self, agent):
        return spaces.Discrete(3)

    def reset(self, seed=None, options=None):
        self.seeds.append(seed)
        self.agents, self.turn = list(self.possible_agents), 0
        self.over = dict.fromkeys(self.first_ends, "terminated")
        self.got = dict.fromkeys(self.agents, 0.0)
        self.agent_selection = self.agents[0]
        self.seen[:] = self.seen[0] + 1, 0

    def last(self):
        agent = self.agent_selection
        what = self.over.get(agent)
        return (
            self.seen,
            self.got[agent],
            what in ("terminated", "both"),
            what in ("truncated", "both"),
            self.info(agent),
        )

    def step(self, action):
        agent, at = self.agent_selection, self.agents.index(self.agent_selection)
        if agent in self.over:
            assert action is None
            self.seen[:] = self.seen[0], -1
            self.agents.remove(agent)
        else:
            self.turn += 1
            self.got[agent] = 0.0
            for other in self.agents:
                self.got[other] += 1 + action
            self.seen[:] = self.seen[0], self.turn
            self.over |= self.ends.get(self.turn, {})
            at += 1
        if self.agents:
            self.agent_selection = self.agents[at % len(self.agents)]

    def info(self, agent):
        return {"action_mask": np.array([agent == "a", 1, 1])}

    def close(self):
        pass


@pytest.fixture
def turns(play):
    def one(kind=Turns, **options):
        return play(kind, function="env", behaviors=(("player", re.compile(".*")),), **options)

    return one


def test_the_agent_whose_turn_it_is_asks_with_what_it_got_since_its_last_turn(turns):
    simulation = turns()
    moment = simulation.reset()
    assert not simulation.acts_when_idle
    assert asking(moment) == {"player": [0]}
    assert rewards(moment) == {0: (0, 0)}
    moment = answer(simulation, moment, choice=1)
    assert rewards(moment) == {1: (2, 0)}
    moment = answer(simulation, moment, choice=0)
    assert rewards(moment) == {0: (3, 0)}


def test_the_mask_is_of_the_agent_whose_turn_it_is(turns):
    simulation = turns()
    moment = simulation.reset()
    assert moment["player?team=0"].masks[0].tolist() == [[False, False, False]]
    assert answer(simulation, moment)["player?team=0"].masks[0].tolist() == [[True, False, False]]


def test_a_games_end_ends_every_agent_once_with_what_it_saw_and_the_next_game_begins(turns):
    simulation = turns()
    moment = simulation.reset()
    for _ in range(3):
        moment = answer(simulation, moment)
        assert ended(moment) == {}
    moment = answer(simulation, moment)
    assert ended(moment) == {0: ([1, 4], False), 1: ([1, -1], False)}
    assert asking(moment) == {"player": [0]}
    assert moment["player?team=0"].deciding.observations[0].tolist() == [[2, 0]]


def test_an_agent_that_dies_is_passed_and_the_others_go_on(turns):
    simulation = turns(
        lambda: Turns({1: {"b": "truncated"}, 3: {"a": "both", "c": "terminated"}}, agents=("a", "b", "c"))
    )
    moment = answer(simulation, simulation.reset())
    assert ended(moment) == {1: ([1, 1], True)}
    assert asking(moment) == {"player": [2]}
    moment = answer(simulation, moment)
    assert asking(moment) == {"player": [0]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {0, 2}


def test_agents_that_end_in_a_reset_are_passed_and_a_game_that_does_is_refused(turns):
    assert asking(turns(lambda: Turns(first_ends=("a",))).reset()) == {"player": [1]}
    with pytest.raises(SimulationError, match="The environment began an episode in which no agent acts"):
        turns(lambda: Turns(first_ends=("a", "b"))).reset()


def test_several_copies_take_their_turns_by_themselves(turns):
    simulation = turns(num_areas=2)
    envs(simulation)[1].ends = {1: {"a": "terminated", "b": "terminated"}}
    moment = simulation.reset()
    assert asking(moment) == {"player": [0, 2]}
    moment = answer(simulation, moment)
    assert ended(moment).keys() == {2, 3}
    assert asking(moment) == {"player": [1, 2]}


def test_an_action_goes_to_the_agent_that_asked_wherever_its_behavior_stands(play):
    """In one copy it is the first player's turn, in the other the second's: behaviors of their own."""

    class Telling(Turns):
        def step(self, action):
            self.told = [*getattr(self, "told", []), (self.agent_selection, action)]
            super().step(action)

    simulation = play(Telling, function="env", num_areas=2)
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


def test_an_agent_that_stays_after_its_end_would_be_passed_for_ever_and_is_refused(turns):
    class Staying(Turns):
        def step(self, action):
            if action is not None:
                super().step(action)

    simulation = turns(Staying)
    moment = simulation.reset()
    for _ in range(3):
        moment = answer(simulation, moment)
    with pytest.raises(SimulationError, match="Agent a ended, but is still one of agents after a step with None"):
        answer(simulation, moment)


def test_agents_that_take_turns_have_no_groups(turns):
    with pytest.raises(SimulationError, match="--group needs agents that act together, but those of mine take turns"):
        turns(groups=frozenset({"*"}))


def test_unitys_timing_sends_ends_alone_and_lets_nobody_act_idly_out_of_turn(turns):
    simulation = turns(lambda: Turns({1: {"a": "terminated", "b": "terminated"}}), num_areas=1)
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


def test_unitys_timing_lets_agents_that_act_together_act_once_after_a_reset(play):
    simulation = play()
    moment, _ = Apart(simulation).reset()
    assert moment["hare?team=0"].observations[0].tolist() == [[1, 1]]


# Environment parameters.


def test_a_declared_attribute_is_set_from_the_next_episode_on(play):
    simulation = play(num_areas=2, parameters=("gravity", "length"))
    answer(simulation, simulation.reset())
    simulation.set_parameter("gravity", 3.0)
    simulation.set_parameter("length", 1.2)
    assert [env.gravity for env in envs(simulation)] == [1, 1]
    simulation.reset()
    assert [env.gravity for env in envs(simulation)] == [3, 3]
    assert [env.length for env in envs(simulation)] == [1, 1]


def test_an_argument_is_set_by_making_the_environment_anew_deterministically(play):
    def drawn():
        simulation = play(arguments={"length": 1}, num_areas=2, seed=4)
        found = []
        for length in (1.0, 2.0, 1.0):
            simulation.set_parameter("length", length)
            answer(simulation, simulation.reset())
            assert {env.length for env in envs(simulation)} == {int(length)}
            found += [env.drawn[0] for env in envs(simulation)]
        return found

    first = drawn()
    assert first == drawn()
    assert len(set(first)) == 6  # also of an environment whose random numbers nobody can ask for


def test_a_sampler_draws_for_every_copy_and_episode(play):
    simulation = play(num_areas=2, parameters=("gravity",), arguments={"length": 1})
    simulation.set_parameter("gravity", Uniform(7, 1.0, 2.0))
    moment = simulation.reset()
    first = [env.gravity for env in envs(simulation)]
    answer(simulation, moment)
    assert len({*first, *(env.gravity for env in envs(simulation))}) == 4


def test_an_argument_that_changes_the_spaces_is_refused_and_fewer_agents_are_not(play):
    class Sized(Together):
        def __init__(self, count=3, size=2):
            super().__init__(agents=FOXES_AND_HARES[:count])
            self.size = size

        def observation_space(self, agent):
            return spaces.Box(-9, 9, (self.size,))

    simulation = play(Sized, arguments={"count": 3, "size": 2})
    simulation.reset()
    simulation.set_parameter("count", 2.0)
    assert asking(simulation.reset()) == {"fox": [0, 1]}
    simulation.set_parameter("size", 3.0)
    with pytest.raises(
        SimulationError, match=r"With count = 2, size = 3 the environment has other spaces than a trainer"
    ):
        simulation.reset()


def test_a_parameter_that_is_not_declared_is_refused(play):
    with pytest.raises(ValueError, match="'x' is no environment parameter here: none is declared"):
        play().set_parameter("x", 1.0)
    with pytest.raises(SimulationError, match="--parameters names 'plot', but the environment has no such number"):
        play(parameters=("plot",))


# Environments that fail.


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("__init__", r"mine.parallel_env can't be made \(ValueError: no fuel\)"),
        ("observation_space", r"mine doesn't say what its agents are \(ValueError: no fuel\)"),
        ("reset", r"mine failed in a reset \(ValueError: no fuel\)"),
        ("step", r"mine failed in a step \(ValueError: no fuel\)"),
    ],
)
def test_an_environment_that_raises_is_named_with_its_own_words(method, said, play):
    def failing(*arguments, **options):
        raise ValueError("no\nfuel")

    def run(simulation):
        answer(simulation, simulation.reset())

    with pytest.raises(SimulationError, match=said) as caught:
        run(play(type("Failing", (Together,), {method: failing})))
    assert isinstance(caught.value.__cause__, ValueError)


def test_an_environment_without_possible_agents_is_refused(play):
    class Unsaid(Together):
        possible_agents = property(lambda self: self.unsaid, lambda self, value: None)

    with pytest.raises(SimulationError, match=r"mine doesn't say what its agents are \(AttributeError"):
        play(Unsaid)


def test_an_environment_that_raises_when_it_is_closed_does_no_harm(play, caplog):
    class Unclosable(Together):
        def close(self):
            raise RuntimeError("never")

    play(Unclosable).close()
    assert "mine failed when it was closed (RuntimeError: never)." in caplog.text


@pytest.mark.parametrize(
    ("observation", "said"),
    [
        (np.array([0, np.nan]), r"gave agent 5 observation\[1\] = nan, but finite"),
        (np.array([-np.inf, 0]), r"gave agent 5 observation\[0\] = -inf, but finite"),
        (np.zeros(3), r"mine gave in a (reset|step) what can't be used \(ValueError"),
        (None, r"mine gave in a (reset|step) what can't be used"),
        ("here", r"mine gave in a (reset|step) what can't be used"),
    ],
)
@pytest.mark.parametrize("when", ["reset", "step"])
def test_an_observation_that_is_none_of_the_space_is_refused(observation, said, when, play):
    class Bad(Together):
        def reset(self, seed=None, options=None):
            seen, infos = super().reset(seed, options)
            return (seen | {"hare_0": observation} if when == "reset" and seed == 1 else seen), infos

        def step(self, actions):
            seen, *rest = super().step(actions)
            return (seen | {"hare_0": observation} if self.seeds[0] == 1 else seen, *rest)

    simulation = play(Bad, num_areas=2)
    with pytest.raises(SimulationError, match=said):
        answer(simulation, simulation.reset())


@pytest.mark.parametrize("reward", [np.nan, np.inf, -np.inf])
def test_a_reward_that_is_no_number_is_named(reward, play):
    simulation = play(lambda: Together(rewards={"hare_0": reward}))
    with pytest.raises(SimulationError, match=f"The environment gave agent 2 a reward = {reward}, but finite"):
        answer(simulation, simulation.reset())


def test_a_module_with_only_an_env_is_played_in_turns_and_one_with_neither_is_refused(monkeypatch):
    assert isinstance(PettingZooEnvironment("pettingzoo.classic.tictactoe_v3").area(), TurnsArea)
    with pytest.raises(
        SimulationError, match="--pettingzoo is 'json', but a module with parallel_env or env was expec"
    ):
        PettingZooEnvironment("json").area()
