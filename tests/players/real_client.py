"""Holds our player against a real ML-Agents client, whichever this interpreter has; prints a sentence a line, as JSON.

``python real_client.py PLAYER PORT``. Runs under Unity's published 1.1.0 on Python 3.10 as under 0.28.0 on a current
Python, so it imports nothing of ours but, where there is one, the message classes.
"""

import hashlib
import json
import sys
import warnings

import numpy as np

try:
    import trainer  # noqa: F401 - message classes for a current protobuf
except ImportError:
    pass
import mlagents_envs.registry

mlagents_envs.registry.default_registry = {}  # importing mlagents_envs.envs must not fetch a manifest
from mlagents_envs.base_env import ActionTuple
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.engine_configuration_channel import EngineConfigurationChannel
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel

try:
    from mlagents_envs.envs.unity_gym_env import UnityToGymWrapper
except ImportError:
    from trainer.players.gym_wrapper import UnityToGymWrapper

PLAYER, PORT = sys.argv[1], int(sys.argv[2])
BEHAVIOR = "Corridor?team=0"


class NotApplicable(Exception):
    """This client has no such thing."""


def opened(channels=(), arguments=(), **options):
    return UnityEnvironment(
        PLAYER,
        base_port=PORT,
        no_graphics=True,
        timeout_wait=30,
        side_channels=list(channels),
        additional_args=list(arguments),
        **options,
    )


def step(environment, generator):
    count = len(environment.get_steps(BEHAVIOR)[0])
    actions = generator.uniform(-1, 1, (count, 2)).astype(np.float32)
    environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
    environment.step()
    return environment.get_steps(BEHAVIOR)


def the_behavior_is_introduced_with_its_specs():
    environment = opened()
    environment.reset()
    spec = environment.behavior_specs[BEHAVIOR]
    assert [observation.shape for observation in spec.observation_specs] == [(13,)]
    assert spec.observation_specs[0].name == "VectorSensor_size13"
    assert spec.action_spec.continuous_size == 2
    environment.close()


def areas_and_seed_are_the_trainers_and_equal_seeds_give_equal_episodes():
    """Also tells the digest of a trajectory, to be compared between clients."""
    digests = set()
    for _ in range(2):
        environment, digest = opened(seed=9, num_areas=3), hashlib.sha256()
        environment.reset()
        generator = np.random.default_rng(0)
        assert len(environment.get_steps(BEHAVIOR)[0]) == 3
        for _ in range(300):
            decision, terminal = step(environment, generator)
            for steps in (decision, terminal):
                digest.update(np.ascontiguousarray(steps.obs[0], np.float32).tobytes())
                digest.update(np.ascontiguousarray(steps.reward, np.float32).tobytes())
                digest.update(np.ascontiguousarray(steps.agent_id, np.int32).tobytes())
        environment.close()
        digests.add(digest.hexdigest())
    assert len(digests) == 1
    return digests.pop()


def an_agent_keeps_its_id_and_asks_again_in_the_message_that_has_its_end():
    assert messages_and_ends("together") == (800, True)


def in_unitys_timing_an_end_comes_alone_and_its_agent_asks_in_the_next_message():
    count, together = messages_and_ends("unity")
    assert count > 800
    assert not together


def messages_and_ends(timing):
    """Of 800 steps of 4 agents, how many messages there were, and whether ends came with requests."""
    environment = opened(arguments=["--decision-timing", timing], seed=1, num_areas=4)
    environment.reset()
    assert (environment.get_steps(BEHAVIOR)[0].reward != 0).all() == (timing == "unity")
    generator = np.random.default_rng(0)
    steps, count, together = 0, 0, set()
    while steps < 800:
        decision, terminal = step(environment, generator)
        count += 1
        if len(decision):
            steps += 1
            assert decision.agent_id.tolist() == [0, 1, 2, 3]
        if len(terminal):
            assert set(terminal.agent_id.tolist()) <= {0, 1, 2, 3}
            together.add(len(decision) > 0)
    environment.close()
    assert len(together) == 1
    return count, together.pop()


def a_step_limit_interrupts_and_a_failure_does_not():
    for name, value, interrupted in (("max_episode_steps", 5.0, True), ("failure_return", -0.003, False)):
        parameters = EnvironmentParametersChannel()
        parameters.set_float_parameter(name, value)
        environment = opened([parameters], num_areas=2)
        environment.reset()
        for _ in range(12):
            environment.step()
            _, terminal = environment.get_steps(BEHAVIOR)
            if len(terminal):
                break
        assert terminal.interrupted.tolist() == [interrupted] * len(terminal)
        assert all((reward < -1.0) is not interrupted for reward in terminal.reward)
        environment.close()


def samplers_draw_at_every_episodes_start():
    parameters = EnvironmentParametersChannel()
    parameters.set_uniform_sampler_parameters("goal_x", 3.0, 5.0, 1)
    parameters.set_gaussian_sampler_parameters("opponent_speed", 1.0, 0.1, 2)
    parameters.set_multirangeuniform_sampler_parameters("goal_z", [[0.0, 1.0], [2.0, 3.0]], 3)
    environment = opened([parameters], num_areas=8)
    drawn = []
    for _ in range(3):
        environment.reset()
        drawn += environment.get_steps(BEHAVIOR)[0].obs[0][:, 4].tolist()
    assert len(set(drawn)) == 24
    assert 0.3 <= min(drawn) <= max(drawn) <= 0.5
    environment.close()


def statistics_and_engine_settings_pass_through():
    statistics, engine, parameters = StatsSideChannel(), EngineConfigurationChannel(), EnvironmentParametersChannel()
    engine.set_configuration_parameters(width=80, height=80, quality_level=1, time_scale=20.0, target_frame_rate=-1)
    parameters.set_float_parameter("max_episode_steps", 3.0)
    environment = opened([statistics, engine, parameters])
    environment.reset()
    for _ in range(3):
        environment.step()
    assert statistics.get_and_reset_stats()["Corridor/Episode Length"][0][0] == 3.0
    environment.close()


def a_reset_in_mid_episode_begins_anew():
    environment = opened(num_areas=2)
    environment.reset()
    generator = np.random.default_rng(0)
    for _ in range(10):
        step(environment, generator)
    environment.reset()
    decision, terminal = environment.get_steps(BEHAVIOR)
    assert len(terminal) == 0
    assert (decision.obs[0][:, 2:4] == 0).all()
    environment.close()


def closing_ends_the_player_with_code_0():
    codes = []
    for _ in range(5):
        environment = opened()
        environment.reset()
        process = environment._process
        environment.close()
        codes.append(process.poll())
    # The published communicator sends its 400 and stops its server at once: sometimes the player sees only the latter.
    assert codes == [0] * 5


def the_clients_own_gym_wrapper_plays_episodes():
    for timing, steps in (("together", 5), ("unity", 4)):  # Unity's agents have acted once before they ask
        parameters = EnvironmentParametersChannel()
        parameters.set_float_parameter("max_episode_steps", 5.0)
        env = UnityToGymWrapper(opened([parameters], ["--decision-timing", timing]))
        for _ in range(3):
            observation = observed(env.reset())
            assert np.shape(observation) == (13,)
            for number in range(1, steps + 1):
                observation, _, done = stepped(env.step(env.action_space.sample()))
                assert done is (number == steps)
        env.close()


def the_clients_own_gym_wrapper_sees_through_the_camera():
    for raw in ((), ("--camera-raw",)):
        env = UnityToGymWrapper(
            opened(arguments=("--camera", "32x20", *raw)), uint8_visual=True, allow_multiple_obs=True
        )
        image, vector = observed(env.reset())
        assert sorted(image.shape) == [3, 20, 32]
        assert image.dtype == np.uint8
        assert image.max() == 255
        assert vector.shape == (13,)
        (image, _), _, _ = stepped(env.step(env.action_space.sample()))
        assert np.array_equal(env.render(), image)
        env.close()


def the_clients_own_pettingzoo_wrapper_plays():
    try:
        from mlagents_envs.envs.unity_parallel_env import UnityParallelEnv
    except ImportError:
        raise NotApplicable("this release has no PettingZoo wrapper") from None
    env = UnityParallelEnv(opened(num_areas=3), seed=1)
    observations = env.reset()
    assert len(observations) == 3
    for _ in range(60):
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, rewards, dones, _ = env.step(actions)
    assert len(observations) == len(rewards) == len(dones) == 3
    env.close()


def the_clients_own_pettingzoo_wrapper_passes_pettingzoos_test_over_an_environment_of_pettingzoos():
    try:
        from mlagents_envs.envs.unity_parallel_env import UnityParallelEnv
        from pettingzoo.test import parallel_api_test
    except ImportError:
        raise NotApplicable("this release has no PettingZoo wrapper") from None
    for module in ("mpe2.simple_spread_v3", "mpe2.simple_tag_v3"):
        env = UnityParallelEnv(opened(arguments=("--pettingzoo", module)), seed=1)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            parallel_api_test(env, num_cycles=60)
        assert not said, [str(each.message) for each in said]
        env.close()


def observed(reset):
    """gym gives the observation, Gymnasium (observation, info)."""
    return reset[0] if isinstance(reset, tuple) and isinstance(reset[1], dict) else reset


def stepped(result):
    """(observation, reward, whether the episode is over) of gym's four and Gymnasium's five values."""
    return result[0], result[1], bool(result[2]) if len(result) == 4 else bool(result[2] or result[3])


SENTENCES = [
    the_behavior_is_introduced_with_its_specs,
    areas_and_seed_are_the_trainers_and_equal_seeds_give_equal_episodes,
    an_agent_keeps_its_id_and_asks_again_in_the_message_that_has_its_end,
    in_unitys_timing_an_end_comes_alone_and_its_agent_asks_in_the_next_message,
    a_step_limit_interrupts_and_a_failure_does_not,
    samplers_draw_at_every_episodes_start,
    statistics_and_engine_settings_pass_through,
    a_reset_in_mid_episode_begins_anew,
    closing_ends_the_player_with_code_0,
    the_clients_own_gym_wrapper_plays_episodes,
    the_clients_own_gym_wrapper_sees_through_the_camera,
    the_clients_own_pettingzoo_wrapper_plays,
    the_clients_own_pettingzoo_wrapper_passes_pettingzoos_test_over_an_environment_of_pettingzoos,
]

if __name__ == "__main__":
    for sentence in SENTENCES:
        try:
            outcome = {"verdict": "pass", "detail": sentence() or ""}
        except NotApplicable as reason:
            outcome = {"verdict": "not applicable", "detail": str(reason)}
        except Exception as error:  # every sentence is tried, and the test shows what came of it
            outcome = {"verdict": "fail", "detail": f"{type(error).__name__}: {error}"}
        print(json.dumps({"sentence": sentence.__name__, **outcome}), flush=True)
