"""Curiosity and RND for every kind of behavior, by hand and against the NumPy modules; what is learned and kept."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import Tensor

from corridor_server.protocol.agents import Behavior, Sensor
from trainer.hyperparameters import CuriosityConfig
from trainer.learning.icm import IntrinsicCuriosityModule
from trainer.learning.lean_reward_signals import LeanCuriosity, LeanRND
from trainer.learning.reward_signals import CuriosityModule, RNDModule
from trainer.learning.rnd import RandomNetworkDistillation

VECTOR = Sensor.of("vector", (4,))
EVERYTHING = (
    VECTOR,
    Sensor.of("camera", (8, 8, 2)),
    Sensor.of("buffer", (3, 2)),
    Sensor("goal", (2,), (1,), 1),
)
BEHAVIORS = {
    "continuous": Behavior("any", (VECTOR,), 2),
    "discrete": Behavior("any", (VECTOR,), 0, (3,)),
    "branched": Behavior("any", (VECTOR,), 0, (3, 2)),
    "hybrid": Behavior("any", EVERYTHING, 2, (3, 2)),
}
ROWS = 32
Columns = tuple[list[Tensor], Tensor, Tensor, list[Tensor]]


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)  # as in training; more wait for each other where cores are shared


def transitions(behavior: Behavior, rows: int = ROWS, seed: int = 1) -> Columns:
    stream = torch.Generator().manual_seed(seed)
    first, second = (
        [torch.rand(rows, *sensor.shape, generator=stream) for sensor in behavior.sensors] for _ in range(2)
    )
    continuous = torch.randn(rows, behavior.continuous_actions, generator=stream)
    choices = [torch.randint(size, (rows, 1), generator=stream) for size in behavior.discrete_branches]
    return first, continuous, torch.cat(choices, dim=1) if choices else torch.zeros(rows, 0, dtype=torch.int64), second


@pytest.mark.parametrize("discrete", [False, True])
def test_with_equal_weights_the_losses_are_those_of_the_numpy_module(discrete):
    behavior = BEHAVIORS["discrete" if discrete else "continuous"]
    module = CuriosityModule(behavior, hidden_units=256)
    config = CuriosityConfig(feature_size=256, hidden_size=256)
    space = spaces.Discrete(3) if discrete else spaces.Box(-1, 1, (2,), np.float32)
    reference = IntrinsicCuriosityModule(4, space, config, np.random.default_rng(1))
    layers = {
        reference.encoder: module.networks["encoder"].layers,
        reference.inverse_model: module.networks["inverse_model"],
        reference.forward_model: module.networks["forward_model"],
    }
    for network, ours in layers.items():
        for array, parameter in zip(
            (network.weights[0], network.biases[0], network.weights[1], network.biases[1]),
            ours.parameters(),
            strict=True,
        ):
            array[...] = parameter.detach().numpy()
    (observations,), continuous, choices, (next_observations,) = transitions(behavior)
    columns = observations.numpy(), (choices if discrete else continuous).numpy(), next_observations.numpy()
    expected_forward, expected_inverse = reference.differentiate(*columns)
    losses = module.learn([observations], continuous, choices, [next_observations])
    assert losses["forward_loss"] == pytest.approx(expected_forward, rel=1e-5)
    # The NumPy module takes the mean over an action's numbers, ML-Agents their sum.
    assert losses["inverse_loss"] == pytest.approx(expected_inverse * (1 if discrete else 2), rel=1e-5)


def test_the_reward_is_half_the_squared_error_of_the_features_by_hand():
    columns = transitions(BEHAVIORS["branched"])
    module = CuriosityModule(BEHAVIORS["branched"], strength=0.01)
    module.learn(*columns)
    (observations,), _, choices, (next_observations,) = columns
    encode, predict = module.networks["encoder"], module.networks["forward_model"]
    for row in range(3):
        taken = torch.zeros(5)
        taken[choices[row, 0]] = taken[3 + choices[row, 1]] = 1.0
        features = encode([observations[row : row + 1]])[0]
        error = predict(torch.cat((features, taken))) - encode([next_observations[row : row + 1]])[0]
        assert module.reward(*columns)[row] == pytest.approx(0.5 * error.square().sum().item(), rel=1e-5)


def test_the_inverse_loss_sums_over_numbers_and_branches_by_hand():
    columns = transitions(BEHAVIORS["hybrid"], rows=2)
    module = CuriosityModule(BEHAVIORS["hybrid"])
    first, continuous, choices, second = columns
    guessed = module.networks["inverse_model"](
        torch.cat((module.networks["encoder"](first), module.networks["encoder"](second)), dim=1)
    )
    expected = torch.zeros(())
    for row in range(2):
        expected += (guessed[row, :2] - continuous[row]).square().sum()
        expected -= guessed[row, 2:5].log_softmax(dim=0)[choices[row, 0]]
        expected -= guessed[row, 5:].log_softmax(dim=0)[choices[row, 1]]
    _, inverse_loss = module.losses(*columns)
    torch.testing.assert_close(inverse_loss, expected / 2)


def test_a_step_goes_down_ten_times_the_weighted_losses():
    behavior, columns = BEHAVIORS["hybrid"], transitions(BEHAVIORS["hybrid"])
    module, other = CuriosityModule(behavior, learning_rate=1e-3), CuriosityModule(behavior, learning_rate=1e-3)
    forward_loss, inverse_loss = other.losses(*columns)
    (2.0 * forward_loss + 8.0 * inverse_loss).backward()
    torch.optim.Adam(other.networks.parameters(), lr=1e-3).step()
    module.learn(*columns)
    pairs = list(zip(module.networks.parameters(), other.networks.parameters(), strict=True))
    assert all(torch.allclose(ours, theirs, atol=1e-6) for ours, theirs in pairs)
    assert all(ours.grad.any() for ours, _ in pairs)


def test_nothing_is_rewarding_before_the_first_update_and_nothing_more_than_one_over_strength():
    columns = transitions(BEHAVIORS["continuous"])
    module = CuriosityModule(BEHAVIORS["continuous"], strength=0.02)
    assert not module.reward(*columns).any()
    module.learn(*columns)
    free = module.reward(*columns)
    assert free.dtype == np.float32
    assert free.shape == (ROWS,)
    assert (free > 0).all()
    middle = float(np.median(free))
    limited = CuriosityModule(BEHAVIORS["continuous"], strength=1 / middle)
    limited.learn(*columns)
    np.testing.assert_allclose(limited.reward(*columns), np.minimum(free, middle), rtol=1e-5)


@pytest.mark.parametrize("behavior", BEHAVIORS.values(), ids=BEHAVIORS)
@pytest.mark.parametrize("kind", [CuriosityModule, RNDModule])
def test_what_is_seen_again_and_again_becomes_boring(kind, behavior):
    module, seen = kind(behavior, learning_rate=1e-3), transitions(behavior)
    observations, continuous, choices, next_observations = transitions(behavior, seed=2)
    unseen = [-2 * each for each in observations], continuous, choices, [-2 * each for each in next_observations]
    module.learn(*seen)
    before = module.reward(*seen).mean()
    for _ in range(100):
        losses = module.learn(*seen)
    assert all(math.isfinite(each) for each in losses.values())
    assert module.reward(*seen).mean() < before / 2
    assert module.reward(*unseen).mean() > 1.5 * module.reward(*seen).mean()


def test_the_inverse_model_learns_which_action_led_from_one_observation_to_the_next():
    behavior = BEHAVIORS["hybrid"]
    module = CuriosityModule(behavior, learning_rate=1e-3)
    for step in range(150):
        first, continuous, choices, second = transitions(behavior, seed=step)
        second[0] = first[0].clone()
        second[0][:, :2] += continuous
        second[0][:, 2] += choices[:, 0]
        second[0][:, 3] += choices[:, 1]
        losses = module.learn(first, continuous, choices, second)
        if step == 0:
            at_first = losses["inverse_loss"]
    assert losses["inverse_loss"] < at_first / 3


def test_rnd_rewards_the_observation_that_was_acted_on_by_its_whole_squared_error():
    columns = transitions(BEHAVIORS["continuous"])
    module = RNDModule(BEHAVIORS["continuous"])
    (observations,), *_ = columns
    distance = module.networks["predictor"]([observations]) - module.networks["target"]([observations])
    expected = distance.square().sum(dim=1)
    np.testing.assert_allclose(module.reward(*columns), expected.detach().numpy(), rtol=1e-5)
    assert module.learn(*columns)["rnd_loss"] == pytest.approx(expected.mean().item(), rel=1e-5)


def test_with_equal_weights_rnds_reward_is_twice_that_of_the_numpy_module():
    module = RNDModule(BEHAVIORS["continuous"], hidden_units=64, num_layers=2)
    config = CuriosityConfig(feature_size=64, hidden_size=64)
    reference = RandomNetworkDistillation(4, spaces.Box(-1, 1, (2,)), config, np.random.default_rng(1))
    for network, name in ((reference.target, "target"), (reference.predictor, "predictor")):
        ours = module.networks[name].layers.parameters()
        for array, parameter in zip(
            (network.weights[0], network.biases[0], network.weights[1], network.biases[1]), ours, strict=True
        ):
            array[...] = parameter.detach().numpy()
    columns = transitions(BEHAVIORS["continuous"])
    acted_on = columns[0][0].numpy()
    expected = 2 * reference.intrinsic_reward(acted_on, columns[1].numpy(), acted_on)
    np.testing.assert_allclose(module.reward(*columns), expected, rtol=1e-4)


def test_rnds_target_never_learns():
    module = RNDModule(BEHAVIORS["hybrid"])
    before = {name: each.clone() for name, each in module.networks.state_dict().items()}
    module.learn(*transitions(BEHAVIORS["hybrid"]))
    changed = {
        name.split(".")[0] for name, each in module.networks.state_dict().items() if (each != before[name]).any()
    }
    assert changed == {"predictor"}


@pytest.mark.parametrize("kind", [CuriosityModule, RNDModule])
def test_the_seed_alone_decides_the_networks_and_disturbs_no_other_stream(kind):
    behavior = BEHAVIORS["hybrid"]
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    one, same, other = kind(behavior, seed=7), kind(behavior, seed=7), kind(behavior, seed=8)
    assert torch.equal(torch.rand(3), expected)
    ours, theirs, others = (list(each.networks.parameters()) for each in (one, same, other))
    assert all(torch.equal(*pair) for pair in zip(ours, theirs, strict=True))
    assert not any(torch.equal(*pair) for pair in zip(ours, others, strict=True) if pair[0].std() > 0)


@pytest.mark.parametrize("updates", [0, 3])
@pytest.mark.parametrize("kind", [CuriosityModule, RNDModule, LeanCuriosity, LeanRND])
def test_one_that_takes_up_what_another_wrote_down_goes_on_as_it(kind, updates):
    behavior = BEHAVIORS["branched" if kind in (LeanCuriosity, LeanRND) else "hybrid"]
    columns = transitions(behavior)
    module = kind(behavior, seed=1)
    for _ in range(updates):
        module.learn(*columns)
    state = module.state_dict()
    written = {name: value if isinstance(value, np.ndarray) else json.dumps(value) for name, value in state.items()}
    taken_up = kind(behavior, seed=2)
    taken_up.learn(*columns)
    read = {name: value if isinstance(value, np.ndarray) else json.loads(value) for name, value in written.items()}
    taken_up.load_state_dict(read)
    for _ in range(2):
        assert np.array_equal(taken_up.reward(*columns), module.reward(*columns))
        assert taken_up.learn(*columns) == module.learn(*columns)
    assert all(np.array_equal(written[name], state[name]) for name in written if name not in ("steps", "has_learned"))


@pytest.mark.parametrize("layers", [1, 2, 3])
@pytest.mark.parametrize("kind", ["continuous", "discrete", "branched", "hybrid"])
@pytest.mark.parametrize("pair", [(CuriosityModule, LeanCuriosity), (RNDModule, LeanRND)])
def test_without_autograd_rewards_and_steps_are_the_same(pair, kind, layers):
    behavior = replace(BEHAVIORS[kind], sensors=(VECTOR, Sensor.of("more", (3,))))
    theirs, ours = (each(behavior, hidden_units=16, num_layers=layers, learning_rate=0.01, seed=4) for each in pair)
    for step in range(4):
        columns = transitions(behavior, seed=step)
        np.testing.assert_allclose(ours.reward(*columns), theirs.reward(*columns), rtol=2e-3)
        if step == 2:  # one takes up where the other was
            state = theirs.state_dict()
            theirs.load_state_dict(ours.state_dict())
            ours.load_state_dict(state)
        assert ours.learn(*columns) == pytest.approx(theirs.learn(*columns), rel=1e-3)
    expected, found = theirs.state_dict(), ours.state_dict()
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-2, atol=2e-4, err_msg=name)


@pytest.mark.parametrize("kind", [CuriosityModule, RNDModule, LeanCuriosity, LeanRND])
def test_a_state_of_other_networks_is_refused(kind):
    module = kind(BEHAVIORS["continuous"])
    state = module.state_dict()
    with pytest.raises(KeyError, match="moment"):
        kind(BEHAVIORS["continuous"]).load_state_dict({k: v for k, v in state.items() if k != "moment"} | {"steps": 1})
    with pytest.raises(RuntimeError, match="size mismatch"):
        kind(BEHAVIORS["continuous"], hidden_units=32).load_state_dict(state)
