"""Copies of a Gymnasium environment as agents: who asks, who ended, with what."""

import os

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from simulations.counting import VECTOR, Count, answer, only

from corridor_server.protocol.agents import ActionBatch
from corridor_server.simulations.gymnasium_simulation import GymnasiumEnvironment


def test_the_behavior_is_named_after_the_id_without_its_module(play_gymnasium):
    assert list(play_gymnasium("CartPole-v1").behaviors) == ["CartPole-v1?team=0"]
    assert list(play_gymnasium("gymnasium.envs.classic_control:CartPole-v1").behaviors) == ["CartPole-v1?team=0"]


def test_ids_are_the_copies_numbers_for_life(play_gymnasium):
    simulation = play_gymnasium(num_areas=3)
    assert only(simulation.reset()).ids.tolist() == [0, 1, 2]
    for step in range(1, 10):
        ended, asking = answer(simulation)
        assert asking.ids.tolist() == [0, 1, 2]
        assert ended.ids.tolist() == ([0, 1, 2] if step % 3 == 0 else [])
    assert only(simulation.reset()).ids.tolist() == [0, 1, 2]


def test_the_end_has_the_last_observation_and_reward_and_the_begun_episode_its_first_and_none(play_gymnasium):
    simulation = play_gymnasium()
    only(simulation.reset())
    answer(simulation)
    answer(simulation)
    ended, asking = answer(simulation, discrete=2)
    assert ended.observations[0][:, :2].tolist() == [[1, 3]] * 2
    assert ended.rewards.tolist() == [32, 32]
    assert asking.observations[0][:, :2].tolist() == [[2, 0]] * 2
    assert asking.rewards.tolist() == [0, 0]
    assert (asking.observations[0][:, 2] != ended.observations[0][:, 2]).all()


def test_only_copies_that_ended_begin_anew(play_gymnasium):
    simulation = play_gymnasium()
    simulation._copies.envs[1].unwrapped.length = 2
    simulation.reset()
    answer(simulation)
    ended, asking = answer(simulation, discrete=1)
    assert ended.ids.tolist() == [1]
    assert asking.observations[0][:, :2].tolist() == [[1, 2], [2, 0]]
    assert asking.rewards.tolist() == [21, 0]


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_only_copies_that_ended_begin_anew_with_all_parts_of_what_they_observe(mode, play_gymnasium):
    """In Gymnasium's processes every copy's last observation comes again with those that were reset."""

    class Parts(Count):
        observation_space = spaces.Tuple([VECTOR, spaces.Dict({"step": spaces.Discrete(9)})])

        def reset(self, *, seed=None, options=None):
            self.length = self.length if seed is None else 1 + seed  # another in each copy
            seen, info = super().reset(seed=seed, options=options)
            return (seen, {"step": 0}), info

        def step(self, action):
            seen, *rest = super().step(action)
            return ((seen, {"step": int(seen[1])}), *rest)

    simulation = play_gymnasium(Parts, mode=mode, seed=1, arguments={"ends": "truncated"})
    simulation.reset()
    answer(simulation)
    ended, asking = answer(simulation)
    assert ended.ids.tolist() == [0]
    assert [np.argmax(each.observations[1], axis=1).tolist() for each in (ended, asking)] == [[2], [0, 2]]
    assert asking.observations[0][:, :2].tolist() == [[2, 0], [1, 2]]


@pytest.mark.parametrize(("ends", "interrupted"), [("terminated", False), ("truncated", True), ("both", False)])
def test_an_end_is_interrupted_only_if_nothing_but_a_limit_ended_it(ends, interrupted, play_gymnasium):
    simulation = play_gymnasium(arguments={"ends": ends, "length": 1})
    simulation.reset()
    ended, asking = answer(simulation)
    assert ended.interrupted.tolist() == [interrupted] * 2
    assert not asking.interrupted.any()


def test_a_reset_keeps_an_episode_that_began_by_itself_and_has_not_moved(play_gymnasium):
    simulation = play_gymnasium(arguments={"length": 1})
    simulation.reset()
    _, asking = answer(simulation)
    kept = only(simulation.reset())
    assert np.array_equal(kept.observations[0], asking.observations[0])
    assert kept.observations[0][:, 0].tolist() == [2, 2]
    assert only(simulation.reset()).observations[0][:, 0].tolist() == [3, 3]


def test_a_reset_in_mid_episode_begins_one_without_an_end_but_where_one_just_began(play_gymnasium):
    simulation = play_gymnasium()
    simulation._copies.envs[1].unwrapped.length = 1
    simulation.reset()
    answer(simulation)
    begun = only(simulation.reset())
    assert begun.observations[0][:, :2].tolist() == [[2, 0], [2, 0]]
    assert not begun.done.any()
    assert begun.rewards.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("seed", "expected"),
    [(5, [5, 6]), (2**31 - 1, [2**31 - 1, 2**31]), (-1, [2**32 - 1, 0]), (-(2**31), [2**31, 2**31 + 1])],
)
def test_a_copys_seed_is_the_trainers_and_its_number_and_only_its_first_reset_has_it(seed, expected, play_gymnasium):
    simulation = play_gymnasium(seed=seed, arguments={"length": 1})
    simulation.reset()
    answer(simulation)
    seeds = [env.unwrapped.seeds for env in simulation._copies.envs]
    assert seeds == [[expected[0], None], [expected[1], None]]


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_it_is_the_environment_in_process_with_the_same_seeds(mode, play_gymnasium):
    simulation = play_gymnasium("CartPole-v1", seed=3, mode=mode)
    envs = [gymnasium.make("CartPole-v1") for _ in range(2)]
    expected, ends = np.array([env.reset(seed=3 + area)[0] for area, env in enumerate(envs)]), 0
    asking, rng = only(simulation.reset()), np.random.default_rng(0)
    for _ in range(60):
        assert np.array_equal(asking.observations[0], expected)
        choices = rng.integers(2, size=(2, 1), dtype=np.int32)
        moment, _ = simulation.step({"CartPole-v1?team=0": ActionBatch(np.zeros((2, 0), np.float32), choices)})
        ended, asking = only(moment).ended, only(moment).deciding
        last = {}
        for area, env in enumerate(envs):
            expected[area], reward, terminated, truncated, _ = env.step(int(choices[area, 0]))
            if terminated or truncated:
                last[area] = (expected[area].tolist(), reward)
                expected[area] = env.reset()[0]
        assert ended.ids.tolist() == list(last)
        assert [*zip(ended.observations[0].tolist(), ended.rewards.tolist(), strict=True)] == [*last.values()]
        ends += len(last)
    assert ends > 1


def test_rewards_and_ends_of_other_kinds_are_numbers_and_flags_as_well(play_gymnasium):
    class OneElement(Count):
        def step(self, action):
            seen, reward, terminated, truncated, info = super().step(action)
            return seen.tolist(), np.array([reward]), terminated, int(truncated), info

    simulation = play_gymnasium(OneElement)
    simulation.reset()
    assert answer(simulation)[1].rewards.tolist() == [10, 10]


def test_checking_makes_it_once_in_this_process_and_closes_it(register_gymnasium):
    pids = []

    class Noted(Count):
        def __init__(self):
            super().__init__()
            pids.append(os.getpid())

        def close(self):
            pids.append("closed")

    GymnasiumEnvironment(register_gymnasium(Noted), mode="async").check()
    assert pids == [os.getpid(), "closed"]


def test_many_copies_are_as_many_agents(play_gymnasium):
    simulation = play_gymnasium(num_areas=500, arguments={"length": 1})
    simulation.reset()
    ended, asking = answer(simulation)
    assert ended.ids.tolist() == asking.ids.tolist() == list(range(500))
