"""PettingZoo environments of others over the wire are the same ones in process, to the bit."""

import importlib

import numpy as np
import pytest
from simulations.zoo import SEED, as_action, as_numbers, asking_and_ended, random_actions, served

AREAS, STEPS = 2, 1000  # 2,000 steps of the environment
TOGETHER = [
    ("mpe2.simple_spread_v3", ["--group"]),
    ("mpe2.simple_tag_v3", ["--team", "agent=1"]),
    ("mpe2.simple_speaker_listener_v4", ["--group"]),
    ("pettingzoo.butterfly.knights_archers_zombies_v11", []),
]
IN_TURNS = ["pettingzoo.classic.tictactoe_v3", "pettingzoo.classic.connect_four_v3"]


def send_random_actions(rng, environment):
    """Returns what was sent, by agent id."""
    sent = {}
    for behavior, spec in environment.behavior_specs.items():
        steps, _ = environment.get_steps(behavior)
        actions = random_actions(rng, spec, steps)
        environment.set_actions(behavior, actions)
        sent |= dict(zip(steps.agent_id.tolist(), zip(actions.continuous, actions.discrete, strict=True), strict=True))
    environment.step()
    return sent


def compare(found, expected, space_of):
    assert found.keys() == expected.keys()
    for agent, (observation, reward, *rest) in expected.items():
        assert np.array_equal(found[agent][0], as_numbers(space_of[agent], observation))
        assert np.float32(found[agent][1]) == np.float32(reward)
        if rest:
            assert np.array_equal(found[agent][2], rest[0])


@pytest.mark.slow
@pytest.mark.parametrize(("module", "options"), TOGETHER)
def test_agents_that_act_together_are_those_in_process(module, options, free_port, tmp_path):
    envs = [importlib.import_module(module).parallel_env() for _ in range(AREAS)]
    names = envs[0].possible_agents
    places = [(area, agent) for area in range(AREAS) for agent in names]  # by id
    numbers = {place: number for number, place in enumerate(places)}
    space_of = {number: envs[0].observation_space(agent) for number, (_, agent) in enumerate(places)}
    expected, over, rng = {}, {}, np.random.default_rng(1)
    for area, env in enumerate(envs):
        observations, _ = env.reset(seed=SEED + area)
        expected |= {numbers[area, agent]: (observations[agent], 0.0) for agent in env.agents}
    with served(free_port, tmp_path, "--pettingzoo", module, *options, num_areas=AREAS) as environment:
        environment.reset()
        for _ in range(STEPS):
            asking, ended = asking_and_ended(environment)
            compare(asking, expected, space_of)
            compare(ended, over, space_of)
            sent = send_random_actions(rng, environment)
            expected, over = {}, {}
            for area, env in enumerate(envs):
                actions = {
                    agent: as_action(env.action_space(agent), *sent[numbers[area, agent]]) for agent in env.agents
                }
                observations, rewards, terminated, truncated, _ = env.step(actions)
                for agent in actions:
                    at = numbers[area, agent]
                    if terminated[agent] or truncated[agent]:
                        interrupted = truncated[agent] and not terminated[agent]
                        over[at] = (observations[agent], rewards[agent], interrupted)
                    else:
                        expected[at] = (observations[agent], rewards[agent])
                if not env.agents:
                    observations, _ = env.reset()
                    expected |= {numbers[area, agent]: (observations[agent], 0.0) for agent in env.agents}


@pytest.mark.slow
@pytest.mark.parametrize("module", IN_TURNS)
def test_agents_that_take_turns_are_those_in_process(module, free_port, tmp_path):
    env, rng = importlib.import_module(module).env(), np.random.default_rng(1)
    names = env.possible_agents
    space_of = {number: env.observation_space(agent) for number, agent in enumerate(names)}
    env.reset(seed=SEED)
    over, games = {}, 0
    with served(free_port, tmp_path, "--pettingzoo", module) as environment:
        environment.reset()
        for _ in range(2 * STEPS):
            asking, ended = asking_and_ended(environment)
            observation, reward, *_ = env.last()
            at = names.index(env.agent_selection)
            compare(asking, {at: (observation, reward, observation["action_mask"] == 0)}, space_of)
            compare(ended, over, space_of)
            sent = send_random_actions(rng, environment)
            env.step(as_action(env.action_space(env.agent_selection), *sent[at]))
            over = {}
            while env.agents and (env.terminations[env.agent_selection] or env.truncations[env.agent_selection]):
                observation, reward, terminated, truncated, _ = env.last()
                over[names.index(env.agent_selection)] = (observation, reward, truncated and not terminated)
                env.step(None)
            if not env.agents:
                games += 1
                env.reset()
    assert games > 10
