"""``Corridor-v0`` as Gymnasium and Stable-Baselines3 have an environment to be."""

import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from stable_baselines3.common.env_checker import check_env as check_sb3_env

from corridor_server.corridor.gym_env import CorridorEnv
from corridor_server.corridor.streams import area_generator
from trainer.corridor import CORRIDOR, DEFAULT_PENALTY, corridor_of


@pytest.mark.filterwarnings("ignore:.*A Box observation space m:UserWarning")  # minus and plus infinity
@pytest.mark.filterwarnings("error")
def test_the_checkers_have_nothing_to_say():
    with gymnasium.make("corridor_server:Corridor-v0", render_mode="rgb_array") as env:
        check_env(env.unwrapped)
    check_sb3_env(CorridorEnv())


@pytest.mark.parametrize("seed", [0, 7, 2**31, 2**32 + 7, 2**64, 2**128 + 7])
def test_a_seed_is_kept_whole_and_reported(seed):
    env = CorridorEnv()
    env.reset(seed=seed)
    assert env.np_random_seed == seed
    env.reset()
    assert env.np_random_seed == seed
    expected = np.random.SeedSequence(seed, spawn_key=(0,)).generate_state(4)
    assert np.array_equal(area_generator(seed, 0).bit_generator.seed_seq.generate_state(4), expected)


@pytest.mark.parametrize("imports", ["gymnasium", "corridor_server, gymnasium", "gymnasium, corridor_server"])
def test_it_is_made_by_its_name_whatever_is_imported_first(imports):
    program = f"import {imports}; print(gymnasium.make('corridor_server:Corridor-v0').spec.id)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.stderr) == ("Corridor-v0\n", "")


def test_the_presets_corridor_has_a_name_too_with_the_numbers_that_a_run_has_after_the_wire():
    env = gymnasium.make("corridor_server:CuriousCorridor-v0", goal_radius=1.0)
    assert env.unwrapped.config == corridor_of(DEFAULT_PENALTY, CORRIDOR | {"goal_radius": 1.0})
    assert env.unwrapped.config.agent_spawn_x == (-7.5, -5.5)
    assert env.unwrapped.config.agent_time_constant == float(np.float32(0.2))


def test_importing_the_player_does_not_import_gymnasium_which_takes_long():
    program = "import sys, corridor_server, corridor_server.main; print('gymnasium' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.stdout == "False\n"


def test_seeds_begin_episodes_of_their_own():
    env = CorridorEnv()
    begun = {env.reset(seed=seed)[0].tobytes() for seed in (0, 7, 2**31, 2**32 + 7, 2**64, 2**64 + 7)}
    assert len(begun) == 6
    assert len({area_generator(seed, 0).integers(2**62) for seed in (-(2**31), -1, 0, 1, 2**31 - 1)}) == 5


def test_without_a_seed_the_one_that_was_drawn_is_reported():
    env = CorridorEnv()
    observation, _ = env.reset()
    again, _ = CorridorEnv().reset(seed=int(env.np_random_seed))
    assert np.array_equal(observation, again)


@pytest.mark.parametrize("seed", [-1, np.int64(3), 3.0, "3"])
def test_what_is_no_seed_of_gymnasiums_is_refused_as_it_does(seed):
    with pytest.raises(gymnasium.error.Error, match="Seed must be"):
        CorridorEnv().reset(seed=seed)
    with pytest.raises(ValueError, match="whole number from -2147483648 up"):
        area_generator(-(2**31) - 1, 0)


def test_a_pickled_environment_goes_on_as_the_one_that_it_was_made_of():
    env = CorridorEnv()
    env.reset(seed=3)
    copy = pickle.loads(pickle.dumps(env))
    action = env.action_space.sample()
    assert data_equivalence(env.step(action), copy.step(action), exact=True)
    assert data_equivalence(env.reset(), copy.reset(), exact=True)


def test_side_by_side_as_gymnasium_makes_it():
    envs = gymnasium.make_vec("corridor_server:Corridor-v0", num_envs=3, vectorization_mode="sync")
    observations, _ = envs.reset(seed=3)
    assert envs.np_random_seed == (3, 4, 5)
    for seed, observation in zip((3, 4, 5), observations, strict=True):
        assert np.array_equal(CorridorEnv().reset(seed=seed)[0], observation)
    envs.close()
    envs.close()
