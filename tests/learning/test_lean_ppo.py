"""LeanPPO makes Stable-Baselines3's updates, parameter by parameter."""

import copy

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import set_random_seed

from trainer.learning.lean_ppo import LeanPPO

SETTINGS = {
    "n_steps": 32,
    "batch_size": 32,
    "n_epochs": 3,
    "learning_rate": 1e-3,
    "clip_range_vf": 0.05,
    "clip_range": 0.05,
    "ent_coef": 0.01,
    "max_grad_norm": 0.2,
    "seed": 3,
    "device": "cpu",
    "policy_kwargs": {"net_arch": {"pi": [16, 16], "vf": [16, 16]}},
}


def corridor(areas: int = 4):
    return make_vec_env(lambda: gymnasium.make("corridor_server:Corridor-v0", max_episode_steps=20), areas, seed=1)


def pair(**changes: object) -> tuple[PPO, LeanPPO]:
    settings = {**SETTINGS, **changes}
    return PPO("MlpPolicy", corridor(), **settings), LeanPPO("MlpPolicy", corridor(), **settings)


def parameters(model: PPO) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in model.policy.state_dict().items()}


@pytest.mark.parametrize(
    "changes", [{}, {"clip_range_vf": None}, {"max_grad_norm": 100.0}, {"ent_coef": 0.0, "clip_range": 0.2}]
)
def test_five_updates_from_rollout_to_parameters_are_sb3s(changes):
    theirs, ours = pair(**changes)
    before = parameters(theirs)
    for model in (theirs, ours):
        set_random_seed(7)
        model.learn(5 * 32 * 4)
    for name, value in parameters(theirs).items():
        assert not torch.equal(value, before[name]), f"{name} has not moved"
        assert torch.allclose(value, parameters(ours)[name], rtol=1e-4, atol=1e-5), name


def test_one_update_of_one_rollout_is_sb3s_to_rounding():
    theirs, ours = pair()
    theirs.learn(32 * 4)
    ours.learn(32 * 4)
    ours.rollout_buffer = copy.deepcopy(theirs.rollout_buffer)
    ours.rollout_buffer.generator_ready = False
    fresh = copy.deepcopy(theirs.rollout_buffer)
    for name in ("observations", "actions", "values", "log_probs", "advantages", "returns"):
        column = getattr(fresh, name)
        if column.ndim != 2 or column.shape[0] != 32:  # SB3 flattened it: (slots * steps, ...) to (steps, slots, ...)
            setattr(ours.rollout_buffer, name, column.reshape(4, 32, *column.shape[1:]).swapaxes(0, 1).squeeze())
    ours.policy.load_state_dict(theirs.policy.state_dict())
    ours.policy.optimizer.load_state_dict(copy.deepcopy(theirs.policy.optimizer.state_dict()))
    for model in (theirs, ours):
        set_random_seed(0)
        model.train()
    for name, value in parameters(theirs).items():
        assert torch.allclose(value, parameters(ours)[name], rtol=1e-5, atol=1e-6), name
    for mine, its in zip(
        ours.policy.optimizer.state_dict()["state"].values(),
        theirs.policy.optimizer.state_dict()["state"].values(),
        strict=True,
    ):
        assert torch.allclose(mine["exp_avg"], its["exp_avg"], rtol=1e-4, atol=1e-6)
        assert torch.allclose(mine["exp_avg_sq"], its["exp_avg_sq"], rtol=1e-4, atol=1e-9)
        assert float(mine["step"]) == float(its["step"])


def test_sb3s_own_update_can_take_over():
    theirs, ours = pair()
    for model in (theirs, ours):
        set_random_seed(7)
        model.learn(2 * 32 * 4)
    set_random_seed(8)
    theirs.learn(32 * 4)
    set_random_seed(8)
    ours.collect_rollouts = PPO.collect_rollouts.__get__(ours)
    ours.train = PPO.train.__get__(ours)
    ours.learn(32 * 4)
    for name, value in parameters(theirs).items():
        assert torch.allclose(value, parameters(ours)[name], rtol=1e-4, atol=1e-5), name


def test_rollouts_are_sb3s():
    theirs, ours = pair()
    for model in (theirs, ours):
        set_random_seed(7)
        model.learn(32 * 4)
    for name in ("rewards", "episode_starts"):
        assert np.allclose(getattr(theirs.rollout_buffer, name), getattr(ours.rollout_buffer, name), atol=1e-6), name


def test_a_truncated_episode_is_bootstrapped():
    _, ours = pair(gamma=0.5)
    ours.learn(32 * 4)
    starts = ours.rollout_buffer.episode_starts[1:]
    at_ends = ours.rollout_buffer.rewards[:-1][starts == 1]
    assert len(at_ends) >= 4
    assert (np.abs(at_ends + 0.001) > 1e-6).any(), "the value of the state that was cut is in the reward"


def test_predictions_come_from_the_same_parameters():
    _, ours = pair()
    ours.learn(32 * 4)
    observation = ours.observation_space.sample() * 0 + 0.1
    tensor = torch.from_numpy(observation[None])
    with torch.no_grad():
        mean = ours.policy.get_distribution(tensor).distribution.mean.numpy()
        value = ours.policy.predict_values(tensor).numpy()
    assert np.allclose(ours.predict(observation, deterministic=True)[0], np.clip(mean[0], -1, 1))
    assert np.allclose(ours._networks.values(observation[None]), value)


def test_another_form_of_policy_is_refused():
    with pytest.raises(ValueError, match="dense tanh or SiLU layers"):
        LeanPPO("MlpPolicy", corridor(1), policy_kwargs={"activation_fn": torch.nn.ReLU})
    with pytest.raises(ValueError, match="takes Box actions"):
        LeanPPO("MlpPolicy", make_vec_env("CartPole-v1", 1))
