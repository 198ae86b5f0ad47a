"""What agents of a PettingZoo environment share, and what each of them may not do."""

import numpy as np
import pytest
from gymnasium import spaces
from simulations.foxes_and_hares import VECTOR, Together
from simulations.pettingzoo_moments import answer, rewards

from corridor_server.simulations.simulation import SimulationError

# Groups.


def test_a_reward_that_all_of_a_group_get_is_the_groups(play_pettingzoo):
    simulation = play_pettingzoo(
        lambda: Together(rewards={"fox_0": 2.0, "fox_1": 2.0, "hare_0": 5.0}), groups=frozenset({"fox"})
    )
    moment = simulation.reset()
    assert rewards(moment) == {0: (0, 0), 1: (0, 0), 2: (0, 0)}
    assert rewards(answer(simulation, moment)) == {0: (0, 2), 1: (0, 2), 2: (5, 0)}


def test_unequal_rewards_of_a_group_are_each_ones_own(play_pettingzoo):
    simulation = play_pettingzoo(lambda: Together(rewards={"fox_0": 2.0, "fox_1": 1.0}), groups=frozenset({"fox"}))
    assert rewards(answer(simulation, simulation.reset())) == {0: (2, 0), 1: (1, 0), 2: (0, 0)}


def test_an_agent_that_just_came_has_no_part_in_what_the_group_got(play_pettingzoo):
    simulation = play_pettingzoo(
        lambda: Together({1: {"fox_1": "comes"}}, first=("fox_0",), rewards={"fox_0": 2.0, "fox_1": 7.0}),
        groups=frozenset({"fox"}),
    )
    assert rewards(answer(simulation, simulation.reset())) == {0: (0, 2), 1: (7, 0)}


def test_who_ended_and_who_goes_on_share_the_groups_reward(play_pettingzoo):
    simulation = play_pettingzoo(
        lambda: Together({1: {"fox_1": "terminated"}}, rewards={"fox_0": 2.0, "fox_1": 2.0}), groups={"fox"}
    )
    foxes = answer(simulation, simulation.reset())["fox?team=0"]
    assert foxes.ids.tolist() == [1, 0]
    assert (foxes.rewards.tolist(), foxes.group_rewards.tolist()) == ([0, 0], [2, 2])


def test_each_copy_and_behavior_is_a_group_of_its_own_if_all_are(play_pettingzoo):
    simulation = play_pettingzoo(num_areas=2, groups=frozenset({"*"}))
    moment = simulation.reset()
    assert moment["fox?team=0"].group_ids.tolist() == [1, 1, 3, 3]
    assert moment["hare?team=0"].group_ids.tolist() == [2, 4]
    assert play_pettingzoo().reset()["fox?team=0"].group_ids.tolist() == [0, 0]


# Masks.


@pytest.mark.parametrize("mask", [np.array([0, 1, 1], np.int8), [0, 1, 1], (np.array([0, 1, 1]),)])
def test_an_infos_mask_is_of_its_agent_and_who_has_none_may_do_anything(mask, play_pettingzoo):
    class Masked(Together):
        def info(self, agent):
            return {"action_mask": mask} if agent == "fox_1" else {}

    simulation = play_pettingzoo(Masked)
    moment = simulation.reset()
    for _ in range(4):
        assert moment["fox?team=0"].deciding.masks[0].tolist() == [[False] * 3, [True, False, False]]
        assert moment["hare?team=0"].masks == ()
        moment = answer(simulation, moment)


def test_an_observed_mask_forbids_and_nobody_who_ended_is_forbidden_anything(play_pettingzoo):
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

    simulation = play_pettingzoo(lambda: Observed(length=1))
    hares = answer(simulation, simulation.reset())["hare?team=0"]
    assert hares.done.tolist() == [True, False]
    assert hares.masks[0].tolist() == [[False] * 3, [False, False, True]]
    assert len(hares.observations) == 1


@pytest.mark.parametrize("mask", [np.ones(4), 1, {"a": [1]}])
def test_a_mask_that_cant_be_read_is_refused(mask, play_pettingzoo):
    class Masked(Together):
        def info(self, agent):
            return {"action_mask": mask}

    with pytest.raises(SimulationError):
        play_pettingzoo(Masked).reset()
