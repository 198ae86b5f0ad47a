"""UnityToGymWrapper: Unity's name, arguments and checks, Gymnasium's five-tuple."""

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from mlagents_envs.base_env import ActionSpec
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from scripted import Scripted, spec
from stable_baselines3.common.env_checker import check_env as check_sb3_env
from stable_baselines3.common.vec_env import DummyVecEnv

from trainer.players.gym_wrapper import UnityGymException, UnityToGymWrapper

CONTINUOUS = ActionSpec.create_continuous(2)
ONE: tuple[dict[int, float], dict[int, tuple[float, bool]]] = ({1: 0.0}, {})


def wrap(
    *messages: object, shapes=((3,),), actions=CONTINUOUS, **options: object
) -> tuple[UnityToGymWrapper, Scripted]:
    environment = Scripted(spec(list(shapes), actions), [ONE, *messages])
    return UnityToGymWrapper(environment, **options), environment


def test_a_step_gives_observation_reward_and_no_end():
    env, environment = wrap(({1: 0.5}, {}))
    first, _ = env.reset()
    assert first == pytest.approx([1.0, 1.0, 1.0])
    observation, reward, terminated, truncated, info = env.step([0.25, -1.0])
    assert observation == pytest.approx([1.01, 1.01, 1.01])
    assert (reward, terminated, truncated) == (0.5, False, False)
    assert len(info["step"]) == 1
    assert environment.sent[0].continuous.tolist() == [[0.25, -1.0]]


@pytest.mark.parametrize("interrupted", [False, True])
def test_an_interrupted_end_is_truncated_and_any_other_terminated(interrupted):
    env, _ = wrap(({2: 0.0}, {1: (-1.0, interrupted)}))
    env.reset()
    observation, reward, terminated, truncated, _ = env.step([0.0, 0.0])
    assert observation == pytest.approx([1.01, 1.01, 1.01]), "the ended agent's, not its successor's"
    assert (reward, terminated, truncated) == (-1.0, not interrupted, interrupted)


def test_stepping_on_after_an_end_is_refused():
    env, _ = wrap(({2: 0.0}, {1: (0.0, False)}))
    env.reset()
    env.step([0.0, 0.0])
    with pytest.raises(UnityGymException, match="call reset"):
        env.step([0.0, 0.0])


def test_the_first_reset_uses_the_episode_that_construction_began():
    env, environment = wrap(ONE)
    env.reset()
    assert environment.resets == 1
    env.reset()
    assert environment.resets == 2


def test_a_player_that_is_silent_for_a_message_is_waited_for():
    env, _ = wrap(({}, {}), ({1: 2.0}, {}))
    env.reset()
    assert env.step([0.0, 0.0])[1] == 2.0


def test_one_discrete_branch_is_discrete():
    env, environment = wrap(ONE, actions=ActionSpec.create_discrete((4,)))
    env.reset()
    env.step(3)
    assert env.action_space == spaces.Discrete(4)
    assert environment.sent[0].discrete.tolist() == [[3]]


def test_branches_are_multi_discrete_or_flattened():
    branched, _ = wrap(actions=ActionSpec.create_discrete((2, 3)))
    assert branched.action_space == spaces.MultiDiscrete([2, 3])
    flat, environment = wrap(ONE, actions=ActionSpec.create_discrete((2, 3)), flatten_branched=True)
    assert flat.action_space == spaces.Discrete(6)
    flat.reset()
    flat.step(5)
    assert environment.sent[0].discrete.tolist() == [[1, 2]]
    for action in (6, -1, "a", None):
        with pytest.raises(UnityGymException, match="0 to 5 was expected|numbers of shape"):
            flat.step(action)


def test_a_visual_observation_comes_before_the_vector_and_alone():
    env, _ = wrap(shapes=((3,), (4, 5, 3)))
    observation, _ = env.reset()
    assert observation.shape == (4, 5, 3)
    assert (env.render() == 255).all()


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_a_picture_of_any_channels_is_drawn_in_three(channels):
    env, _ = wrap(shapes=((4, 6, channels),))
    env.reset()
    assert env.render().shape == (4, 6, 3)


def test_all_observations_are_a_tuple_with_the_vectors_last():
    env, _ = wrap(shapes=((3,), (4, 5, 3), (2,)), allow_multiple_obs=True)
    image, vector = env.reset()[0]
    assert (image.shape, vector.shape) == ((4, 5, 3), (5,))
    assert isinstance(env.observation_space, spaces.Tuple)


def test_buffers_stand_between_pictures_and_vectors_and_are_never_left_out_silently(caplog):
    shapes = ((3,), (6, 2), (4, 5, 3), (7, 1))
    env, _ = wrap(shapes=shapes, allow_multiple_obs=True)
    observation, _ = env.reset()
    assert [part.shape for part in observation] == [(4, 5, 3), (6, 2), (7, 1), (3,)]
    assert env.observation_space.contains(observation)
    assert not caplog.records
    env, _ = wrap(shapes=((3,), (6, 2)))
    assert env.reset()[0].shape == (3,)
    assert "several observations (observation 0 (3,), observation 1 (6, 2)), of which only the vector" in caplog.text


def test_a_buffer_alone_is_the_observation():
    env, _ = wrap(shapes=((6, 2),))
    observation, _ = env.reset()
    assert observation.shape == (6, 2)
    assert env.observation_space.contains(observation)


def test_uint8_visual_scales_pixels_and_nothing_else():
    env, _ = wrap(ONE, shapes=((4, 5, 3),), uint8_visual=True)
    observation, _ = env.reset()
    assert observation.dtype == np.uint8
    assert (observation == 255).all()
    assert env.observation_space == spaces.Box(0, 255, (4, 5, 3), np.uint8)
    with pytest.raises(UnityGymException, match="values from 0 to 1.01, but for uint8_visual 0 to 1 were expected"):
        env.reset()


def test_the_action_space_is_seeded():
    first, second = wrap(action_space_seed=3)[0], wrap(action_space_seed=3)[0]
    assert np.array_equal(first.action_space.sample(), second.action_space.sample())


def test_several_agents_are_refused():
    environment = Scripted(spec([(3,)], CONTINUOUS), [({1: 0.0, 2: 0.0}, {})])
    with pytest.raises(UnityGymException, match="has 2 agents"):
        UnityToGymWrapper(environment)
    assert environment.closed


def test_several_agents_that_take_turns_are_refused():
    env, _ = wrap(({0: 0.0}, {}), ONE)
    env.reset()
    with pytest.raises(UnityGymException, match="Agent 0 asks .* agent 1 goes on: .* several agents that take turns"):
        env.step([0.0, 0.0])


def test_an_id_may_be_an_agents_for_life_or_new_for_each_episode():
    env, _ = wrap(({}, {1: (0.0, False)}), ONE, ({7: 0.0}, {1: (0.0, False)}), ({7: 0.0}, {}), ({7: 0.5}, {}))
    env.reset()
    assert env.step([0.0, 0.0])[2]
    env.reset()
    assert env.step([0.0, 0.0])[2]
    env.reset()
    assert env.step([0.0, 0.0])[1] == 0.5


def test_an_agent_that_ends_before_its_first_decision_is_no_episode():
    env, _ = wrap(({}, {5: (9.0, False)}), ({1: 0.5}, {}), ({}, {5: (9.0, False), 1: (-1.0, True)}))
    env.reset()
    assert env.step([0.0, 0.0])[1:4] == (0.5, False, False)
    observation, reward, terminated, truncated, _ = env.step([0.0, 0.0])
    assert (reward, terminated, truncated) == (-1.0, False, True)
    assert observation == pytest.approx([1.03, 1.03, 1.03])


def test_both_kinds_of_actions_are_a_tuple():
    env, environment = wrap(ONE, actions=ActionSpec(2, (3, 4)))
    env.reset()
    assert env.action_space == spaces.Tuple((spaces.Box(-1, 1, (2,), np.float32), spaces.MultiDiscrete([3, 4])))
    env.step(([0.5, -0.5], [2, 1]))
    assert environment.sent[0].continuous.tolist() == [[0.5, -0.5]]
    assert environment.sent[0].discrete.tolist() == [[2, 1]]


def test_no_observation_and_no_action_are_refused():
    with pytest.raises(UnityGymException, match="no observation"):
        wrap(shapes=())
    with pytest.raises(UnityGymException, match="no action"):
        wrap(actions=ActionSpec(0, ()))


def test_a_groups_reward_is_added_once_to_the_agents_own():
    env, environment = wrap(({1: 0.5}, {}), ({}, {1: (-1.0, False)}))
    environment.group_reward = 0.25
    env.reset()
    assert env.step([0.0, 0.0])[1] == 0.75
    assert env.step([0.0, 0.0])[1] == -0.75


def masking(agent: int, message: int) -> list[list[bool]]:
    return [[False, message == 1], [True, False, False]]


def test_masks_are_what_is_allowed_now_as_sb3_contrib_asks_for_them():
    behavior = spec([(3,)], ActionSpec.create_discrete((2, 3)))
    env = UnityToGymWrapper(Scripted(behavior, [ONE, ONE, ({}, {1: (0.0, False)})], forbids=masking))
    with pytest.raises(UnityGymException, match="No episode is running"):
        env.action_masks()
    env.reset()
    assert is_masking_supported(env)
    assert get_action_masks(env).tolist() == [True, True, False, True, True]
    env.step([0, 1])
    assert get_action_masks(env).tolist() == [True, False, False, True, True]
    env.step([0, 1])
    with pytest.raises(UnityGymException, match="No episode is running"):
        env.action_masks()


def test_who_masks_nothing_allows_everything_and_continuous_actions_have_no_masks():
    env, _ = wrap(ONE, actions=ActionSpec.create_discrete((2, 3)))
    env.reset()
    assert env.action_masks().tolist() == [True] * 5
    continuous, _ = wrap()
    assert not is_masking_supported(continuous)
    assert not is_masking_supported(DummyVecEnv([lambda: continuous]))


def test_a_flattened_choice_is_allowed_if_all_of_its_parts_are():
    behavior = spec([(3,)], ActionSpec.create_discrete((2, 3)))
    env = UnityToGymWrapper(Scripted(behavior, [ONE, ONE], forbids=masking), flatten_branched=True)
    env.reset()
    assert env.action_masks().tolist() == [False, True, True, False, True, True]
    env.step(1)
    assert env.action_masks().tolist() == [False, True, True, False, False, False]


def test_a_nan_action_is_refused():
    env, _ = wrap()
    env.reset()
    with pytest.raises(UnityGymException, match="finite numbers were expected"):
        env.step([float("nan"), 0.0])


def test_closing_closes_the_environment():
    env, environment = wrap()
    env.close()
    assert environment.closed
    env.close()  # has no effect
    with pytest.raises(UnityGymException, match="The environment is closed"):
        env.step([0.0, 0.0])


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_our_player_wrapped_passes_gymnasiums_and_sb3s_checks(open_corridor):
    """A player is seeded at launch, so reset(seed) can't bring an episode back, and the environment says so."""
    env = UnityToGymWrapper(open_corridor())
    check_sb3_env(env)
    env.reset(seed=3)
    assert env.np_random_seed == 3
    observation, _ = env.reset()
    assert env.observation_space.contains(observation)
    assert env.observation_space.contains(env.step(env.action_space.sample())[0])
    check_env(env)  # closes it


def test_through_the_wrapper_as_in_process_bit_for_bit(open_corridor):
    import gymnasium

    env, oracle = UnityToGymWrapper(open_corridor(seed=4)), gymnasium.make("corridor_server:Corridor-v0")
    rng = np.random.default_rng(1)
    assert np.array_equal(env.reset()[0], oracle.reset(seed=4)[0])
    episodes = 0
    for _ in range(1500):
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        ours, expected = env.step(action), oracle.step(action)
        assert np.array_equal(ours[0], expected[0])
        assert ours[1:4] == expected[1:4]
        if ours[2] or ours[3]:
            episodes += 1
            assert np.array_equal(env.reset()[0], oracle.reset()[0])
    assert episodes > 1
