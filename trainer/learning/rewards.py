"""The rewards that a behavior is learned from: the environment's, and those that are learned with it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from corridor_server.protocol.agents import Behavior
from trainer.behavior_settings import BehaviorSettings, NetworkSettings
from trainer.learning.lean_reward_signals import LeanCuriosity, LeanRND
from trainer.learning.observation_encoder import sees_vectors_only
from trainer.learning.reward_signals import CuriosityModule, RNDModule
from trainer.learning.tensors import CPU
from trainer.learning.transitions import Singles


class IntrinsicReward(Protocol):
    """A reward that is learned."""

    def reward(
        self,
        observations: Sequence[Tensor],
        continuous: Tensor,
        discrete: Tensor,
        next_observations: Sequence[Tensor],
        /,
    ) -> Singles:
        """Of n transitions, (n,) float32, before its strength."""

    def learn(
        self,
        observations: Sequence[Tensor],
        continuous: Tensor,
        discrete: Tensor,
        next_observations: Sequence[Tensor],
        /,
    ) -> dict[str, float]:
        """One gradient step on a minibatch; its losses by name."""

    def state_dict(self) -> Mapping[str, Any]:
        """All that it has learned."""

    def load_state_dict(self, state: Any, /) -> None:
        """Takes over what ``state_dict`` gave."""


class Signal(NamedTuple):
    """A reward that a behavior learns from.

    Attributes:
        name: ``extrinsic``, ``curiosity`` or ``rnd``.
        strength: Factor on it.
        gamma: Its discount factor.
        module: Gives it; None for the environment's own.
    """

    name: str
    strength: float
    gamma: float
    module: IntrinsicReward | None = None


def build_signals(
    behavior: Behavior, settings: BehaviorSettings, seed: int, device: torch.device = CPU
) -> tuple[Signal, ...]:
    """The rewards that a behavior's settings ask for, the environment's first.

    Args:
        behavior: What its agents observe and do.
        settings: How it is trained.
        seed: Of the networks' initial weights.
        device: Where they compute.
    """
    asked, found = settings.reward_signals, list[Signal]()

    def is_lean(network: NetworkSettings) -> bool:
        return device.type == "cpu" and sees_vectors_only(behavior, network.goal_conditioning_type)

    if asked.extrinsic is not None:
        found.append(Signal("extrinsic", asked.extrinsic.strength, asked.extrinsic.gamma))
    if asked.curiosity is not None:
        signal, network = asked.curiosity, asked.curiosity.network_settings
        curiosity = (LeanCuriosity if is_lean(network) else CuriosityModule)(
            behavior,
            strength=signal.strength,
            learning_rate=signal.learning_rate,
            hidden_units=network.hidden_units,
            num_layers=network.num_layers,
            vis_encode_type=network.vis_encode_type,
            goal_conditioning_type=network.goal_conditioning_type,
            seed=seed,
        )
        curiosity.networks.to(device)
        found.append(Signal("curiosity", signal.strength, signal.gamma, curiosity))
    if asked.rnd is not None:
        own, network = asked.rnd, asked.rnd.network_settings
        novelty = (LeanRND if is_lean(network) else RNDModule)(
            behavior,
            learning_rate=own.learning_rate,
            hidden_units=network.hidden_units,
            num_layers=network.num_layers,
            vis_encode_type=network.vis_encode_type,
            goal_conditioning_type=network.goal_conditioning_type,
            seed=seed,
        )
        novelty.networks.to(device)
        found.append(Signal("rnd", own.strength, own.gamma, novelty))
    return tuple(found)
