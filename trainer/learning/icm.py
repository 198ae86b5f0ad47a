"""The intrinsic curiosity module of Fig. 2 (ref. [12]): what the agent can't predict of its own doing is rewarding."""

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from trainer.hyperparameters import CuriosityConfig
from trainer.learning.kernels import Singles
from trainer.learning.networks import Network, joined


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

    def intrinsic_reward(self, observations: Singles, actions: Singles, next_observations: Singles) -> Singles:
        """r_i of eq. 6, (n,): half the squared distance between predicted and actual features.

        Args:
            observations: (n, observation size).
            actions: (n, action size), or (n, 1) choices for Discrete actions.
            next_observations: (n, observation size).
        """
        count = len(observations)
        _, features = self.encoder(np.concatenate((observations, next_observations)))
        _, predicted = self.forward_model(np.concatenate((features[:count], self._inputs(actions)), axis=1))
        predicted -= features[count:]
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
        forward_loss, inverse_loss = self.differentiate(observations, actions, next_observations)
        self.adam.descend(self._rate)
        return {"forward_loss": float(forward_loss), "inverse_loss": float(inverse_loss)}

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
