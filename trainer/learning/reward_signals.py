"""ML-Agents' two intrinsic reward signals, for whatever agents observe and do.

They are ``icm.py`` and ``rnd.py`` in torch, with ML-Agents' sizes, weights and limits instead of the paper's. Networks
have tanh layers and a linear last one, as those two; ML-Agents has swish after every layer of an encoder.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import create_mlp
from torch import Tensor, nn

from corridor_server.protocol.agents import Behavior
from trainer.learning.adam_steps import take_step
from trainer.learning.observation_encoder import ConditioningType, ObservationEncoder, observation_space
from trainer.learning.picture_encoder import EncoderType

Observations = Sequence[Tensor]
HEAD_UNITS = 256
LOSS_FACTOR, FORWARD_SHARE = 10.0, 0.2
MOMENTS = {"moment": "exp_avg", "square": "exp_avg_sq"}  # as networks.Adam calls them, and as torch does


class CuriosityModule:
    """Curiosity: what an agent can't predict of its own doing is rewarding.

    Features of an observation, an inverse model of the action between two, and a forward model of the next features.
    The inverse model tells continuous actions (squared error, summed) and the choice in every branch (cross-entropy,
    summed); the forward model is given continuous actions and choices as ones among zeros. Both models train the
    encoder, on 10 x (0.2 forward + 0.8 inverse).

    In every method observations come in the order of the behavior's sensors, each (n, *shape) float32, and actions as
    ``ActorCritic.act`` gives them.

    Args:
        behavior: What agents observe and do.
        strength: What the caller multiplies the reward by; no reward is above 1 / strength.
        learning_rate: Adam's.
        hidden_units: Units of each layer of the encoder, and how many features it gives.
        num_layers: Layers of the encoder.
        vis_encode_type: The network for pictures.
        goal_conditioning_type: What goal signals do; see ``ObservationEncoder``.
        seed: Decides the initial weights.

    Raises:
        TrainerError: A picture is too small for this network.
    """

    def __init__(
        self,
        behavior: Behavior,
        *,
        strength: float = 1.0,
        learning_rate: float = 3e-4,
        hidden_units: int = 128,
        num_layers: int = 2,
        vis_encode_type: EncoderType = "simple",
        goal_conditioning_type: ConditioningType = "hyper",
        seed: int = 0,
    ) -> None:
        self._continuous, self._branches = behavior.continuous_actions, behavior.discrete_branches
        actions = self._continuous + sum(self._branches)
        with _seeded(seed):
            encoder = _Features(behavior, hidden_units, num_layers, vis_encode_type, goal_conditioning_type)
            self.networks = nn.ModuleDict(
                {
                    "encoder": encoder,
                    "inverse_model": _network(2 * hidden_units, HEAD_UNITS, actions),
                    "forward_model": _network(hidden_units + actions, HEAD_UNITS, hidden_units),
                }
            )
        self._adam = torch.optim.Adam(self.networks.parameters(), lr=learning_rate)
        self._limit = 1.0 / strength if strength > 0 else float("inf")
        self._has_learned = False

    @torch.no_grad()
    def reward(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> NDArray[np.float32]:
        """Half the squared distance between predicted and actual features, (n,); 0 until it has learned once."""
        if not self._has_learned:
            return np.zeros(len(continuous), np.float32)
        features, next_features = self._features(observations, next_observations)
        surprise: Tensor = self._surprise(features, next_features, self._taken(continuous, discrete))
        reward: NDArray[np.float32] = surprise.clamp(max=self._limit).cpu().numpy()
        return reward

    def losses(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> tuple[Tensor, Tensor]:
        """The means over n transitions of the forward and of the inverse model's error."""
        features, next_features = self._features(observations, next_observations)
        forward_loss = self._surprise(features, next_features, self._taken(continuous, discrete)).mean()
        guessed = self.networks["inverse_model"](torch.cat((features, next_features), dim=1))
        inverse_loss = (guessed[:, : self._continuous] - continuous).square().sum(dim=1).mean()
        logits = torch.split(guessed[:, self._continuous :], list(self._branches), dim=1) if self._branches else ()
        for number, branch in enumerate(logits):
            inverse_loss = inverse_loss + nn.functional.cross_entropy(branch, discrete[:, number])
        return forward_loss, inverse_loss

    def learn(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> dict[str, float]:
        """One gradient step on a minibatch; returns its ``forward_loss`` and ``inverse_loss``."""
        forward_loss, inverse_loss = self.losses(observations, continuous, discrete, next_observations)
        _descend(self._adam, LOSS_FACTOR * (FORWARD_SHARE * forward_loss + (1.0 - FORWARD_SHARE) * inverse_loss))
        self._has_learned = True
        return {"forward_loss": forward_loss.item(), "inverse_loss": inverse_loss.item()}

    def state_dict(self) -> dict[str, Any]:
        """Parameters by their names, Adam's moments, and plain values: all that it has learned; copies."""
        return _state(self.networks, self._adam) | {"has_learned": self._has_learned}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            RuntimeError: A parameter or moment is of another size.
        """
        _restore(self.networks, self._adam, state)
        self._has_learned = bool(state["has_learned"])

    def _features(self, observations: Observations, next_observations: Observations) -> tuple[Tensor, Tensor]:
        both = [torch.cat(pair) for pair in zip(observations, next_observations, strict=True)]
        features, next_features = self.networks["encoder"](both).chunk(2)
        return features, next_features

    def _surprise(self, features: Tensor, next_features: Tensor, taken: Tensor) -> Tensor:
        predicted: Tensor = self.networks["forward_model"](torch.cat((features, taken), dim=1))
        return 0.5 * (predicted - next_features).square().sum(dim=1)

    def _taken(self, continuous: Tensor, discrete: Tensor) -> Tensor:
        """Actions as the forward model is given them, (n, continuous actions + sum of the branches)."""
        choices = [nn.functional.one_hot(discrete[:, number], size) for number, size in enumerate(self._branches)]
        return torch.cat((continuous, *(each.to(continuous.dtype) for each in choices)), dim=1)


class RNDModule:
    """Random network distillation: what an agent has seldom seen is rewarding.

    A predictor learns a fixed random network's features of an observation. As in ML-Agents it is the observation that
    was acted on, not the next one as in ``rnd.py``, and the error is the whole squared distance, without a limit, from
    the first step on. It has ``CuriosityModule``'s interface; actions and next observations play no part.

    Args:
        behavior: What agents observe.
        learning_rate: Adam's.
        hidden_units: Units of each layer, and how many features there are.
        num_layers: Layers of both networks.
        vis_encode_type: The network for pictures.
        goal_conditioning_type: What goal signals do; see ``ObservationEncoder``.
        seed: Decides the fixed network, and the predictor's initial weights.

    Raises:
        TrainerError: A picture is too small for this network.
    """

    def __init__(
        self,
        behavior: Behavior,
        *,
        learning_rate: float = 1e-4,
        hidden_units: int = 64,
        num_layers: int = 3,
        vis_encode_type: EncoderType = "simple",
        goal_conditioning_type: ConditioningType = "hyper",
        seed: int = 0,
    ) -> None:
        with _seeded(seed):
            target, predictor = (
                _Features(behavior, hidden_units, num_layers, vis_encode_type, goal_conditioning_type) for _ in range(2)
            )
        self.networks = nn.ModuleDict({"target": target.requires_grad_(False), "predictor": predictor})
        self._adam = torch.optim.Adam(predictor.parameters(), lr=learning_rate)

    @torch.no_grad()
    def reward(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> NDArray[np.float32]:
        """The squared distance between predicted and actual features of the observations, (n,)."""
        reward: NDArray[np.float32] = self._errors(observations).cpu().numpy()
        return reward

    def learn(
        self, observations: Observations, continuous: Tensor, discrete: Tensor, next_observations: Observations
    ) -> dict[str, float]:
        """One gradient step on a minibatch; returns its ``rnd_loss``."""
        loss = self._errors(observations).mean()
        _descend(self._adam, loss)
        return {"rnd_loss": loss.item()}

    def state_dict(self) -> dict[str, Any]:
        """The parameters of both networks by their names, and Adam's moments; copies."""
        return _state(self.networks, self._adam)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
            RuntimeError: A parameter or moment is of another size.
        """
        _restore(self.networks, self._adam, state)

    def _errors(self, observations: Observations) -> Tensor:
        difference: Tensor = self.networks["predictor"](observations) - self.networks["target"](observations)
        return difference.square().sum(dim=1)


class _Features(nn.Module):
    """An encoder of observations with layers behind it."""

    def __init__(
        self,
        behavior: Behavior,
        hidden_units: int,
        num_layers: int,
        vis_encode_type: EncoderType,
        goal_conditioning_type: ConditioningType,
    ) -> None:
        super().__init__()
        self.observations = ObservationEncoder(
            observation_space(behavior),
            behavior.sensors,
            hidden_units=hidden_units,
            vis_encode_type=vis_encode_type,
            goal_conditioning_type=goal_conditioning_type,
        )
        hidden = [hidden_units] * (num_layers - 1)
        self.layers = nn.Sequential(*create_mlp(self.observations.features_dim, hidden_units, hidden, nn.Tanh))

    def forward(self, observations: Observations) -> Tensor:
        """Features, (n, hidden_units)."""
        features: Tensor = self.layers(self.observations.encode(observations))
        return features


def _network(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """A hidden tanh layer and a linear one."""
    return nn.Sequential(*create_mlp(inputs, outputs, [hidden], nn.Tanh))


@contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Draws from a stream of its own inside; torch's stream goes on afterwards as if nothing had been drawn."""
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)  # of the CPU alone, where networks are made
        yield


def _descend(optimizer: torch.optim.Adam, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    take_step(optimizer)


def _state(networks: nn.Module, adam: torch.optim.Adam) -> dict[str, Any]:
    """Parameters by their names, both moments of all that learn as one array each, and how many steps were taken."""
    learning = [each for group in adam.param_groups for each in group["params"]]
    states = [adam.state.get(each, {}) for each in learning]
    moments = {}
    for name, kind in MOMENTS.items():
        parts = [state.get(kind, torch.zeros_like(each)) for state, each in zip(states, learning, strict=True)]
        moments[name] = torch.cat([part.flatten() for part in parts]).cpu().numpy()
    steps = max((int(state["step"]) for state in states if state), default=0)
    return {
        **{name: each.cpu().numpy().copy() for name, each in networks.state_dict().items()},
        **moments,
        "steps": steps,
    }


def _restore(networks: nn.Module, adam: torch.optim.Adam, state: Mapping[str, Any]) -> None:
    networks.load_state_dict({name: torch.from_numpy(state[name].copy()) for name in networks.state_dict()})
    learning = [each for group in adam.param_groups for each in group["params"]]
    adam.state.clear()
    if not state["steps"]:
        return
    sizes = [each.numel() for each in learning]
    split = {
        kind: torch.split(torch.from_numpy(state[name].copy()).to(learning[0].device), sizes)
        for name, kind in MOMENTS.items()
    }
    for number, each in enumerate(learning):
        moments = {kind: parts[number].reshape(each.shape).clone() for kind, parts in split.items()}
        adam.state[each] = {"step": torch.tensor(float(state["steps"])), **moments}
