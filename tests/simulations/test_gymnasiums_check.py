"""Gymnasium's own checker on our wrapper over an environment of Gymnasium's that is served."""

import pytest
from gymnasium.utils.env_checker import check_env
from simulations.zoo import served

from trainer.players.gym_wrapper import UnityToGymWrapper


@pytest.mark.filterwarnings("ignore:.*Box observation space")  # the protocol carries no bounds
def test_cartpole_served_and_wrapped_passes_it(free_port, tmp_path):
    with served(free_port, tmp_path, "--gym", "CartPole-v1") as environment:
        env = UnityToGymWrapper(environment)
        assert (env.observation_space.shape, env.action_space.n) == ((4,), 2)
        check_env(env, skip_close_check=True, skip_render_check=True)  # which make another environment
