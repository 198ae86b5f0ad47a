"""What a Gymnasium environment forbids, told in its info or observed."""

import numpy as np
import pytest
from gymnasium import spaces
from simulations.counting import VECTOR, Count, answer, only

from corridor_server.simulations.simulation import SimulationError


def masked(*given):
    """An environment whose info holds these in turn, from reset on; None holds none."""

    class Masked(Count):
        action_space = spaces.MultiDiscrete([2, 3])

        def step(self, action):
            return super().step(0)

        def info(self):
            self.told = getattr(self, "told", -1) + 1
            mask = given[self.told % len(given)]
            return {} if mask is None else {"action_mask": mask}

    return Masked


FORBIDDEN = [[[False, True]], [[True, False, False]]]
ALLOWED = [[[False, False]], [[False, False, False]]]


@pytest.mark.parametrize(
    "mask",
    [
        np.array([1, 0, 0, 1, 1], np.int8),
        [True, False, False, True, True],
        (np.array([1, 0], np.int8), np.array([0, 1, 1], np.int8)),
        [[1, 0], [0, 1, 1]],
    ],
)
def test_an_infos_mask_forbids_whether_it_is_one_array_or_one_per_branch(mask, play_gymnasium):
    simulation = play_gymnasium(masked(mask), num_areas=1, mode="async" if isinstance(mask, tuple) else "sync")
    assert [each.tolist() for each in only(simulation.reset()).masks] == FORBIDDEN
    assert [each.tolist() for each in answer(simulation)[1].masks] == FORBIDDEN


def test_who_gives_a_mask_only_sometimes_or_late_may_do_anything_without_one(play_gymnasium):
    simulation = play_gymnasium(masked(None, np.array([1, 0, 0, 1, 1]), None), num_areas=1)
    assert only(simulation.reset()).masks == ()
    assert [each.tolist() for each in answer(simulation)[1].masks] == FORBIDDEN
    assert [each.tolist() for each in answer(simulation)[1].masks] == ALLOWED


def test_a_first_mask_that_comes_as_an_episode_begins_forbids_those_that_ended_nothing(play_gymnasium):
    simulation = play_gymnasium(masked(None, None, None, np.array([1, 0, 0, 1, 1])), num_areas=1)
    simulation._copies.envs[0].unwrapped.length = 2
    assert only(simulation.reset()).masks == answer(simulation)[1].masks == ()
    ended, asking = answer(simulation)
    assert [each.tolist() for each in ended.masks] == ALLOWED
    assert [each.tolist() for each in asking.masks] == FORBIDDEN


def test_a_mask_of_none_is_none(play_gymnasium):
    class Nothing(Count):
        def info(self):
            return {"action_mask": None}

    assert only(play_gymnasium(Nothing).reset()).masks == ()


def test_a_mask_is_of_its_own_copy_and_its_running_episode(play_gymnasium):
    """Copies end at different steps; those that go on keep their masks when another begins."""

    class ByStep(Count):
        def info(self):
            mask = np.ones(3, np.int8)
            mask[int(self.seen[1])] = 0
            return {"action_mask": mask}

    simulation = play_gymnasium(ByStep)
    simulation._copies.envs[1].unwrapped.length = 2
    assert np.argmax(only(simulation.reset()).masks[0], axis=1).tolist() == [0, 0]
    assert np.argmax(answer(simulation)[1].masks[0], axis=1).tolist() == [1, 1]
    ended, asking = answer(simulation)
    assert not ended.masks[0].any()  # nobody chooses any more
    assert np.argmax(asking.masks[0], axis=1).tolist() == [2, 0]


def test_an_observed_mask_forbids_and_is_no_observation(play_gymnasium):
    class Observed(Count):
        observation_space = spaces.Dict({"action_mask": spaces.Box(0, 1, (3,), np.int8), "seen": VECTOR})

        def reset(self, **options):
            return {"action_mask": np.array([0, 1, 1], np.int8), "seen": super().reset(**options)[0]}, {}

    agents = only(play_gymnasium(Observed).reset())
    assert agents.masks[0].tolist() == [[True, False, False]] * 2
    assert [each.shape for each in agents.observations] == [(2, 3)]


def test_a_mask_without_choices_says_nothing(play_gymnasium):
    class NoChoice(Count):
        action_space = spaces.Box(-1, 1, (2,))
        observation_space = spaces.Dict({"action_mask": spaces.MultiBinary(3), "seen": VECTOR})

        def reset(self, **options):
            return {"action_mask": np.ones(3, np.int8), "seen": super().reset(**options)[0]}, self.info()

        def info(self):
            return {"action_mask": np.ones(2)}

    assert only(play_gymnasium(NoChoice).reset()).masks == ()


def test_a_mask_that_forbids_everything_is_refused_but_at_the_end(play_gymnasium):
    class Stuck(Count):
        def info(self):
            return {"action_mask": np.full(3, self.seen[1] != 1)}

    simulation = play_gymnasium(Stuck, arguments={"length": 1})
    simulation.reset()
    answer(simulation)
    simulation._copies.envs[1].unwrapped.length = 2
    with pytest.raises(SimulationError, match=r"gave agent 1 an action_mask that forbids all .* branch 0"):
        answer(simulation)


@pytest.mark.parametrize("mask", [np.ones(4), 1, {"a": [1]}, "everything"])
def test_a_mask_that_cant_be_read_is_refused(mask, play_gymnasium):
    with pytest.raises(SimulationError):
        play_gymnasium(masked(mask)).reset()


def test_whatever_else_an_info_holds_does_no_harm(play_gymnasium):
    """Gymnasium's batches of infos want all copies' arrays to have one shape."""

    class Odd(Count):
        def info(self):
            self.told = getattr(self, "told", 0) + 1
            return {
                "path": np.zeros(self.told * int(100 * self.seen[2])),
                "x": None if self.told % 2 else 3,
                "f": print,
            }

    simulation = play_gymnasium(Odd)
    simulation.reset()
    assert len(answer(simulation)[1]) == 2
