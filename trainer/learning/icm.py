"""The intrinsic curiosity module of Fig. 2 (ref. [12]): what the agent can't predict of its own doing is rewarding."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from trainer.hyperparameters import CuriosityConfig
from trainer.learning.kernels import Singles
from trainer.learning.networks import Network, joined

LEAST_WEIGHT = 0.004  # of a minibatch in the features' running moments: about the last 250 of them count
TINY = np.float32(1e-6)  # the least variance: a feature that never changes


class IntrinsicCuriosityModule:
    """Encoder phi, inverse model (phi, phi' -> action) and forward model (phi, action -> phi').

    Args:
        observation_size: Length of an observation vector.
        action_space: Box (the inverse model's error is squared) or Discrete (cross-entropy).
        config: Sizes, weights and learning rate.
        generator: Draws the initial weights.

    Raises:
        ValueError: The action space is of another kind.
    """

    def __init__(
        self,
        observation_size: int,
        action_space: spaces.Space[NDArray[np.float32]],
        config: CuriosityConfig,
        generator: np.random.Generator,
    ) -> None:
        if isinstance(action_space, spaces.Box):
            self._choices, action_size = 0, int(np.prod(action_space.shape))
        elif isinstance(action_space, spaces.Discrete):
            self._choices = action_size = int(action_space.n)
        else:
            raise ValueError(
                f"Curiosity takes Box or Discrete actions, not {action_space}; flatten branched actions first."
            )
        hidden, self._features = config.hidden_size, config.feature_size
        self.encoder = Network(observation_size, hidden, self._features)
        self.inverse_model = Network(2 * self._features, hidden, action_size)
        self.forward_model = Network(self._features + action_size, hidden, self._features)
        self.adam = joined((self.encoder, self.inverse_model, self.forward_model), generator)
        self.scale = config.scale
        self._forward_weight = np.float32(config.forward_weight)
        self.adam.factors[: self.encoder.size] = config.encoder_rate
        self._rate = config.learning_rate
        self._over_variance = config.feature_error == "over_variance"
        self._mean, self._variance = np.zeros(self._features, np.float32), np.ones(self._features, np.float32)
        self._minibatches = 0

    def intrinsic_reward(self, observations: Singles, actions: Singles, next_observations: Singles) -> Singles:
        """r_i of eq. 6, (n,): half the squared distance between predicted and actual features.

        With ``over_variance`` each feature's part is divided by its running variance.

        Args:
            observations: (n, observation size).
            actions: (n, action size), or (n, 1) choices for Discrete actions.
            next_observations: (n, observation size).
        """
        count = len(observations)
        _, features = self.encoder(np.concatenate((observations, next_observations)))
        _, predicted = self.forward_model(np.concatenate((features[:count], self._inputs(actions)), axis=1))
        predicted -= features[count:]
        if self._over_variance:
            predicted /= np.sqrt(self._variance)
        reward: Singles = np.float32(0.5) * np.einsum("ij,ij->i", predicted, predicted)
        return reward

    def differentiate(
        self, observations: Singles, actions: Singles, next_observations: Singles
    ) -> tuple[np.float32, np.float32]:
        """Fills in the gradient of the weighted sum of both models' mean errors; returns the two means."""
        count, size = len(observations), self._features
        taken = self._inputs(actions)
        both = np.concatenate((observations, next_observations))
        given, features = self.encoder(both)
        inverse_inputs = np.concatenate((features[:count], features[count:]), axis=1)
        inverse_given, guessed = self.inverse_model(inverse_inputs)
        forward_inputs = np.concatenate((features[:count], taken), axis=1)
        forward_given, predicted = self.forward_model(forward_inputs)

        inverse_loss, guessed_slope = self._inverse_error(guessed, taken)
        guessed_slope *= (np.float32(1.0) - self._forward_weight) / np.float32(count)
        error = predicted - features[count:]
        forward_loss = np.float32(0.5) * np.vdot(error, error) / np.float32(count)
        error *= self._forward_weight / np.float32(count)

        back = self.inverse_model.differentiate(inverse_given, guessed_slope) @ self.inverse_model.weights[0]
        slope = np.concatenate((back[:, :size], back[:, size:]))
        back = self.forward_model.differentiate(forward_given, error)
        slope[:count] += back @ self.forward_model.weights[0][:, :size]
        slope[count:] -= error
        self.encoder.differentiate(given, slope)
        return forward_loss, inverse_loss

    def learn(self, observations: Singles, actions: Singles, next_observations: Singles) -> dict[str, float]:
        """One gradient step on a minibatch; returns its ``forward_loss`` and ``inverse_loss``."""
        if self._over_variance:
            self._note(self.encoder(next_observations)[1])
        forward_loss, inverse_loss = self.differentiate(observations, actions, next_observations)
        self.adam.descend(self._rate)
        return {"forward_loss": float(forward_loss), "inverse_loss": float(inverse_loss)}

    def state_dict(self) -> dict[str, Any]:
        """Weights and moments of Adam; with ``over_variance`` those of the features, too."""
        moments = {"mean": self._mean.copy(), "variance": self._variance.copy(), "minibatches": self._minibatches}
        own = {f"features/{name}": value for name, value in moments.items()} if self._over_variance else {}
        return {**self.adam.state_dict(), **own}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            ValueError: An array is of another size.
        """
        self.adam.load_state_dict(state)
        if self._over_variance:
            self._mean[:], self._variance[:] = state["features/mean"], state["features/variance"]
            self._minibatches = int(state["features/minibatches"])

    def _note(self, features: Singles) -> None:
        """Takes a minibatch's features into their running mean and variance."""
        weight = np.float32(max(1 / (self._minibatches + 1), LEAST_WEIGHT))
        self._mean += weight * (features.mean(axis=0) - self._mean)
        self._variance += weight * (np.square(features - self._mean).mean(axis=0) - self._variance)
        np.maximum(self._variance, TINY, out=self._variance)
        self._minibatches += 1

    def _inputs(self, actions: Singles) -> Singles:
        if not self._choices:
            return actions
        return np.eye(self._choices, dtype=np.float32)[actions.astype(np.intp).ravel()]

    def _inverse_error(self, guessed: Singles, taken: Singles) -> tuple[np.float32, Singles]:
        """The mean error of guessed actions, and its slope for each, (n, action size), times n."""
        if not self._choices:
            difference = guessed - taken
            return np.float32(np.vdot(difference, difference) / difference.size), difference * np.float32(
                2.0 / difference.shape[1]
            )
        logits = guessed - guessed.max(axis=1, keepdims=True)
        log_sums = np.log(np.exp(logits).sum(axis=1, keepdims=True))
        log_chances = logits - log_sums
        return np.float32(-(log_chances * taken).sum() / len(taken)), np.exp(log_chances) - taken
