"""The actor-critic's distributions are Stable-Baselines3's and sb3-contrib's, to rounding; a mask is never broken."""

import math

import numpy as np
import pytest
import torch
from sb3_contrib.common.maskable.distributions import MaskableMultiCategoricalDistribution
from stable_baselines3.common.distributions import DiagGaussianDistribution, MultiCategoricalDistribution
from torch import Tensor

from corridor_server.protocol.agents import Behavior, Sensor
from trainer.learning.actor_critic import ActorCritic

BRANCHES = (3, 2, 4)
ROWS = 64
SENSORS = (Sensor.of("vector", (5,)),)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)  # as in training; more wait for each other where cores are shared


def built(continuous: int = 0, branches: tuple[int, ...] = (), **options) -> ActorCritic:
    """With outputs that differ from agent to agent more than at the beginning."""
    torch.manual_seed(3)
    network = ActorCritic(Behavior("any", SENSORS, continuous, branches), hidden_units=16, **options)
    with torch.no_grad():
        network.action_net.weight.mul_(15.0)
        network.log_std.uniform_(-1.0, 0.5)
    return network


def outputs(network: ActorCritic, observations: Tensor) -> Tensor:
    features = network.encoder.encode([observations])
    return network.action_net(network.mlp_extractor.policy_net(features))


def masks(branches: tuple[int, ...], rows: int = ROWS) -> Tensor:
    """At least one choice of each branch is allowed."""
    each = [torch.rand(rows, size) < 0.5 for size in branches]
    for branch in each:
        branch[torch.arange(rows), torch.randint(branch.shape[1], (rows,))] = True
    return torch.cat(each, dim=1)


def gradients(network: ActorCritic, log_probs: Tensor, entropy: Tensor) -> list[Tensor]:
    loss = (log_probs * torch.linspace(-1.0, 2.0, len(log_probs))).sum() + 0.3 * entropy.sum()
    parameters = [
        each for name, each in network.named_parameters() if name.startswith(("mlp_extractor.policy", "action", "log"))
    ]
    return [each for each in torch.autograd.grad(loss, parameters, allow_unused=True) if each is not None]


def assert_same(network, observations, allowed, acted, log_probs, entropy):
    """What the network says of actions is what a reference says of them, with its gradients."""
    _, ours, our_entropy = network.evaluate([observations], allowed, acted.continuous, acted.discrete)
    torch.testing.assert_close(ours, log_probs)
    torch.testing.assert_close(our_entropy, entropy)
    torch.testing.assert_close(acted.log_probs, log_probs.detach(), atol=1e-5, rtol=1e-5)
    expected = gradients(network, log_probs, entropy)
    found = gradients(network, ours, our_entropy)
    assert sum(each.abs().sum() for each in expected) > 1.0
    torch.testing.assert_close(found, expected)


def test_continuous_actions_are_stable_baselines3s():
    network, observations = built(continuous=2), torch.randn(ROWS, 5)
    reference = DiagGaussianDistribution(2)
    reference.proba_distribution(outputs(network, observations), network.log_std)
    assert torch.equal(network.act([observations], None, deterministic=True).continuous, reference.mode())
    acted = network.act([observations], None)
    assert acted.discrete.shape == (ROWS, 0)
    assert_same(network, observations, None, acted, reference.log_prob(acted.continuous), reference.entropy())


def test_samples_are_distributed_normally():
    network, observations = built(continuous=2), torch.randn(1, 5).expand(20_000, 5)
    sampled = network.act([observations], None).continuous
    mean = outputs(network, observations[:1])[0]
    torch.testing.assert_close(sampled.mean(dim=0), mean, atol=0.05, rtol=0.0)
    torch.testing.assert_close(sampled.std(dim=0), network.log_std.exp(), atol=0.05, rtol=0.0)


def test_branches_are_stable_baselines3s():
    network, observations = built(branches=BRANCHES), torch.randn(ROWS, 5)
    reference = MultiCategoricalDistribution(list(BRANCHES)).proba_distribution(outputs(network, observations))
    assert torch.equal(network.act([observations], None, deterministic=True).discrete, reference.mode())
    acted = network.act([observations], None)
    assert acted.continuous.shape == (ROWS, 0)
    assert_same(network, observations, None, acted, reference.log_prob(acted.discrete), reference.entropy())


def test_masked_branches_are_sb3_contribs():
    network, observations, allowed = built(branches=BRANCHES), torch.randn(ROWS, 5), masks(BRANCHES)
    reference = MaskableMultiCategoricalDistribution(list(BRANCHES)).proba_distribution(outputs(network, observations))
    reference.apply_masking(allowed.numpy())
    assert torch.equal(network.act([observations], allowed, deterministic=True).discrete, reference.mode())
    acted = network.act([observations], allowed)
    assert_same(network, observations, allowed, acted, reference.log_prob(acted.discrete), reference.entropy())


def test_a_hybrid_action_is_the_sum_of_both():
    network, observations, allowed = built(continuous=2, branches=BRANCHES), torch.randn(ROWS, 5), masks(BRANCHES)
    out = outputs(network, observations)
    normal = DiagGaussianDistribution(2).proba_distribution(out[:, :2], network.log_std)
    reference = MaskableMultiCategoricalDistribution(list(BRANCHES)).proba_distribution(out[:, 2:])
    reference.apply_masking(allowed.numpy())
    acted = network.act([observations], allowed)
    log_probs = normal.log_prob(acted.continuous) + reference.log_prob(acted.discrete)
    assert_same(network, observations, allowed, acted, log_probs, normal.entropy() + reference.entropy())


def test_choices_come_as_often_as_their_probabilities_say():
    network, rows = built(branches=(3, 4)), 40_000
    observations = torch.randn(1, 5).expand(rows, 5)
    allowed = torch.tensor([[True, False, True, True, True, False, True]]).expand(rows, 7)
    chosen = network.act([observations], allowed).discrete
    logits = outputs(network, observations[:1])[0].masked_fill(~allowed[0], -math.inf)
    for branch, expected in enumerate((logits[:3].softmax(0), logits[3:].softmax(0))):
        shares = torch.bincount(chosen[:, branch], minlength=len(expected)) / rows
        torch.testing.assert_close(shares, expected, atol=0.01, rtol=0.0)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_of_100000_actions_with_94_percent_forbidden_none_is_forbidden(scale):
    branches, rows = (100, 50), 100_000
    network = built(branches=branches)
    with torch.no_grad():
        network.action_net.weight.mul_(scale)
    allowed = torch.zeros(rows, 150, dtype=torch.bool)
    allowed[torch.arange(rows)[:, None], torch.rand(rows, 100).argsort(dim=1)[:, :6]] = True
    allowed[torch.arange(rows)[:, None], 100 + torch.rand(rows, 50).argsort(dim=1)[:, :3]] = True
    assert allowed.float().mean() == pytest.approx(0.06)
    for deterministic in (False, True):
        acted = network.act([torch.randn(rows, 5)], allowed, deterministic)
        places = acted.discrete + torch.tensor([0, 100])
        assert allowed.gather(1, places).all()
        assert acted.log_probs.isfinite().all()


def test_a_forbidden_choice_has_no_part_in_entropy_and_gradient():
    network, observations = built(branches=(4,)), torch.randn(ROWS, 5)
    allowed = torch.tensor([[True, False, True, False]]).expand(ROWS, 4)
    acted = network.act([observations], allowed)
    _, log_probs, entropy = network.evaluate([observations], allowed, acted.continuous, acted.discrete)
    assert entropy.max() <= math.log(2) + 1e-6
    (slope,) = torch.autograd.grad((log_probs + entropy).sum(), [network.action_net.bias])
    assert not slope[[1, 3]].any()
    assert slope[[0, 2]].all()


@pytest.mark.parametrize("nothing", [False, True])
def test_one_choice_left_is_certain_and_none_left_is_as_if_unmasked(nothing):
    network, observations = built(branches=(3,)), torch.randn(ROWS, 5)
    allowed = torch.zeros(ROWS, 3, dtype=torch.bool)
    allowed[:, 1] = not nothing
    acted = network.act([observations], allowed)
    _, _, entropy = network.evaluate([observations], allowed, acted.continuous, acted.discrete)
    assert entropy.isfinite().all()
    if nothing:
        assert set(acted.discrete.flatten().tolist()) == {0, 1, 2}
    else:
        assert (acted.discrete == 1).all()
        assert not acted.log_probs.any()
        assert not entropy.any()


@pytest.mark.parametrize("shared", [False, True])
def test_the_critic_has_a_value_for_each_reward_signal(shared):
    network, observations = built(continuous=1, value_heads=3, shared_critic=shared), torch.randn(ROWS, 5)
    acted = network.act([observations], None)
    values, _, _ = network.evaluate([observations], None, acted.continuous, acted.discrete)
    assert values.shape == (ROWS, 3)
    torch.testing.assert_close(network.values([observations]), values.detach())
    assert not network.values([observations]).requires_grad
    (actors,) = torch.autograd.grad(values.sum(), [network.mlp_extractor.policy_net[0].weight], allow_unused=True)
    assert (actors is not None) is shared
    assert len(list(network.mlp_extractor.value_net.parameters())) == (0 if shared else 4)


def test_layers_begin_as_ml_agents_do():
    torch.manual_seed(0)
    network = ActorCritic(Behavior("any", SENSORS, 2), hidden_units=400, log_std_init=-0.5)
    first, second = network.mlp_extractor.policy_net[0], network.mlp_extractor.policy_net[2]
    for layer, gain in ((first, 1.0), (second, 1.0), (network.action_net, 0.2)):
        assert layer.weight.std().item() == pytest.approx(gain / layer.in_features**0.5, rel=0.1)
    widest = (6.0 / (400 + 1)) ** 0.5
    assert 0.9 * widest < network.value_net.weight.abs().max().item() <= widest
    assert not any(layer.bias.any() for layer in (first, second, network.action_net, network.value_net))
    assert (network.log_std == -0.5).all()


def test_everything_at_once_learns_to_choose_by_what_it_sees():
    sensors = (
        *SENSORS,
        Sensor.of("camera", (6, 6, 1)),
        Sensor.of("buffer", (4, 3)),
        Sensor("goal", (2,), (1,), 1),
    )
    torch.manual_seed(1)
    network = ActorCritic(Behavior("any", sensors, 1, (2,)), hidden_units=32)
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    for step in range(100):
        goals = torch.randint(2, (64,))
        observations = [torch.rand(64, *sensor.shape) for sensor in sensors[:3]] + [torch.eye(2)[goals]]
        acted = network.act(observations, None, deterministic=step == 99)
        hits = (acted.discrete[:, 0] == goals).float()
        near = (acted.continuous[:, 0] - observations[0][:, 0]).abs()
        reward = hits - near.clamp(max=2.0)
        _, log_probs, _ = network.evaluate(observations, None, acted.continuous, acted.discrete)
        optimizer.zero_grad()
        (-(reward - reward.mean()) / reward.std() * log_probs).mean().backward()
        optimizer.step()
    assert hits.mean() > 0.95
    assert near.mean() < np.float32(0.25)
