"""Curiosity: eq. 6 by hand, both readings of an ended episode's next state, and what it learns."""

import math

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.vec_env import VecEnv

from trainer.hyperparameters import CuriosityConfig
from trainer.learning.curiosity import Curiosity
from trainer.learning.icm import IntrinsicCuriosityModule
from trainer.learning.networks import Adam, Network

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


def module(observations: int = 2, action_space: spaces.Space = BOX, **config) -> IntrinsicCuriosityModule:
    return IntrinsicCuriosityModule(observations, action_space, CuriosityConfig(**config), np.random.default_rng(0))


def fill(network: Network, w1: list[list[float]], w2: list[list[float]]) -> None:
    network.weights[0][...], network.weights[1][...] = w1, w2
    network.biases[0][...] = network.biases[1][...] = 0.0


def test_eq_6_and_both_losses_by_hand():
    """phi = 2 tanh(s); predicted phi' = 3 tanh(phi / 2 + a); predicted a = tanh(phi' - phi)."""
    icm = module(1, spaces.Box(-1, 1, (1,), np.float32), feature_size=1, hidden_size=1, forward_weight=0.2)
    fill(icm.encoder, [[1.0]], [[2.0]])
    fill(icm.forward_model, [[0.5, 1.0]], [[3.0]])
    fill(icm.inverse_model, [[-1.0, 1.0]], [[1.0]])
    s, a, s_next = (np.array([[x]], np.float32) for x in (0.5, -0.25, 1.0))
    phi, next_phi = 2 * math.tanh(0.5), 2 * math.tanh(1.0)
    r_i = 0.5 * (3 * math.tanh(phi / 2 - 0.25) - next_phi) ** 2
    assert icm.intrinsic_reward(s, a, s_next) == pytest.approx([r_i])
    forward_loss, inverse_loss = icm.differentiate(s, a, s_next)
    assert forward_loss == pytest.approx(r_i)
    assert inverse_loss == pytest.approx((math.tanh(next_phi - phi) + 0.25) ** 2)


def test_a_features_error_over_its_running_variance():
    """The first minibatch counts whole, the second half, and so on until the last 250 count alike."""
    plain, own = (module(3, learning_rate=1e-9, feature_error=each) for each in ("plain", "over_variance"))
    rng = np.random.default_rng(0)
    s, s_next = rng.normal(size=(2, 2, 64, 3)).astype(np.float32)
    a = rng.uniform(-1, 1, (2, 64, 2)).astype(np.float32)
    assert own.intrinsic_reward(s[0], a[0], s_next[0]) == pytest.approx(plain.intrinsic_reward(s[0], a[0], s_next[0]))
    for each in range(2):
        own.learn(s[each], a[each], s_next[each])
    first, second = (plain.encoder(each)[1] for each in s_next)
    mean = (first.mean(axis=0) + second.mean(axis=0)) / 2
    variance = (np.square(first - first.mean(axis=0)).mean(axis=0) + np.square(second - mean).mean(axis=0)) / 2
    predicted = plain.forward_model(np.concatenate((plain.encoder(s[0])[1], a[0]), axis=1))[1]
    expected = 0.5 * (np.square(predicted - first) / variance).sum(axis=1)
    assert own.intrinsic_reward(s[0], a[0], s_next[0]) == pytest.approx(expected, rel=1e-4)
    again = module(3, feature_error="over_variance")
    again.load_state_dict(own.state_dict())
    np.testing.assert_array_equal(*(each.intrinsic_reward(s[1], a[1], s_next[1]) for each in (again, own)))
    assert own.state_dict()["features/minibatches"] == 2


def test_the_oldest_minibatches_fade():
    icm, rng = module(3, learning_rate=1e-9, feature_error="over_variance"), np.random.default_rng(0)
    for spread in [10.0] * 50 + [0.1] * 3000:
        s = rng.normal(0, spread, (64, 3)).astype(np.float32)
        icm.learn(s, np.zeros((64, 2), np.float32), s)
    now = icm.encoder(rng.normal(0, 0.1, (10_000, 3)).astype(np.float32))[1].var(axis=0)
    assert icm.state_dict()["features/variance"] == pytest.approx(now, rel=0.1)


@pytest.mark.parametrize("action_space", [BOX, spaces.Discrete(3)])
def test_the_gradient_is_autograds(action_space):
    icm, rng = module(5, action_space, forward_weight=0.3), np.random.default_rng(1)
    s, s_next = rng.normal(size=(2, 7, 5)).astype(np.float32)
    discrete = isinstance(action_space, spaces.Discrete)
    a = (rng.integers(3, size=(7, 1)) if discrete else rng.uniform(-1, 1, (7, 2))).astype(np.float32)
    losses = icm.differentiate(s, a, s_next)

    weights = {
        network: [
            torch.tensor(each, requires_grad=True)
            for each in (network.weights[0], network.biases[0], network.weights[1], network.biases[1])
        ]
        for network in (icm.encoder, icm.inverse_model, icm.forward_model)
    }

    def apply(network: Network, inputs: torch.Tensor) -> torch.Tensor:
        w1, b1, w2, b2 = weights[network]
        return torch.tanh(inputs @ w1.T + b1) @ w2.T + b2

    phi, next_phi = apply(icm.encoder, torch.tensor(s)), apply(icm.encoder, torch.tensor(s_next))
    guess, taken = apply(icm.inverse_model, torch.cat([phi, next_phi], dim=1)), torch.tensor(a)
    if discrete:
        inverse = torch.nn.functional.cross_entropy(guess, taken.long().flatten())
        taken = torch.nn.functional.one_hot(taken.long().flatten(), 3).float()
    else:
        inverse = (guess - taken).square().mean()
    error = apply(icm.forward_model, torch.cat([phi, taken], dim=1)) - next_phi
    forward = 0.5 * error.square().sum(dim=1).mean()
    (0.3 * forward + 0.7 * inverse).backward()

    assert losses == pytest.approx((forward.item(), inverse.item()), rel=1e-5)
    expected = torch.cat([weight.grad.flatten() for each in weights.values() for weight in each]).numpy()
    assert icm.adam.gradient == pytest.approx(expected, rel=1e-4, abs=1e-6)
    rewards = icm.intrinsic_reward(s, a, s_next)
    assert rewards == pytest.approx(0.5 * error.detach().square().sum(dim=1).numpy(), rel=1e-5)


def test_adam_is_torchs():
    ours, weights = Adam(3), torch.tensor([1.0, -2.0, 3.0], requires_grad=True)
    ours.parameters[:] = weights.detach().numpy()
    theirs = torch.optim.Adam([weights], lr=0.1, betas=(0.8, 0.9), eps=1e-3)
    for gradient in ([1.0, -0.5, 0.0], [0.1, 2.0, 0.0], [-3.0, 0.0, 1e-3]):
        ours.gradient[:] = gradient
        weights.grad = torch.tensor(gradient)
        ours.descend(0.1, (0.8, 0.9), 1e-3)
        theirs.step()
        assert ours.parameters == pytest.approx(weights.detach().numpy(), rel=1e-5)


def test_the_encoder_learns_at_its_own_rate():
    """Adam's first step is the rate itself, whatever the gradient's size."""
    icm, rng = module(3, learning_rate=1e-3, encoder_rate=0.1), np.random.default_rng(0)
    before = icm.adam.parameters.copy()
    s, s_next = rng.normal(size=(2, 32, 3)).astype(np.float32)
    icm.learn(s, rng.normal(size=(32, 2)).astype(np.float32), s_next)
    moved = np.abs(icm.adam.parameters - before)
    assert np.median(moved[: icm.encoder.size]) == pytest.approx(1e-4, rel=0.02)
    assert np.median(moved[icm.encoder.size :]) == pytest.approx(1e-3, rel=0.02)


def test_the_reward_is_c_times_scale_times_r_i_on_top_of_the_extrinsic():
    weak, strong = (Curiosity(Counting(), CuriosityConfig(c=c, scale=0.5), 100, seed=0) for c in (0.1, 0.4))
    actions = np.zeros((2, 2), np.float32)
    weak.reset(), strong.reset()
    added = [stage.step(actions)[1] - [0.0, 1.0] for stage in (weak, strong)]
    assert (added[0] > 0).all()
    assert added[1] == pytest.approx(4 * added[0], rel=1e-4)
    s, s_next = np.array([[[0, 0], [1, 0]], [[0, 1], [1, 1]]], np.float32)
    r_i = weak.module.intrinsic_reward(s, actions, s_next)
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


def test_it_learns_once_the_next_actions_are_sent_and_before_they_are_answered():
    stage = Curiosity(Counting(), CuriosityConfig(), 4, seed=0)
    stage.reset()
    before, actions = stage.module.adam.parameters.copy(), np.zeros((2, 2), np.float32)
    for _ in range(4):
        stage.step(actions)
    assert np.array_equal(stage.module.adam.parameters, before)
    assert set(stage.metrics) == {"reward"}
    stage.step_async(actions)
    assert not np.array_equal(stage.module.adam.parameters, before)
    assert set(stage.metrics) == {"reward", "forward_loss", "inverse_loss"}


def test_what_is_saved_has_learned_from_every_whole_update():
    early, late = (Curiosity(Counting(), CuriosityConfig(), 4, seed=0) for _ in range(2))
    actions = np.zeros((2, 2), np.float32)
    for stage in (early, late):
        stage.reset()
        for _ in range(4):
            stage.step(actions)
    late.step_async(actions)
    saved, learned = early.state_dict(), late.state_dict()
    assert saved["random"] == learned["random"]
    assert saved["metrics"] == learned["metrics"]
    assert np.array_equal(saved["parameters"], learned["parameters"])


def test_what_is_seen_again_and_again_stops_being_rewarding():
    stage = Curiosity(Counting(), CuriosityConfig(), 16, seed=0)
    stage.reset()
    rng, means = np.random.default_rng(0), []
    for step in range(1, 16 * 60 + 1):
        stage.step(rng.uniform(-1, 1, (2, 2)).astype(np.float32) * [[1], [0]])
        if step % 16 == 0:
            stage.venv.steps[:] = 0
            means.append(stage.metrics["reward"])
    assert means[-1] < 0.3 * means[0]


def test_the_inverse_model_learns_which_action_was_taken():
    icm, rng = module(learning_rate=1e-2), np.random.default_rng(0)
    for _ in range(400):
        s, a = rng.normal(size=(128, 2)).astype(np.float32), rng.uniform(-1, 1, (128, 2)).astype(np.float32)
        losses = icm.learn(s, a, s + np.float32(0.5) * a)
    assert losses["inverse_loss"] < 0.02


def test_equal_seeds_give_equal_modules():
    first, second, other = (Curiosity(Counting(), CuriosityConfig(), 4, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.module.adam.parameters, second.module.adam.parameters)
    assert not np.array_equal(first.module.adam.parameters, other.module.adam.parameters)


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
