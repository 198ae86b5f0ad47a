"""The connection to a build: pictures as Unity's package 3.0 sends them, its window, and how it ends."""

import io
import logging

import numpy as np
import pytest
from mlagents_envs.exception import UnityCommunicatorStoppedException, UnityObservationException
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from PIL import Image
from raw_player import events, write_player

from trainer.errors import TrainerError
from trainer.players.gym_wrapper import UnityToGymWrapper
from trainer.players.opening import open_environment

HEIGHT, WIDTH = 5, 7
RANDOM = np.random.default_rng(0)


def opened(tmp_path, port, graphics=False, **options):
    player, log = write_player(tmp_path, **options)
    return open_environment(str(player), seed=0, num_areas=1, port=port, timeout_wait=30, graphics=graphics), log


def pixels() -> np.ndarray:
    return RANDOM.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def shown(environment) -> np.ndarray:
    environment.reset()
    (name,) = environment.behavior_specs
    decision, terminal = environment.get_steps(name)
    assert tuple(environment.behavior_specs[name].observation_specs[0].shape) == decision.obs[0].shape[1:]
    assert terminal.obs[0].shape == (0, *decision.obs[0].shape[1:])
    return decision.obs[0]


def test_a_picture_with_its_channels_first_has_the_shape_that_the_player_says(tmp_path, free_port):
    image = pixels()
    environment, _ = opened(tmp_path, free_port, agents=2, picture=((3, HEIGHT, WIDTH), png(image), [0, 1, 2]))
    expected = image.transpose(2, 0, 1) / np.float32(255)
    assert np.array_equal(shown(environment), [expected, expected])
    environment.step()
    assert np.array_equal(environment.get_steps("Raw?team=0")[0].obs[0][1], expected)
    environment.close()


def test_a_picture_with_its_channels_last_is_read_as_before(tmp_path, free_port):
    image = pixels()
    environment, _ = opened(tmp_path, free_port, picture=((HEIGHT, WIDTH, 3), png(image), []))
    assert np.array_equal(shown(environment)[0], image / np.float32(255))
    environment.close()


def test_more_than_three_channels_are_several_pngs_and_a_mapping(tmp_path, free_port):
    """Channels 0 and 2 of the picture are its own, channel 1 the mean of two, and the last is padding."""
    first, second = pixels(), pixels()
    shape, mapping = (4, HEIGHT, WIDTH), [0, 1, 1, 2, 3, -1]
    environment, _ = opened(tmp_path, free_port, picture=(shape, png(first) + png(second), mapping))
    found = shown(environment)[0]
    environment.close()
    first, second = first / np.float32(255), second / np.float32(255)
    assert np.array_equal(found[0], first[..., 0])
    assert found[1] == pytest.approx((first[..., 1] + first[..., 2]) / 2)
    assert np.array_equal(found[2:], second.transpose(2, 0, 1)[:2])


def test_a_grey_picture_is_one_channel(tmp_path, free_port):
    grey = np.repeat(pixels()[..., :1], 3, axis=2)
    environment, _ = opened(tmp_path, free_port, picture=((1, HEIGHT, WIDTH), png(grey), [0, 0, 0]))
    assert shown(environment)[0][0] == pytest.approx(grey[..., 0] / np.float32(255))
    environment.close()


def test_unity_to_gym_wrapper_leaves_the_shape_of_a_player_that_does_not_say_which_axis_is_which(tmp_path, free_port):
    image = pixels()
    environment, _ = opened(tmp_path, free_port, picture=((3, HEIGHT, WIDTH), png(image), [0, 1, 2]))
    env = UnityToGymWrapper(environment, uint8_visual=True)
    observation, _ = env.reset()
    assert env.observation_space.contains(observation)
    assert np.abs(observation - image.transpose(2, 0, 1).astype(int)).max() <= 1
    for _ in range(5):
        observation, _, ended, _, _ = env.step([0.0, 0.0])
    assert ended
    assert env.observation_space.contains(observation)
    env.close()


def test_a_picture_that_is_cut_is_one_sentence(tmp_path, free_port):
    environment, _ = opened(tmp_path, free_port, picture=((3, HEIGHT, WIDTH), png(pixels())[:60], []))
    with pytest.raises(UnityObservationException, match="sent a picture that can't be read"):
        environment.reset()
    environment.close()


def test_statistics_that_nobody_asked_for_are_nothing_to_warn_of(open_corridor, caplog):
    parameters = EnvironmentParametersChannel()
    parameters.set_float_parameter("max_episode_steps", 3.0)
    environment = open_corridor(side_channels=[parameters])
    environment.reset()
    for _ in range(3):
        environment.step()
    assert len(environment.get_steps("Corridor?team=0")[1]) == 1
    assert "Unknown side channel" not in caplog.text


@pytest.mark.parametrize("graphics", [False, True])
def test_a_build_renders_only_if_it_shall(tmp_path, free_port, graphics):
    environment, log = opened(tmp_path, free_port, graphics)
    environment.close()
    (arguments,) = events(log, "arguments")
    assert ({"-nographics", "-batchmode"} & set(arguments) == set()) == graphics


def test_a_build_that_announced_its_end_is_not_killed(tmp_path, free_port, caplog):
    environment, log = opened(tmp_path, free_port, announces_end_after=2)
    environment.reset()
    environment.step()
    with pytest.raises(UnityCommunicatorStoppedException):
        environment.step()
    with caplog.at_level(logging.WARNING):
        environment.kill()
    assert events(log, "quit") == [0]
    assert "timed out shutting down" not in caplog.text


@pytest.mark.parametrize("seed", [None, 1.0, 2**31, -(2**31) - 1, 2**64])
def test_a_seed_that_the_protocol_can_not_carry_is_refused_before_a_player_is_started(free_port, seed):
    with pytest.raises(TrainerError, match=f"The seed is {seed}, but a whole number from -2147483648 to 2147483647"):
        open_environment("builtin", seed=seed, num_areas=1, port=free_port, timeout_wait=1)
