"""Gymnasium's own checker, with its defaults, on our wrapper over what is served."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from simulations.zoo import served

from trainer.players.gym_wrapper import UnityGymException, UnityToGymWrapper


@pytest.mark.filterwarnings("error::UserWarning", "ignore:.*Box observation space")  # the protocol carries no bounds
def test_cartpole_served_and_wrapped_passes_it(free_port, tmp_path):
    with served(free_port, tmp_path, "--gym", "CartPole-v1") as environment:
        env = UnityToGymWrapper(environment)
        assert (env.observation_space.shape, env.action_space.n) == ((4,), 2)
        assert (env.metadata["render_modes"], env.render_mode) == ([], None)
        check_env(env)
        with pytest.raises(UnityGymException, match="The environment is closed"):
            env.reset()  # the check has closed it: there is one player


@pytest.mark.filterwarnings("error::UserWarning", "ignore:.*Box observation space", "ignore:.*not a 3D array")
@pytest.mark.parametrize("uint8_visual", [False, True])
def test_frames_of_pictures_are_bytes_whatever_is_observed(uint8_visual, free_port, tmp_path):
    with served(free_port, tmp_path, "--camera", "40x36") as environment:
        env = UnityToGymWrapper(environment, uint8_visual=uint8_visual)
        observation, _ = env.reset()
        frame = env.render()
        assert np.array_equal(frame, observation if uint8_visual else np.rint(255 * observation))
        assert (frame.shape, frame.dtype, env.metadata["render_fps"]) == ((36, 40, 3), np.uint8, 10)
        recorded = gymnasium.wrappers.RenderCollection(env)
        recorded.reset()
        assert len(recorded.render()) == 1
        check_env(env)
