"""``UnityVectorEnv``: Gymnasium's vector environment, held against Gymnasium's own in process."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics
from mlagents_envs.base_env import ActionSpec
from mlagents_envs.side_channel.stats_side_channel import StatsAggregationMethod, StatsSideChannel
from scripted import Scripted, spec
from simulations.zoo import SEED, served

from trainer.errors import TrainerError
from trainer.players.vector_env import UnityVectorEnv

AREAS = 3


def in_process(name: str) -> SyncVectorEnv:
    return SyncVectorEnv([lambda: gymnasium.make(name)] * AREAS, autoreset_mode=AutoresetMode.SAME_STEP)


def test_cartpole_served_is_gymnasiums_own_to_the_bit(free_port, tmp_path):
    oracle = RecordEpisodeStatistics(in_process("CartPole-v1"))
    with served(free_port, tmp_path, "--gym", "CartPole-v1", num_areas=AREAS) as environment:
        env = RecordEpisodeStatistics(UnityVectorEnv(environment))
        assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        assert (env.num_envs, env.action_space) == (AREAS, oracle.action_space)
        assert env.single_observation_space.shape == oracle.single_observation_space.shape
        assert data_equivalence(env.reset()[0], oracle.reset(seed=SEED)[0], exact=True)
        env.action_space.seed(0)
        for _ in range(400):
            actions = env.action_space.sample()
            (*ours, infos), (*expected, expected_infos) = env.step(actions), oracle.step(actions)
            for one, other in zip(ours, expected, strict=True):
                assert np.array_equal(one, other)
            assert env.observation_space.contains(ours[0])
            assert ("final_obs" in infos) == ("final_obs" in expected_infos)
            if "final_obs" in infos:
                assert np.array_equal(infos["_final_obs"], expected_infos["_final_obs"])
                for one, other in zip(infos["final_obs"], expected_infos["final_obs"], strict=True):
                    assert (one is None) == (other is None)
                    assert one is None or np.array_equal(one, other)
                assert np.array_equal(infos["_final_info"], expected_infos["_final_info"])
                for key in ("r", "l"):
                    assert np.array_equal(infos["episode"][key], expected_infos["episode"][key])
        assert env.episode_count == oracle.episode_count > 10
    oracle.close()


def test_taxis_masks_are_those_of_the_episode_that_is_shown(free_port, tmp_path):
    oracle = in_process("Taxi-v4")
    with served(free_port, tmp_path, "--gym", "Taxi-v4", num_areas=AREAS) as environment:
        env = DictInfoToList(UnityVectorEnv(environment))
        ours, expected = env.reset()[1], DictInfoToList(oracle).reset(seed=SEED)[1]
        env.action_space.seed(0)
        for _ in range(250):  # over a step limit
            for one, other in zip(ours, expected, strict=True):
                assert np.array_equal(one["action_mask"], other["action_mask"])
            actions = env.action_space.sample()
            *_, truncated, ours = env.step(actions)
            *_, expected = DictInfoToList(oracle).step(actions)
            if truncated.any():
                assert all("final_obs" in info for info in ours)
                break
        assert truncated.all()
    oracle.close()


def vector(*messages, actions: ActionSpec = ActionSpec.create_continuous(1), shapes=((1,),)):  # noqa: B008
    environment, statistics = Scripted(spec(list(shapes), actions), list(messages)), StatsSideChannel()
    return UnityVectorEnv(environment, statistics), environment, statistics


def test_an_interrupted_end_is_truncated_and_any_other_terminated_with_what_was_reported():
    env, environment, statistics = vector(
        ({1: 0, 2: 0, 3: 0}, {}), ({1: 0, 4: 0, 3: 0.5}, {1: (1.0, True), 2: (-1.0, False)})
    )
    environment.group_reward = 0.25
    env.reset()
    for value in (1.0, 0.0):
        statistics.stats["Corridor/Success"].append((value, StatsAggregationMethod.AVERAGE))
    observations, rewards, terminations, truncations, infos = env.step(np.zeros((3, 1), np.float32))
    assert observations[:, 0] == pytest.approx([1.01, 4.01, 3.01])
    assert rewards == pytest.approx([1.25, -0.75, 0.75])
    assert terminations.tolist() == [False, True, False]
    assert truncations.tolist() == [True, False, False]
    assert [None if each is None else each.tolist() for each in infos["final_obs"]] == [
        pytest.approx([1.01]),
        pytest.approx([2.01]),
        None,
    ]
    assert infos["final_info"]["is_success"].tolist() == [True, False, False]
    assert infos["final_info"]["_is_success"].tolist() == [True, True, False]


def test_all_kinds_of_observations_and_actions():
    env, environment, _ = vector(
        ({1: 0, 2: 0}, {}), ({2: 0}, {1: (0.0, True)}), ({1: 0, 2: 0}, {}),
        actions=ActionSpec(2, (3, 4)), shapes=((4, 5, 3), (2,), (6, 2)),
    )  # fmt: skip
    assert env.observation_space["obs_0"].shape == (2, 4, 5, 3)
    assert env.observation_space.contains({**env.reset()[0], "obs_0": np.zeros((2, 4, 5, 3), np.float32)})
    assert isinstance(env.single_action_space, spaces.Tuple)
    numbers, choices = env.action_space.sample()
    environment.messages[1] = environment.messages[2]
    infos = env.step((numbers, choices))[4]
    assert np.array_equal(environment.sent[0].continuous, numbers)
    assert np.array_equal(environment.sent[0].discrete, choices)
    assert isinstance(env.single_action_space.sample(infos["action_mask"][1]), tuple)
    assert [branch.tolist() for branch in infos["action_mask"][1][1]] == [[1] * 3, [1] * 4]


def test_a_reset_is_of_all_agents_or_of_none():
    env, environment, _ = vector(({1: 0, 2: 0}, {}), ({1: 0, 2: 0}, {}))
    env.reset(seed=3, options={"reset_mask": np.array([True, True])})
    assert env.np_random_seed == 3
    for mask in (np.array([True, False]), np.array([True] * 3), np.ones(2), [True, True], "x", None):
        with pytest.raises(TrainerError, match="reset_mask is .* but an array of 2 bools, True for every agent"):
            env.reset(options={"reset_mask": mask})
    with pytest.raises(TrainerError, match="options is 'x', but a dict or None was expected"):
        env.reset(options="x")
    env.close()
    assert environment.closed
    env.close()  # has no effect
    with pytest.raises(TrainerError, match="The environment is closed"):
        env.step(np.zeros((2, 1), np.float32))


def test_an_environment_that_is_refused_is_closed():
    environment = Scripted(spec([(1,)], ActionSpec(0, ())), [({1: 0}, {})])
    with pytest.raises(TrainerError, match="has no action"):
        UnityVectorEnv(environment)
    assert environment.closed
