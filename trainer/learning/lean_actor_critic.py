"""Actor and critic of dense layers, without autograd: the gradient is written out, and Adam works on one vector.

With networks this small, most of torch's time is bookkeeping for each minibatch. Parameters and Adam's moments stay
where torch has them, as views of flat vectors: whoever reads or loads the policy or its optimiser sees these numbers.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from trainer.learning.actor_critic import FORBIDDEN, HALF_LOG_TAU, SMALLEST, ActorCritic
from trainer.learning.networks import SWISH, TANH, Network, Passed
from trainer.learning.torch_adam import TorchAdam
from trainer.learning.transitions import Singles

_ACTIVATIONS = {nn.Tanh: TANH, nn.SiLU: SWISH}
Choices = NDArray[np.int64]
Masks = NDArray[np.bool_]


class Judged(NamedTuple):
    """What a policy makes of n actions.

    Attributes:
        passed: What they left in the actor.
        deviations: How many standard deviations continuous actions are from the means, (n, continuous actions).
        chances: Of each branch, the probability of every choice, (n, choices).
        logs: Their logarithms.
        log_probs: Of the whole actions, (n,).
        entropies: Of the distributions, (n,).
    """

    passed: Passed
    deviations: Singles
    chances: list[Singles]
    logs: list[Singles]
    log_probs: Singles
    entropies: Singles


class LeanActorCritic:
    """A policy's networks in NumPy, to rounding those in torch.

    Args:
        policy: For which ``fits`` holds.
        branches: Sizes of its discrete branches.

    Attributes:
        actor: Gives means and logits, (n, continuous actions + sum of the branches).
        critic: Gives values, (n, value heads).
        log_std: Of continuous actions, (continuous actions,).
        adam: Of all parameters.
    """

    def __init__(self, policy: ActorCriticPolicy | ActorCritic, branches: tuple[int, ...] = ()) -> None:
        actor, critic = _layers(policy)
        assert isinstance(policy.log_std, nn.Parameter)
        parameters = [each for layer in (*actor, *critic) for each in layer.parameters()]
        self.adam = TorchAdam([*parameters, policy.log_std] if len(policy.log_std) else parameters)
        hidden = policy.mlp_extractor.policy_net
        activation = _ACTIVATIONS[type(hidden[1])] if len(hidden) else TANH
        self.actor, self.critic = (
            Network(layers[0].in_features, *(layer.out_features for layer in layers), activation=activation)
            for layers in (actor, critic)
        )
        ends = self.actor.size, self.actor.size + self.critic.size
        flat, gradient = self.adam.parameters, self.adam.gradient
        self.actor.attach(flat[: ends[0]], gradient[: ends[0]])
        self.critic.attach(flat[ends[0] : ends[1]], gradient[ends[0] : ends[1]])
        self.log_std, self._log_std_gradient = flat[ends[1] :], gradient[ends[1] :]
        self._continuous, self._branches = len(self.log_std), branches
        starts = np.cumsum([self._continuous, *branches])
        self._parts = [slice(start, end) for start, end in pairwise(starts.tolist())]

    @staticmethod
    def fits(policy: ActorCriticPolicy | ActorCritic) -> bool:
        """Whether it is an actor and a critic of dense layers and nothing else, with one activation, on the CPU."""
        if not isinstance(policy.log_std, nn.Parameter) or policy.log_std.device.type != "cpu":
            return False
        trunks = (policy.mlp_extractor.policy_net, policy.mlp_extractor.value_net)
        kinds = [[type(each) for each in trunk] for trunk in trunks]  # a critic that has the actor's layers has none
        dense = ([nn.Linear, activation] * (len(kinds[0]) // 2) for activation in _ACTIVATIONS)
        if kinds[0] != kinds[1] or kinds[0] not in dense:
            return False
        actor, critic = _layers(policy)
        known = sum(each.numel() for layer in (*actor, *critic) for each in layer.parameters())
        inputs = actor[0].in_features == critic[0].in_features
        return inputs and known + policy.log_std.numel() == sum(each.numel() for each in policy.parameters())

    def noise(self, count: int) -> tuple[Singles, list[Singles]]:
        """What ``act`` draws actions from, out of torch's stream: as ``ActorCritic.act`` would draw it."""
        normal: Singles = torch.randn(count, self._continuous).numpy() if self._continuous else _nothing(count)
        exponential = [torch.empty(count, size).exponential_().clamp_(min=SMALLEST).numpy() for size in self._branches]
        return normal, exponential

    def act(
        self, observations: Singles, allowed: Masks | None, noise: tuple[Singles, list[Singles]] | None
    ) -> tuple[Singles, Choices, Singles]:
        """Samples actions, or takes the most likely ones where there is no noise; see ``ActorCritic.act``.

        Returns:
            Continuous actions (n, size), choices (n, branches), log probabilities (n,).
        """
        _, outputs = self.actor(observations)
        count = len(outputs)
        normal = noise[0] if noise else np.zeros((count, self._continuous), np.float32)
        continuous: Singles = outputs[:, : self._continuous] + normal * np.exp(self.log_std)
        log_probs = self._normal_log_probs(normal)
        discrete = np.empty((count, len(self._branches)), np.int64)
        rows = np.arange(count)
        for branch, logs in enumerate(self._logs(outputs, allowed)):
            # The largest of logits plus Gumbel noise is a sample of the categorical distribution.
            choice = (logs - np.log(noise[1][branch]) if noise else logs).argmax(axis=1)
            discrete[:, branch] = choice
            log_probs += logs[rows, choice]
        return continuous, discrete, log_probs

    def values(self, observations: Singles) -> Singles:
        """The critic's, (n, value heads)."""
        return self.critic(observations)[1]

    def judge(self, observations: Singles, allowed: Masks | None, continuous: Singles, discrete: Choices) -> Judged:
        """What the policy now makes of actions that were taken, as ``act`` gave them."""
        passed, outputs = self.actor(observations)
        deviations = (continuous - outputs[:, : self._continuous]) * np.exp(-self.log_std)
        log_probs = self._normal_log_probs(deviations)
        entropies = np.full_like(log_probs, self.log_std.sum() + self._continuous * (0.5 + HALF_LOG_TAU))
        rows, logs = np.arange(len(outputs)), self._logs(outputs, allowed)
        chances = [np.exp(branch) for branch in logs]
        for branch, each in enumerate(logs):
            log_probs += each[rows, discrete[:, branch]]
            entropies -= np.einsum("ij,ij->i", chances[branch], each)
        return Judged(passed, deviations, chances, logs, log_probs, entropies)

    def differentiate_actor(self, judged: Judged, discrete: Choices, slope: Singles, entropy_slope: float) -> None:
        """Fills in the gradient of the actor and of the deviations.

        Args:
            judged: What ``judge`` gave.
            discrete: The choices that it was given.
            slope: d loss / d log probability, (n,).
            entropy_slope: d loss / d mean entropy.
        """
        deviations, rows = judged.deviations, np.arange(len(slope))
        self._log_std_gradient[:] = slope @ (np.square(deviations) - 1.0) + entropy_slope
        columns = [slope[:, None] * deviations * np.exp(-self.log_std)]
        each = np.float32(entropy_slope / len(slope))
        for branch, (chances, logs) in enumerate(zip(judged.chances, judged.logs, strict=True)):
            own_entropy = np.einsum("ij,ij->i", chances, logs)
            back = chances * (each * (own_entropy[:, None] - logs) - slope[:, None])
            back[rows, discrete[:, branch]] += slope
            columns.append(back)
        self.actor.differentiate(judged.passed, columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1))

    def _logs(self, outputs: Singles, allowed: Masks | None) -> list[Singles]:
        """Of each branch, the log probabilities of its choices, (n, choices)."""
        found = []
        for part in self._parts:
            logits = outputs[:, part]
            if allowed is not None:
                own = allowed[:, part.start - self._continuous : part.stop - self._continuous]
                logits = np.where(own, logits, np.float32(FORBIDDEN))
            logits = logits - logits.max(axis=1, keepdims=True)
            found.append(logits - np.log(np.exp(logits).sum(axis=1, keepdims=True)))
        return found

    def _normal_log_probs(self, deviations: Singles) -> Singles:
        """Of actions that are so many standard deviations, (n, continuous actions), from their means; (n,)."""
        constant = np.float32(self._continuous * HALF_LOG_TAU) + self.log_std.sum()
        log_probs: Singles = np.einsum("ij,ij->i", deviations, deviations) * np.float32(-0.5) - constant
        return log_probs


def policy_loss(
    log_ratio: Singles, advantage: Singles, clip_range: float
) -> tuple[Singles, tuple[float, float, float]]:
    """PPO's clipped loss (eq. 5).

    Args:
        log_ratio: Logarithm of the actions' probability now, over that when they were taken, (n,).
        advantage: Of them, (n,), normalised.
        clip_range: How far a ratio from 1 still counts.

    Returns:
        d loss / d log probability, (n,), and the loss, the share of clipped ratios, and the approximate KL divergence.
    """
    ratio = np.exp(log_ratio)
    difference = ratio - np.float32(1.0)
    outside = np.abs(difference) > clip_range
    plain = advantage * ratio
    clipped = advantage * np.clip(ratio, np.float32(1.0 - clip_range), np.float32(1.0 + clip_range))
    # A clipped ratio that is the smaller of the two has no gradient.
    slope = np.where(outside & (clipped < plain), np.float32(0.0), plain / np.float32(-len(plain)))
    loss = -float(np.minimum(plain, clipped).mean())
    return slope, (loss, float(outside.mean()), float((difference - log_ratio).mean()))


def flat(observations: Sequence[Singles]) -> Singles:
    """Observations of several sensors, (n, *shape) each, as one row for each agent."""
    rows = [each.reshape(len(each), -1) for each in observations]
    return rows[0] if len(rows) == 1 else np.concatenate(rows, axis=1)


def normalised(advantage: Singles) -> Singles:
    """Of a minibatch, with mean 0 and deviation 1; a single one as it is."""
    if len(advantage) < 2:
        return advantage
    found: Singles = (advantage - advantage.mean()) / (advantage.std(ddof=1) + np.float32(1e-8))
    return found


def _layers(policy: ActorCriticPolicy | ActorCritic) -> tuple[list[nn.Linear], list[nn.Linear]]:
    """The dense layers of the actor and of the critic."""
    trunks = (policy.mlp_extractor.policy_net, policy.mlp_extractor.value_net)
    heads = (policy.action_net, policy.value_net)
    actor, critic = (
        [layer for layer in (*trunk, head) if isinstance(layer, nn.Linear)]
        for trunk, head in zip(trunks, heads, strict=True)
    )
    return actor, critic


def _nothing(count: int) -> Singles:
    return np.empty((count, 0), np.float32)
