"""Curiosity and RND without autograd, for behaviors whose agents observe nothing but vectors, on the CPU.

The networks stay torch's, as views: what is saved, loaded and read is the same as of the modules in torch.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor, nn

from corridor_server.protocol.agents import Behavior
from trainer.learning.kernels import Singles
from trainer.learning.lean_actor_critic import flat
from trainer.learning.networks import Network
from trainer.learning.reward_signals import FORWARD_SHARE, LOSS_FACTOR, CuriosityModule, Observations, RNDModule
from trainer.learning.torch_adam import TorchAdam


class LeanCuriosity(CuriosityModule):
    """``CuriosityModule``, to rounding; see there.

    Args:
        behavior: What agents observe and do; ``sees_vectors_only`` has to hold for it.
        options: Of ``CuriosityModule``.
    """

    def __init__(self, behavior: Behavior, **options: Any) -> None:
        super().__init__(behavior, **options)
        parts = [_layers(self.networks[name]) for name in ("encoder", "inverse_model", "forward_model")]
        self._lean_adam, (self._encoder, self._inverse, self._forward) = _lean(parts)
        self._choices = [np.eye(size, dtype=np.float32) for size in self._branches]

    def reward(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> Singles:
        """See ``CuriosityModule``."""
        count = len(continuous)
        if not self._has_learned:
            return np.zeros(count, np.float32)
        _, features = self._encoder(_both(observations, next_observations))
        _, error = self._forward(np.concatenate((features[:count], self._acted(continuous, discrete)), axis=1))
        error -= features[count:]
        reward: Singles = np.float32(0.5) * np.einsum("ij,ij->i", error, error)
        return np.minimum(reward, np.float32(self._limit))

    def learn(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> dict[str, float]:
        """See ``CuriosityModule``."""
        count, acted = len(continuous), self._acted(continuous, discrete)
        given, features = self._encoder(_both(observations, next_observations))
        size = features.shape[1]
        inverse_given, guessed = self._inverse(np.concatenate((features[:count], features[count:]), axis=1))
        forward_given, error = self._forward(np.concatenate((features[:count], acted), axis=1))
        error -= features[count:]
        forward_loss = 0.5 * float(np.vdot(error, error)) / count
        inverse_loss, slope = self._inverse_error(guessed, acted)

        slope *= np.float32(LOSS_FACTOR * (1.0 - FORWARD_SHARE) / count)
        back = self._inverse.differentiate(inverse_given, slope) @ self._inverse.weights[0]
        both = np.concatenate((back[:, :size], back[:, size:]))
        error *= np.float32(LOSS_FACTOR * FORWARD_SHARE / count)
        back = self._forward.differentiate(forward_given, error)
        both[:count] += back @ self._forward.weights[0][:, :size]
        both[count:] -= error
        self._encoder.differentiate(given, both)
        self._lean_adam.step(self._adam)
        self._has_learned = True
        return {"forward_loss": forward_loss, "inverse_loss": inverse_loss}

    def _inverse_error(self, guessed: Singles, acted: Singles) -> tuple[float, Singles]:
        """The inverse model's mean loss, and its slope for each guess times their number."""
        count, start = len(guessed), self._continuous
        slope = np.empty_like(guessed)
        difference = guessed[:, :start] - acted[:, :start]
        slope[:, :start] = 2.0 * difference
        loss = float(np.square(difference).sum()) / count
        for size in self._branches:
            own = slice(start, start + size)
            logits = guessed[:, own] - guessed[:, own].max(axis=1, keepdims=True)
            logs = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
            loss -= float((logs * acted[:, own]).sum()) / count
            slope[:, own] = np.exp(logs) - acted[:, own]
            start += size
        return loss, slope

    def _acted(self, continuous: Tensor, discrete: Tensor) -> Singles:
        """Actions as the forward model is given them, (n, continuous actions + sum of the branches)."""
        chosen = [ones[discrete[:, branch].numpy()] for branch, ones in enumerate(self._choices)]
        return np.concatenate((continuous.numpy(), *chosen), axis=1)


class LeanRND(RNDModule):
    """``RNDModule``, to rounding; see there.

    Args:
        behavior: What agents observe; ``sees_vectors_only`` has to hold for it.
        options: Of ``RNDModule``.
    """

    def __init__(self, behavior: Behavior, **options: Any) -> None:
        super().__init__(behavior, **options)
        _, (self._target,) = _lean([_layers(self.networks["target"])])
        self._lean_adam, (self._predictor,) = _lean([_layers(self.networks["predictor"])])

    def reward(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> Singles:
        """See ``RNDModule``."""
        rows = _rows(observations)
        error = self._predictor(rows)[1] - self._target(rows)[1]
        reward: Singles = np.einsum("ij,ij->i", error, error)
        return reward

    def learn(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> dict[str, float]:
        """See ``RNDModule``."""
        rows = _rows(observations)
        given, error = self._predictor(rows)
        error -= self._target(rows)[1]
        loss = float(np.vdot(error, error)) / len(error)
        error *= np.float32(2.0 / len(error))
        self._predictor.differentiate(given, error)
        self._lean_adam.step(self._adam)
        return {"rnd_loss": loss}


def _layers(network: nn.Module) -> list[nn.Linear]:
    return [each for each in network.modules() if isinstance(each, nn.Linear)]


def _lean(parts: Sequence[list[nn.Linear]]) -> tuple[TorchAdam, list[Network]]:
    """Networks of these layers, and the Adam that all of them are learned by."""
    adam, networks, start = TorchAdam([each for part in parts for layer in part for each in layer.parameters()]), [], 0
    for part in parts:
        network = Network(part[0].in_features, *(layer.out_features for layer in part))
        own = slice(start, start + network.size)
        network.attach(adam.parameters[own], adam.gradient[own])
        networks.append(network)
        start = own.stop
    return adam, networks


def _rows(observations: Observations) -> Singles:
    return flat([each.numpy() for each in observations])


def _both(observations: Observations, next_observations: Observations) -> Singles:
    return np.concatenate((_rows(observations), _rows(next_observations)))
