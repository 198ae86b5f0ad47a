"""The vector path: slots, ends and SB3's contract, for players that order and number their agents as they like."""

import sys

import numpy as np
import pytest
from gymnasium import spaces
from mlagents_envs.base_env import ActionSpec
from mlagents_envs.side_channel.stats_side_channel import StatsAggregationMethod, StatsSideChannel
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from scripted import Scripted, spec
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor

from trainer.errors import TrainerError
from trainer.players.opening import open_environment
from trainer.players.vec_env import UnityVecEnv

CONTINUOUS = ActionSpec.create_continuous(1)


def slots(*messages: object, actions=CONTINUOUS, shapes=((1,),)) -> tuple[UnityVecEnv, Scripted]:
    environment = Scripted(spec(list(shapes), actions), list(messages))
    env = UnityVecEnv(environment)
    env.reset()
    return env, environment


def act(env: UnityVecEnv, *values: float):
    return env.step(np.array(values, np.float32).reshape(-1, 1))


def test_each_agent_has_a_slot_whatever_the_order_in_which_it_comes():
    env, environment = slots(({7: 0, 3: 0, 5: 0}, {}), ({5: 0.5, 7: 0.7, 3: 0.3}, {}), ({3: 1.3, 5: 1.5, 7: 1.7}, {}))
    observations, rewards, dones, _ = act(env, 0.7, 0.3, 0.5)
    assert observations[:, 0] == pytest.approx([7.01, 3.01, 5.01])
    assert rewards == pytest.approx([0.7, 0.3, 0.5])
    assert not dones.any()
    _, rewards, _, _ = act(env, 0.7, 0.3, 0.5)
    assert environment.sent[1].continuous[:, 0] == pytest.approx([0.5, 0.7, 0.3]), "in the order in which they asked"
    assert rewards == pytest.approx([1.7, 1.3, 1.5])


def test_an_ended_slot_shows_the_next_episode_and_its_info_the_last():
    env, _ = slots(({1: 0, 2: 0}, {}), ({3: 0, 2: 0.2}, {1: (-1.0, False)}))
    observations, rewards, dones, infos = act(env, 0, 0)
    assert observations[:, 0] == pytest.approx([3.01, 2.01])
    assert rewards == pytest.approx([-1.0, 0.2])
    assert dones.tolist() == [True, False]
    assert infos[0]["terminal_observation"] == pytest.approx([1.01])
    assert infos[0]["TimeLimit.truncated"] is False
    assert infos[1] == {}


def test_a_closed_environment_says_so_at_once():
    env, _ = slots(({1: 0, 2: 0}, {}))
    env.close()
    with pytest.raises(TrainerError, match="The environment is closed"):
        act(env, 0, 0)
    with pytest.raises(TrainerError, match="The environment is closed"):
        env.reset()


def test_slots_have_what_sb3_asks_for_and_nothing_else():
    env, environment = slots(({1: 0, 2: 0}, {}))
    assert [env.has_attr(name) for name in ("render_mode", "action_space", "no_such_attribute")] == [True, True, False]
    assert env.get_attr("render_mode") == [None, None]
    assert env.get_attr("observation_space", indices=[1]) == [env.observation_space]
    assert not is_masking_supported(env)
    for ask in (lambda: env.get_attr("no"), lambda: env.set_attr("no", 1), lambda: env.env_method("no", indices=0)):
        with pytest.raises(AttributeError, match="no"):
            ask()
    assert env.env_is_wrapped(Monitor) == [False, False]
    assert env.seed(3) == [None, None]  # as of environments that can't be seeded
    with pytest.warns(UserWarning, match="no `render_mode`"):
        assert env.render() is None
    env.close()
    assert environment.closed
    env.close()  # has no effect


def test_an_interrupted_episode_is_a_time_limits():
    env, _ = slots(({1: 0}, {}), ({2: 0}, {1: (0.0, True)}))
    assert act(env, 0)[3][0]["TimeLimit.truncated"] is True


def test_new_agents_take_the_ended_ones_slots_in_order():
    env, _ = slots(({1: 0, 2: 0, 3: 0}, {}), ({2: 0, 8: 0, 9: 0}, {3: (0.3, False), 1: (0.1, False)}))
    observations, rewards, dones, _ = act(env, 0, 0, 0)
    assert observations[:, 0] == pytest.approx([8.01, 2.01, 9.01])
    assert rewards == pytest.approx([0.1, 0.0, 0.3])
    assert dones.tolist() == [True, False, True]


def test_agents_that_keep_their_ids_keep_their_slots_whatever_the_order_in_which_they_come():
    env, environment = slots(
        ({1: 0, 2: 0, 3: 0}, {}),
        ({3: 0, 2: 0.2, 1: 0}, {3: (0.3, False), 1: (0.1, False)}),
        ({1: 1.1, 2: 1.2, 3: 1.3}, {}),
    )
    observations, rewards, dones, infos = act(env, 0, 0, 0)
    assert observations[:, 0] == pytest.approx([1.01, 2.01, 3.01])
    assert rewards == pytest.approx([0.1, 0.2, 0.3])
    assert dones.tolist() == [True, False, True]
    assert [info["terminal_observation"][0] for info in (infos[0], infos[2])] == pytest.approx([1.01, 3.01])
    _, rewards, dones, _ = act(env, 0.1, 0.2, 0.3)
    assert environment.sent[1].continuous[:, 0] == pytest.approx([0.3, 0.2, 0.1])
    assert rewards == pytest.approx([1.1, 1.2, 1.3])
    assert not dones.any()


def test_an_agent_that_keeps_its_id_keeps_its_slot_beside_one_that_is_followed_by_another():
    env, _ = slots(({1: 0, 2: 0, 3: 0}, {}), ({9: 0, 3: 0, 2: 0}, {1: (0.1, False), 3: (0.3, False)}))
    assert act(env, 0, 0, 0)[0][:, 0] == pytest.approx([9.01, 2.01, 3.01])


def test_an_end_that_comes_alone_is_of_the_agent_that_asks_in_the_next_message():
    env, environment = slots(({0: 0, 1: 0}, {}), ({}, {1: (-1.0, True)}), ({0: 0.2, 1: 0}, {}), ({0: 0.3, 1: 0.4}, {}))
    observations, rewards, dones, infos = act(env, 0, 0)
    assert observations[:, 0] == pytest.approx([0.02, 1.02])
    assert rewards == pytest.approx([0.2, -1.0])
    assert dones.tolist() == [False, True]
    assert infos[1]["terminal_observation"] == pytest.approx([1.01])
    assert act(env, 0, 0)[1] == pytest.approx([0.3, 0.4])
    assert len(environment.sent) == 2


def test_an_end_between_two_decisions_is_waited_through():
    """Unity sends an episode's end when it happens; the next request may come in a later message."""
    env, environment = slots(({1: 0, 2: 0}, {}), ({}, {1: (-1.0, False)}), ({3: 0, 2: 0.2}, {}))
    observations, rewards, dones, infos = act(env, 0.1, 0.2)
    assert observations[:, 0] == pytest.approx([3.02, 2.02])
    assert rewards == pytest.approx([-1.0, 0.2])
    assert dones.tolist() == [True, False]
    assert infos[0]["terminal_observation"] == pytest.approx([1.01])
    assert len(environment.sent) == 1


def test_vector_observations_are_put_one_after_another():
    env, _ = slots(({1: 0}, {}), shapes=((2,), (3,)))
    assert env.observation_space == spaces.Box(-np.inf, np.inf, (5,), np.float32)


@pytest.mark.parametrize(
    ("branches", "space", "action"),
    [((4,), spaces.Discrete(4), [3]), ((2, 3), spaces.MultiDiscrete([2, 3]), [[1, 2]])],
)
def test_discrete_actions(branches, space, action):
    env, environment = slots(({1: 0}, {}), ({1: 0}, {}), actions=ActionSpec.create_discrete(branches))
    assert env.action_space == space
    env.step(np.array(action))
    assert environment.sent[0].discrete.tolist() == np.array(action).reshape(1, -1).tolist()


def test_agents_that_do_not_decide_in_step_are_refused():
    env, _ = slots(({1: 0, 2: 0}, {}), ({1: 0}, {}))
    with pytest.raises(TrainerError, match="agents 1 asked for a decision, and of the others 2 neither"):
        act(env, 0, 0)


def test_an_agent_that_appears_from_nowhere_is_refused():
    env, _ = slots(({1: 0, 2: 0}, {}), ({1: 0, 9: 0}, {}))
    with pytest.raises(TrainerError, match="agents 1, 9 asked for a decision, and of the others 2 neither"):
        act(env, 0, 0)


def test_an_agent_that_ends_before_its_first_decision_is_no_episode():
    env, _ = slots(({1: 0, 2: 0}, {}), ({1: 0.1, 2: 0.2}, {5: (9.0, False)}), ({1: 0.3, 2: 0.4}, {}))
    _, rewards, dones, infos = act(env, 0, 0)
    assert rewards == pytest.approx([0.1, 0.2])
    assert (dones.any(), infos) == (False, [{}, {}])
    assert act(env, 0, 0)[1] == pytest.approx([0.3, 0.4])


def test_statistics_are_nobodys_while_an_agent_is_dropped():
    """The one value that came may be the dropped agent's as well as the ended one's."""
    statistics = StatsSideChannel()
    ends: dict[int, tuple[float, bool]] = {1: (0.0, True), 5: (0.0, False)}
    environment = Scripted(spec([(1,)], CONTINUOUS), [({1: 0}, {}), ({2: 0}, ends), ({3: 0}, {2: (0.0, False)})])
    env = UnityVecEnv(environment, statistics)
    env.reset()
    statistics.stats["Corridor/Success"].append((1.0, StatsAggregationMethod.AVERAGE))
    assert "is_success" not in act(env, 0)[3][0]
    statistics.stats["Corridor/Success"].append((1.0, StatsAggregationMethod.AVERAGE))
    assert act(env, 0)[3][0]["is_success"] is True


def test_messages_in_which_nobody_asks_yet_are_waited_through_after_a_reset():
    env, environment = slots(({}, {}), ({}, {4: (0.0, False)}), ({1: 0, 2: 0}, {}), ({}, {}), ({2: 0, 1: 0}, {}))
    assert env.num_envs == 2
    assert env.reset()[:, 0] == pytest.approx([2.04, 1.04])
    assert (environment.resets, environment.sent) == (2, [])


def test_other_observations_than_vectors_are_a_dict_of_all():
    env, _ = slots(
        ({1: 0, 2: 0}, {}), ({1: 0, 3: 0}, {2: (0.0, False)}), shapes=((4, 5, 3), (2,), (6, 2)), actions=CONTINUOUS
    )
    shapes = {"obs_0": (3, 4, 5), "obs_1": (2,), "obs_2": (6, 2)}
    assert {name: box.shape for name, box in env.observation_space.spaces.items()} == shapes
    observations, _, dones, infos = act(env, 0, 0)
    assert {name: part.shape for name, part in observations.items()} == {n: (2, *shape) for n, shape in shapes.items()}
    assert [part[1].max() for part in observations.values()] == pytest.approx([3.01] * 3)
    assert dones.tolist() == [False, True]
    assert {name: part.shape for name, part in infos[1]["terminal_observation"].items()} == shapes
    assert [part.max() for part in infos[1]["terminal_observation"].values()] == pytest.approx([2.01] * 3)


def test_a_groups_reward_is_added_once_to_the_agents_own():
    env, environment = slots(({1: 0, 2: 0}, {}), ({3: 9.0, 2: 0.5}, {1: (-1.0, False)}), ({3: 0.1, 2: 0.2}, {}))
    environment.group_reward = 0.25
    assert act(env, 0, 0)[1] == pytest.approx([-0.75, 0.75])
    assert act(env, 0, 0)[1] == pytest.approx([0.35, 0.45])


def test_masks_are_of_slots_as_sb3_contrib_asks_for_them():
    behavior = spec([(1,)], ActionSpec.create_discrete((2, 3)))
    messages = [({7: 0, 3: 0}, {}), ({3: 0, 7: 0}, {})]
    forbids = {7: [[False, False], [True, False, False]], 3: [[True, False], [False, False, False]]}
    env = UnityVecEnv(Scripted(behavior, messages, forbids=lambda agent, _: forbids[agent]))
    env.reset()
    assert is_masking_supported(env)
    for _ in messages:  # whatever the order in which they come
        assert get_action_masks(env).tolist() == [[True, True, False, True, True], [False, True, True, True, True]]
        assert env.env_method("action_masks", indices=1)[0].tolist() == [False, True, True, True, True]
        assert env.get_attr("action_masks", indices=[1])[0]().tolist() == [False, True, True, True, True]
        if env.environment.at == 0:
            env.step(np.array([[0, 1], [1, 0]]))
    masks_nothing, _ = slots(({1: 0}, {}), actions=ActionSpec.create_discrete((2, 3)))
    assert get_action_masks(masks_nothing).tolist() == [[True] * 5]


def test_both_kinds_of_actions_are_refused():
    with pytest.raises(TrainerError, match="2 continuous actions and 1 discrete branches"):
        slots(({1: 0}, {}), actions=ActionSpec(2, (3,)))


def test_a_nan_action_names_its_area():
    env, _ = slots(({1: 0, 2: 0}, {}))
    with pytest.raises(TrainerError, match=r"The action for area 1 is \[nan\]"):
        act(env, 0, float("nan"))


@pytest.mark.parametrize("timing", ["together", "unity"])
def test_our_player_in_slots_as_in_process_bit_for_bit(open_corridor, timing):
    import gymnasium

    areas, statistics = 5, StatsSideChannel()
    player = open_corridor(seed=2, num_areas=areas, side_channels=[statistics], env_args=["--decision-timing", timing])
    env = VecMonitor(UnityVecEnv(player, statistics))
    oracle = [gymnasium.make("corridor_server:Corridor-v0", area=area) for area in range(areas)]
    begun = np.array([each.reset(seed=2)[0] for each in oracle])
    if timing == "unity":  # acts once before the first request
        begun = np.array([each.step(np.zeros(2, np.float32))[0] for each in oracle])
    assert np.array_equal(env.reset(), begun)
    rng = np.random.default_rng(0)
    ended = 0
    unseen = [int(timing == "unity")] * areas  # steps of the episode before its first request
    for _ in range(600):
        actions = rng.uniform(-1, 1, (areas, 2)).astype(np.float32)
        observations, rewards, dones, infos = env.step(actions)
        for slot, each in enumerate(oracle):
            observation, reward, terminated, truncated, info = each.step(actions[slot])
            assert dones[slot] == (terminated or truncated)
            assert rewards[slot] == np.float32(reward)
            if dones[slot]:
                ended += 1
                assert np.array_equal(infos[slot]["terminal_observation"], observation)
                assert infos[slot]["is_success"] == info["is_success"]
                expected = {name: np.float32(value) for name, value in info["statistics"].items()}
                assert infos[slot]["statistics"] == expected
                assert infos[slot]["episode"]["l"] == info["statistics"]["Corridor/Episode Length"] - unseen[slot]
                unseen[slot] = 0
                observation, _ = each.reset()
            assert np.array_equal(observations[slot], observation)
    assert ended > 3


PLAIN_PLAYER = """#!{python}
import sys
from corridor_server.protocol import columnar
columnar.read_step = lambda *arguments: None  # reads as protobuf does
import corridor_server.protocol.wire as wire
output = wire.output
def as_protobuf_writes(*arguments):
    message = wire.UnityMessageProto.FromString(output(*arguments))
    return message.SerializeToString()
wire.output = as_protobuf_writes
from corridor_server.main import main
sys.exit(main())
"""


def test_a_player_that_writes_as_protobuf_does_is_read_the_same(tmp_path, free_port):
    """Unity's messages have no rows of one length: the general parser takes them, to the same arrays."""
    path = tmp_path / "player"
    path.write_text(PLAIN_PLAYER.format(python=sys.executable))
    path.chmod(0o755)
    seen = []
    for env in ("builtin", str(path)):
        environment = open_environment(env, seed=6, num_areas=6, port=free_port, timeout_wait=30)
        vec_env, generator = UnityVecEnv(environment), np.random.default_rng(0)
        steps = [vec_env.reset()]
        for _ in range(400):
            observations, rewards, dones, _ = vec_env.step(generator.uniform(-1, 1, (6, 2)).astype(np.float32))
            steps += [observations, rewards, dones]
        vec_env.close()
        seen.append(steps)
    assert sum(step.sum() for step in seen[0][3::3]) > 0, "no episode ended"
    assert all(np.array_equal(one, other) for one, other in zip(*seen, strict=True))
