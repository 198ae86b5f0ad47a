"""The policy without autograd acts, judges and learns as the one in torch, to rounding, for every kind of action."""

import copy
import importlib.util
import sys

import numpy as np
import pytest
import torch

from corridor_server.protocol.agents import Behavior, Sensor
from trainer.behavior_settings import PPOHyperparameters
from trainer.learning import kernels
from trainer.learning.actor_critic import ActorCritic
from trainer.learning.lean_actor_critic import LeanActorCritic, flat
from trainer.learning.ppo_update import PPOUpdate, minibatches
from trainer.learning.tensors import tensor, tensors
from trainer.learning.transitions import Decided, Observed, Transitions

SENSORS = (Sensor.of("vector", (5,)), Sensor("table", (2, 3), (1, 1)))
ACTIONS = {"continuous": (2, ()), "discrete": (0, (3,)), "branched": (0, (3, 2, 4)), "hybrid": (2, (3, 2))}
ROWS = 60


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def built(kind: str, **options) -> ActorCritic:
    """With outputs that differ from agent to agent more than at the beginning."""
    torch.manual_seed(3)
    policy = ActorCritic(Behavior("any", SENSORS, *ACTIONS[kind]), hidden_units=16, **options)
    with torch.no_grad():
        policy.action_net.weight.mul_(15.0)
        policy.log_std.uniform_(-1.0, 0.5)
    return policy


def observed(kind: str, masked: bool) -> Observed:
    rng = np.random.default_rng(0)
    observations = tuple(rng.normal(size=(ROWS, *sensor.shape)).astype(np.float32) for sensor in SENSORS)
    branches = ACTIONS[kind][1]
    if not masked or not branches:
        return Observed(observations)
    allowed = [rng.random((ROWS, size)) < 0.5 for size in branches]
    for each in allowed:
        each[np.arange(ROWS), rng.integers(each.shape[1], size=ROWS)] = True
    return Observed(observations, np.concatenate(allowed, axis=1))


def decided(policy: ActorCritic, seen: Observed, deterministic: bool = False) -> Decided:
    torch.manual_seed(5)
    acted = policy.act(tensors(seen.observations), tensor(seen.allowed), deterministic)
    return Decided(*(part.numpy() for part in acted))


def of(seen: Observed, taken: Decided, rewards: np.ndarray) -> Transitions:
    rows, nothing = np.arange(ROWS), np.zeros(ROWS, np.int64)
    return Transitions(seen.observations, rows, rows, seen.allowed, taken, rewards, nothing, nothing, nothing > 0)


def batches(seed: int) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [each for _ in range(3) for each in minibatches(ROWS, 20, generator)]


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("kind", ACTIONS)
@pytest.mark.parametrize("deterministic", [False, True])
def test_from_the_same_noise_it_takes_the_same_actions(kind, masked, deterministic):
    policy, seen = built(kind), observed(kind, masked)
    expected = decided(policy, seen, deterministic)
    lean = LeanActorCritic(policy, ACTIONS[kind][1])
    torch.manual_seed(5)
    rows = flat(seen.observations)
    found = Decided(*lean.act(rows, seen.allowed, None if deterministic else lean.noise(ROWS)))
    assert lean.values(rows) == pytest.approx(policy.values(tensors(seen.observations)).numpy(), abs=1e-5)
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.dtype == theirs.dtype
        assert ours == pytest.approx(theirs, abs=1e-5)


@pytest.mark.parametrize("heads", [1, 2])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("kind", ACTIONS)
def test_updates_are_those_of_torch_parameter_by_parameter(kind, masked, heads):
    theirs, seen = built(kind, value_heads=heads, num_layers=3), observed(kind, masked)
    ours = copy.deepcopy(theirs)
    taken, rng = decided(theirs, seen), np.random.default_rng(1)
    advantage, returns = (rng.normal(size=shape).astype(np.float32) for shape in ((ROWS,), (ROWS, heads)))
    transitions = of(seen, taken, advantage)
    settings = PPOHyperparameters(batch_size=20, learning_rate=3e-3, beta=0.02, epsilon=0.1)
    updates = (
        PPOUpdate(theirs, settings),
        PPOUpdate(ours, settings, LeanActorCritic(ours, ACTIONS[kind][1])),
    )
    before = theirs.state_dict()["action_net.weight"].clone()
    values = returns[:, 0] * np.float32(0.5)
    for progress in (0.0, 0.5):
        expected, found = (
            each.update(transitions, advantage, returns, values, progress, batches(2)) for each in updates
        )
        assert found == pytest.approx(expected, rel=1e-3, abs=1e-5)
        assert expected["train/clip_fraction"] > 0.0
    assert not torch.equal(theirs.state_dict()["action_net.weight"], before)
    for name, value in theirs.state_dict().items():
        torch.testing.assert_close(ours.state_dict()[name], value, atol=2e-5, rtol=1e-3)
    saved, expected = (each.state_dict() for each in reversed(updates))
    assert saved.keys() == expected.keys()
    for name, array in expected.items():
        assert saved[name] == pytest.approx(array, abs=1e-4, rel=1e-2), name


def test_what_was_saved_of_one_goes_on_in_the_other():
    policy, seen = built("hybrid"), observed("hybrid", True)
    taken, rng = decided(policy, seen), np.random.default_rng(1)
    advantage, returns = (rng.normal(size=shape).astype(np.float32) for shape in ((ROWS,), (ROWS, 1)))
    transitions = of(seen, taken, advantage)
    settings = PPOHyperparameters(batch_size=20)
    first = PPOUpdate(policy, settings, LeanActorCritic(policy, (3, 2)))
    first.update(transitions, advantage, returns, returns[:, 0] * 0.5, 0.0, batches(2))
    weights, state = copy.deepcopy(policy.state_dict()), copy.deepcopy(first.state_dict())
    results = []
    for lean in (False, True):
        other = built("hybrid")
        other.load_state_dict(weights)
        update = PPOUpdate(other, settings, LeanActorCritic(other, (3, 2)) if lean else None)
        update.load_state_dict(state)
        update.update(transitions, advantage, returns, returns[:, 0] * 0.5, 0.0, batches(3))
        results.append(other.state_dict())
    for name, value in results[0].items():
        assert not torch.equal(value, weights[name]), name
        torch.testing.assert_close(results[1][name], value, atol=1e-5, rtol=1e-3)


def test_what_has_more_than_dense_layers_stays_in_torch():
    assert LeanActorCritic.fits(built("hybrid"))
    assert not LeanActorCritic.fits(built("hybrid", shared_critic=True))
    as_wide_as_seen = Behavior("any", (Sensor.of("vector", (16,)),), 2)
    assert not LeanActorCritic.fits(ActorCritic(as_wide_as_seen, hidden_units=16, shared_critic=True))
    picture = Behavior("any", (Sensor.of("camera", (20, 20, 3)),), 2)
    assert not LeanActorCritic.fits(ActorCritic(picture, hidden_units=16))


class TestKernels:
    def test_tanh_is_tanh_to_rounding(self):
        values = np.linspace(-12.0, 12.0, 200_001, dtype=np.float32)[None]
        found = values.copy()
        kernels.add_bias_tanh(found, np.zeros(values.shape[1], np.float32))
        assert found == pytest.approx(np.tanh(values.astype(np.float64)), abs=5e-7)
        assert (np.abs(found) <= 1.0).all()

    def test_swish_and_its_derivative_are_those_to_rounding(self):
        values = np.linspace(-40.0, 40.0, 200_001, dtype=np.float32).reshape(3, -1)
        bias = np.linspace(-1.0, 1.0, values.shape[1], dtype=np.float32)
        found, bend = values - bias, np.empty_like(values)
        kernels.add_bias_swish(found, bias, bend)
        x = torch.from_numpy(values.astype(np.float64)).requires_grad_()
        expected = torch.nn.functional.silu(x)
        expected.sum().backward()
        assert found == pytest.approx(expected.detach().numpy(), abs=1e-5, rel=1e-6)
        assert bend == pytest.approx(x.grad.numpy(), abs=5e-6)
        slope, total = np.full_like(values, 2.0), np.empty(values.shape[1], np.float32)
        kernels.to_before_swish(slope, bend, total)
        assert slope == pytest.approx(2.0 * bend)
        assert total == pytest.approx(slope.sum(axis=0), abs=1e-5)

    def test_swish_is_the_same_without_numba(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "numba", None)
        spec = importlib.util.spec_from_file_location("plain_kernels", kernels.__file__)
        plain = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(plain)
        assert plain.PROBLEM is not None
        rng = np.random.default_rng(0)
        sums, bias, slope = (rng.normal(0.0, 4.0, shape).astype(np.float32) for shape in ((30, 8), 8, (30, 8)))
        results = []
        for module in (kernels, plain):
            made, bend, back, total = sums.copy(), np.empty_like(sums), slope.copy(), np.empty(8, np.float32)
            module.add_bias_swish(made, bias, bend)
            module.to_before_swish(back, bend, total)
            results.append((made, bend, back, total))
        for ours, theirs in zip(*results, strict=True):
            assert ours == pytest.approx(theirs, abs=2e-5)

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_bad_numbers_stay_what_they_are(self, bad):
        values = np.full((3, 16), bad, np.float32)
        kernels.add_bias_tanh(values, np.zeros(16, np.float32))
        assert (np.isnan(values) if np.isnan(bad) else values > 0.999).all()
        slope = np.full((3, 16), bad, np.float32)
        kernels.to_before_tanh(slope, np.zeros((3, 16), np.float32), np.empty(16, np.float32))
        assert not np.isfinite(slope).any()
        values = np.full((3, 16), bad, np.float32)
        kernels.add_bias_swish(values, np.zeros(16, np.float32), slope)
        assert not np.isfinite(values).any()
