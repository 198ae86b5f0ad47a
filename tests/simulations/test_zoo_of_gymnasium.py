"""Gymnasium environments of others over the wire are the same ones in process, to the bit."""

import importlib
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from simulations.test_zoo_of_pettingzoo import IN_TURNS, TOGETHER
from simulations.zoo import SEED, as_action, as_numbers, asking_and_ended, random_actions, served

AREAS, STEPS = 2, 1000  # 2,000 steps of the environment
ZOO = [
    "CartPole-v1",
    "Acrobot-v1",
    "Taxi-v4",
    "MountainCarContinuous-v0",
    "Pendulum-v1",
    "Blackjack-v1",
    "LunarLander-v3",
    "BipedalWalker-v3",
    "minigrid:MiniGrid-DoorKey-6x6-v0",
    "minigrid:MiniGrid-MemoryS7-v0",
    "minatar.gym:MinAtar/Breakout-v1",
    "gym_platform:Platform-v0",
]
ONLY_THE_PICTURE = "minigrid.wrappers:ImgObsWrapper"


def test_the_zoos_page_lists_what_is_tested():
    page = (Path(__file__).parents[2] / "docs" / "zoo.md").read_text()
    listed = re.findall(r"^\| `--(?:gym|pettingzoo) ([^ `]+)", page, re.MULTILINE)
    assert sorted(listed) == sorted([*ZOO, *(module for module, _ in TOGETHER), *IN_TURNS])


def made(name: str) -> gymnasium.Env:
    module, _, registered = name.rpartition(":")
    register = getattr(importlib.import_module(module), "register_envs", None) if module else None
    if register is not None and registered not in gymnasium.registry:
        register()
    env = gymnasium.make(registered)
    if module == "minigrid":
        env = importlib.import_module("minigrid.wrappers").ImgObsWrapper(env)
    return env


@pytest.mark.slow
@pytest.mark.parametrize("name", ZOO)
def test_two_thousand_random_steps_over_the_wire_are_those_in_process(name, free_port, tmp_path):
    envs = [made(name) for _ in range(AREAS)]
    options = ["--gym", name]
    if len(envs[0].observation_space.shape or ()) == 3:
        options += ["--camera-raw"]
    if name.startswith("minigrid"):
        options += ["--wrapper", ONLY_THE_PICTURE]
    space, actions_of, rng = envs[0].observation_space, envs[0].action_space, np.random.default_rng(1)
    expected = {area: (*env.reset(seed=SEED + area), 0.0) for area, env in enumerate(envs)}
    with served(free_port, tmp_path, *options, num_areas=AREAS) as environment:
        environment.reset()
        [(behavior, spec)] = environment.behavior_specs.items()
        assert behavior == f"{name.rpartition(':')[2]}?team=0"
        over: dict[int, tuple[object, float, bool]] = {}
        for _ in range(STEPS):
            asking, ended = asking_and_ended(environment)
            assert asking.keys() == expected.keys()
            assert ended.keys() == over.keys()
            for area, (observation, info, reward) in expected.items():
                assert np.array_equal(asking[area][0], as_numbers(space, observation))
                assert np.float32(asking[area][1]) == np.float32(reward)
                if "action_mask" in info:
                    assert np.array_equal(asking[area][2], info["action_mask"] == 0)
            for area, (observation, reward, interrupted) in over.items():
                assert np.array_equal(ended[area][0], as_numbers(space, observation))
                assert np.float32(ended[area][1]) == np.float32(reward)
                assert ended[area][2] == interrupted
            steps, _ = environment.get_steps(behavior)
            actions = random_actions(rng, spec, steps)
            environment.set_actions(behavior, actions)
            environment.step()
            expected, over = {}, {}
            for area, env in enumerate(envs):
                action = as_action(actions_of, actions.continuous[area], actions.discrete[area])
                observation, reward, terminated, truncated, info = env.step(action)
                if terminated or truncated:
                    over[area] = (observation, reward, truncated and not terminated)
                    expected[area] = (*env.reset(), 0.0)
                else:
                    expected[area] = (observation, info, reward)
