"""Environments of others behind ``corridor-server``, wrapped, and trained on with what Stable-Baselines3 has."""

import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import BIN
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from minigrid.wrappers import ImgObsWrapper
from sb3_contrib import MaskablePPO
from simulations.zoo import SEED, served
from stable_baselines3 import PPO

from trainer.errors import TrainerError
from trainer.players.gym_wrapper import UnityGymException, UnityToGymWrapper
from trainer.players.parallel_env import UnityParallelEnv
from trainer.players.vec_env import UnityVecEnv
from trainer.players.vector_env import UnityVectorEnv

PLATFORM = ("--gym", "gym_platform:Platform-v0")
MEMORY = ("--gym", "minigrid:MiniGrid-MemoryS7-v0", "--wrapper", "minigrid.wrappers:ImgObsWrapper")
SPREAD = ("--pettingzoo", "mpe2.simple_spread_v3", "--group")


def forbidden_choices(environment: Any) -> Callable[[], tuple[int, int]]:
    """From here on, how many actions the environment was given, and how many choices of those it had forbidden."""
    given, forbidden, set_actions = 0, 0, environment.set_actions

    def counted(behavior: str, actions: Any) -> None:
        nonlocal given, forbidden
        masks = environment.get_steps(behavior)[0].action_mask
        for branch, mask in enumerate(masks):
            forbidden += int(mask[np.arange(len(mask)), actions.discrete[:, branch]].sum())
        given += len(actions.discrete)
        set_actions(behavior, actions)

    environment.set_actions = counted
    return lambda: (given, forbidden)


@pytest.mark.slow
@pytest.mark.parametrize("wrap", [UnityVecEnv, UnityToGymWrapper])
def test_maskable_ppo_keeps_to_the_masks_of_taxi(wrap, free_port, tmp_path):
    areas = 4 if wrap is UnityVecEnv else 1
    with served(free_port, tmp_path, "--gym", "Taxi-v4", num_areas=areas) as environment:
        env, counts = wrap(environment), forbidden_choices(environment)
        MaskablePPO("MlpPolicy", env, n_steps=500 // areas, batch_size=250, n_epochs=1, seed=0).learn(1000)
        assert counts() == (1000, 0)
        env.reset()  # and one who keeps to none is caught by the count
        for _ in range(20):
            env.step(np.zeros(areas, int) if areas > 1 else 0)
        assert counts()[1] > 0


@pytest.mark.slow
def test_ppo_trains_on_a_picture_and_a_vector(free_port, tmp_path):
    with served(free_port, tmp_path, "--camera", "40x36", "--camera-raw", num_areas=2) as environment:
        env = UnityVecEnv(environment)
        sizes = {name: box.shape for name, box in env.observation_space.spaces.items()}
        assert sorted(sizes.values()) == [(3, 36, 40), (13,)]
        observations = env.reset()
        assert all(env.observation_space[name].contains(part[0]) for name, part in observations.items())
        (picture,) = (part for part in observations.values() if part.ndim == 4)
        model = PPO("MultiInputPolicy", env, n_steps=32, batch_size=32, policy_kwargs={"normalize_images": False})
        layers = model.policy.features_extractor.extractors
        assert {type(layer).__name__ for layer in layers.values()} == {"NatureCNN", "Flatten"}
        model.learn(64)
    assert picture.max() == 1


def test_ppo_trains_on_a_picture_too_small_for_convolutions(free_port, tmp_path):
    with served(free_port, tmp_path, *MEMORY, num_areas=2) as environment:
        env = UnityVecEnv(environment)
        assert env.observation_space == spaces.Dict({"obs_0": spaces.Box(0, 1, (3, 7, 7), np.float32)})
        PPO("MultiInputPolicy", env, n_steps=32, batch_size=32).learn(64)


def test_pictures_are_those_in_process_with_their_channels_last(free_port, tmp_path):
    oracle = ImgObsWrapper(gymnasium.make("MiniGrid-MemoryS7-v0"))
    with served(free_port, tmp_path, *MEMORY) as environment:
        env = UnityToGymWrapper(environment, uint8_visual=True)
        observation, _ = env.reset()
        assert np.array_equal(observation, oracle.reset(seed=SEED)[0])
        for _ in range(20):
            assert np.array_equal(env.step(2)[0], oracle.step(2)[0])
            assert env.observation_space == spaces.Box(0, 255, (7, 7, 3), np.uint8)


PICTURES = """
import gymnasium
import numpy as np

class Pictures(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-5, 5, (8, 6, 3), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return np.linspace(-5, 5, 144, dtype=np.float32).reshape(8, 6, 3), {}

def register_envs():
    gymnasium.register("Pictures-v0", Pictures)
"""


@pytest.mark.parametrize("wrap", [UnityToGymWrapper, UnityVecEnv, UnityVectorEnv, UnityParallelEnv])
def test_pictures_of_any_floats_lie_in_the_declared_space(wrap, free_port, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures.py").write_text(PICTURES)
    with served(free_port, tmp_path, "--gym", "pictures:Pictures-v0") as environment:
        env = wrap(environment)
        observation = env.reset() if wrap is UnityVecEnv else env.reset()[0]
        space = env.observation_space
        if wrap is UnityVecEnv:
            space = batch_space(space, 1)
        elif wrap is UnityParallelEnv:
            space, observation = space("Pictures-v0_0"), observation["Pictures-v0_0"]
        assert space.contains(observation)
        picture = observation if wrap is UnityToGymWrapper else observation["obs_0"]
        assert (picture.min(), picture.max()) == (-5, 5)


@pytest.mark.parametrize("wrap", [UnityToGymWrapper, UnityVecEnv, UnityVectorEnv])
def test_an_environment_that_is_refused_leaves_its_port(wrap, free_port, tmp_path):
    with served(free_port, tmp_path, "--pettingzoo", "mpe2.simple_tag_v3") as environment:
        with pytest.raises((TrainerError, UnityGymException), match="has 2 behaviors"):
            wrap(environment)
        assert not environment.is_open
        socket.create_server(("127.0.0.1", free_port)).close()


def test_both_kinds_of_actions_reach_platform(free_port, tmp_path):
    with served(free_port, tmp_path, *PLATFORM) as environment:
        env, ends = UnityToGymWrapper(environment, allow_multiple_obs=True), 0
        env.action_space.seed(0)
        assert env.action_space[1] == spaces.MultiDiscrete([3])
        env.reset()
        for _ in range(50):
            observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
            assert env.observation_space.contains(observation)
            if terminated or truncated:
                ends += 1
                env.reset()
        assert ends > 0


def test_a_groups_rewards_are_each_agents(free_port, tmp_path):
    with served(free_port, tmp_path, *SPREAD) as environment:
        env = UnityVecEnv(environment)
        env.reset()
        _, rewards, _, _ = env.step(np.ones(env.num_envs, int))
        steps, _ = environment.get_steps(env.agents.behavior)
        assert np.count_nonzero(steps.group_reward) == 3
        assert np.array_equal(rewards, steps.reward + steps.group_reward)


@pytest.mark.slow
def test_the_examples_in_the_docs_run(free_port, monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")
    page = (Path(__file__).parents[2] / "docs" / "unity.md").read_text()
    setup, *examples = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert [re.search(r"Unity\w+", each)[0] for each in examples] == [
        "UnityToGymWrapper",
        "UnityVecEnv",
        "UnityVectorEnv",
        "UnityParallelEnv",
    ]
    for example in examples:
        exec(setup.replace("port=5005", f"port={free_port}") + example, {})


@pytest.mark.slow
def test_the_example_in_the_readme_runs(free_port, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "README.md").read_text()
    [example] = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(example.replace("port=5005", f"port={free_port}").replace("10_000", "1_024"), {})
    assert (tmp_path / "pole.zip").is_file()
