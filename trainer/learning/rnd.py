"""Random network distillation (ref. [14], section II-B): what the agent has seldom seen is rewarding."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from trainer.hyperparameters import CuriosityConfig
from trainer.learning.kernels import Singles
from trainer.learning.networks import Network, joined


class RandomNetworkDistillation:
    """A predictor that learns a fixed random network's output; its error is large where it has learned little.

    Has ``IntrinsicCuriosityModule``'s interface; actions play no part.

    Args:
        observation_size: Length of an observation vector.
        action_space: Any.
        config: Sizes and learning rate.
        generator: Draws the fixed network, which the seed alone decides, and the predictor's initial weights.
    """

    def __init__(
        self,
        observation_size: int,
        action_space: spaces.Space[Any],
        config: CuriosityConfig,
        generator: np.random.Generator,
    ) -> None:
        self.target = Network(observation_size, config.hidden_size, config.feature_size)
        self.predictor = Network(observation_size, config.hidden_size, config.feature_size)
        joined((self.target,), generator)
        self.adam = joined((self.predictor,), generator)
        self.scale, self._rate = config.rnd_scale, config.learning_rate

    def intrinsic_reward(self, observations: Singles, actions: Singles, next_observations: Singles) -> Singles:
        """Half the squared distance between predicted and actual output for the next observations, (n,)."""
        _, error = self.predictor(next_observations)
        error -= self.target(next_observations)[1]
        reward: Singles = np.float32(0.5) * np.einsum("ij,ij->i", error, error)
        return reward

    def learn(self, observations: Singles, actions: Singles, next_observations: Singles) -> dict[str, float]:
        """One gradient step on a minibatch; returns its ``rnd_loss``."""
        given, error = self.predictor(next_observations)
        error -= self.target(next_observations)[1]
        loss = 0.5 * float(np.vdot(error, error)) / len(error)
        error /= np.float32(len(error))
        self.predictor.differentiate(given, error)
        self.adam.descend(self._rate)
        return {"rnd_loss": loss}

    def state_dict(self) -> dict[str, Any]:
        """The predictor's weights and moments of Adam; the seed alone decides the other network."""
        return dict(self.adam.state_dict())

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            ValueError: An array is of another size.
        """
        self.adam.load_state_dict(state)
