"""Curiosity: eq. 6 by hand, both readings of an ended episode's next state, and what it learns."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.vec_env import VecEnv

from trainer.config import CuriosityConfig
from trainer.curiosity import Curiosity, IntrinsicCuriosityModule

BOX = spaces.Box(-1, 1, (2,), np.float32)
VECTOR = spaces.Box(-np.inf, np.inf, (2,), np.float32)


class Counting(VecEnv):
    """Two environments whose observation is (slot, step); slot 1's episodes end after three steps."""

    def __init__(self, action_space: spaces.Space = BOX, observation_space: spaces.Space = VECTOR) -> None:
        super().__init__(2, observation_space, action_space)

    def reset(self):
        self.steps = np.zeros(2)
        return self._observation()

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        self.steps += 1
        last, dones = self._observation(), np.array([False, self.steps[1] == 3])
        self.steps[dones] = 0
        infos = [{"terminal_observation": last[slot]} if done else {} for slot, done in enumerate(dones)]
        return self._observation(), np.array([0.0, 1.0], np.float32), dones, infos

    def _observation(self):
        return np.array([[0, self.steps[0]], [1, self.steps[1]]], np.float32)

    def close(self): ...
    def get_attr(self, attr_name, indices=None):
        return [None, None]

    def set_attr(self, attr_name, value, indices=None): ...
    def env_method(self, method_name, *args, indices=None, **kwargs): ...
    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False, False]


def linear(weight: list[list[float]]) -> torch.nn.Sequential:
    layer = torch.nn.Linear(len(weight[0]), len(weight), bias=False)
    layer.weight.data = torch.tensor(weight)
    return torch.nn.Sequential(layer)


def test_eq_6_and_both_losses_by_hand():
    """phi = 2s; predicted phi' = phi + a; predicted a = phi' - phi."""
    module = IntrinsicCuriosityModule(2, BOX, CuriosityConfig(feature_size=2, forward_weight=0.2))
    identity = [[1.0, 0.0], [0.0, 1.0]]
    module.encoder = linear([[2.0, 0.0], [0.0, 2.0]])
    module.forward_model = linear([a + b for a, b in zip(identity, identity, strict=True)])
    minus = [[-1.0, 0.0], [0.0, -1.0]]
    module.inverse_model = linear([a + b for a, b in zip(minus, identity, strict=True)])
    s, a, s_next = torch.tensor([[1.0, 2.0]]), torch.tensor([[0.5, -0.5]]), torch.tensor([[2.0, 2.0]])
    # phi = (2, 4), phi' = (4, 4), predicted phi' = (2.5, 3.5): 1/2 (1.5^2 + 0.5^2) = 1.25
    assert module.intrinsic_reward(s, a, s_next).tolist() == [1.25]
    forward_error, inverse_error = module.errors(s, a, s_next)
    assert forward_error.tolist() == [1.25]
    # predicted a = (2, 0): mean of (1.5^2, 0.5^2) = 1.25
    assert inverse_error.tolist() == [1.25]
    assert module.loss(torch.tensor([2.0]), torch.tensor([1.0])).item() == pytest.approx(0.2 * 2 + 0.8 * 1)


def test_the_reward_is_c_times_scale_times_r_i_on_top_of_the_extrinsic():
    weak, strong = (Curiosity(Counting(), CuriosityConfig(c=c, scale=0.5), 100, seed=0) for c in (0.1, 0.4))
    actions = np.zeros((2, 2), np.float32)
    weak.reset(), strong.reset()
    added = [stage.step(actions)[1] - [0.0, 1.0] for stage in (weak, strong)]
    assert (added[0] > 0).all()
    assert added[1] == pytest.approx(4 * added[0], rel=1e-4)
    r_i = weak.module.intrinsic_reward(
        torch.tensor([[0.0, 0.0], [1.0, 0.0]]), torch.zeros(2, 2), torch.tensor([[0.0, 1.0], [1.0, 1.0]])
    ).numpy()
    assert added[0] == pytest.approx(0.1 * 0.5 * r_i, rel=1e-4)


@pytest.mark.parametrize(("reading", "expected"), [("terminal", [1.0, 3.0]), ("reset", [1.0, 0.0])])
def test_an_ended_episodes_next_state(reading, expected):
    stage = Curiosity(Counting(), CuriosityConfig(next_state=reading), 100, seed=0)
    stage.reset()
    for _ in range(3):
        stage.step(np.zeros((2, 2), np.float32))
    assert stage._next_observations[2, 1].tolist() == expected
    assert stage._observations[2, 1].tolist() == [1.0, 2.0]


def test_an_ended_episodes_info_has_its_curiosity_return():
    stage = Curiosity(Counting(), CuriosityConfig(), 100, seed=0)
    stage.reset()
    added = []
    for _ in range(3):
        _, rewards, _, infos = stage.step(np.zeros((2, 2), np.float32))
        added.append(rewards[1] - 1.0)
    assert infos[1]["curiosity_return"] == pytest.approx(sum(added), abs=1e-6)
    assert "curiosity_return" not in infos[0]


def test_what_is_seen_again_and_again_stops_being_rewarding():
    stage = Curiosity(Counting(), CuriosityConfig(), 16, seed=0)
    stage.reset()
    rng, means = np.random.default_rng(0), []
    for _ in range(16 * 60):
        stage.step(rng.uniform(-1, 1, (2, 2)).astype(np.float32) * [[1], [0]])
        if stage._filled == 0:
            stage.venv.steps[:] = 0
            means.append(stage.metrics["reward"])
    assert means[-1] < 0.3 * means[0]


def test_the_inverse_model_learns_which_action_was_taken():
    module = IntrinsicCuriosityModule(2, BOX, CuriosityConfig())
    optimizer = torch.optim.Adam(module.parameters(), lr=1e-2)
    generator = torch.Generator().manual_seed(0)
    for _ in range(400):
        s, a = torch.randn(128, 2, generator=generator), torch.rand(128, 2, generator=generator) * 2 - 1
        errors = module.errors(s, a, s + 0.5 * a)
        optimizer.zero_grad()
        module.loss(*errors).backward()
        optimizer.step()
    assert errors[1].mean() < 0.02


def test_equal_seeds_give_equal_modules_and_leave_torchs_generator_alone():
    torch.manual_seed(5)
    first = Curiosity(Counting(), CuriosityConfig(), 4, seed=3)
    second = Curiosity(Counting(), CuriosityConfig(), 4, seed=3)
    for a, b in zip(first.module.parameters(), second.module.parameters(), strict=True):
        assert torch.equal(a, b)
    drawn = torch.rand(1)
    torch.manual_seed(5)
    assert torch.equal(drawn, torch.rand(1))


@pytest.mark.parametrize("algorithm", [PPO, A2C])
@pytest.mark.parametrize("action_space", [BOX, spaces.Discrete(3)])
def test_any_algorithm_sits_on_it(algorithm, action_space):
    stage = Curiosity(Counting(action_space), CuriosityConfig(), 4, seed=0)
    algorithm("MlpPolicy", stage, n_steps=32, device="cpu").learn(64)
    assert set(stage.metrics) == {"forward_loss", "inverse_loss", "reward"}


def test_what_it_cant_take_says_so():
    with pytest.raises(ValueError, match="Box or Discrete actions"):
        Curiosity(Counting(spaces.MultiDiscrete([2, 2])), CuriosityConfig(), 4, seed=0)
    images = spaces.Box(0, 255, (4, 4, 3), np.uint8)
    with pytest.raises(ValueError, match="one vector observation"):
        Curiosity(Counting(observation_space=images), CuriosityConfig(), 4, seed=0)
