"""What a peer's program is told."""

import json
import sys
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class PeerSettings:
    """PPO as every peer is to do it; names are Stable-Baselines3's.

    Attributes:
        areas: Of the corridor.
        n_steps: Steps of each area in an update.
        minibatches: That an update's steps are cut into.
        epochs: Passes over an update's steps.
        learning_rate: Adam's.
        gamma: Discount factor.
        gae_lambda: Generalised advantage estimation's lambda.
        clip_range: Of the policy's ratios.
        clip_range_vf: Of the values, where a peer can clip them.
        vf_coef: Weight of the value loss.
        ent_coef: Weight of the entropy bonus.
        max_grad_norm: Limit of the gradient's norm.
        hidden_size: Units in each of the two hidden tanh layers of actor and critic.
        log_std_init: Logarithm of the actions' standard deviation at the beginning.
        c: Curiosity's strength, which only ours has.
        port: Where a player finds the trainer; None has the corridor in process.
        seed: Of the corridor and of the networks.
        corridor: Environment parameters by name.
        warm_up: Updates before anything is measured.
    """

    areas: int
    n_steps: int
    minibatches: int
    epochs: int
    learning_rate: float
    gamma: float
    gae_lambda: float
    clip_range: float
    clip_range_vf: float
    vf_coef: float
    ent_coef: float
    max_grad_norm: float
    hidden_size: int
    log_std_init: float
    c: float = 0.0
    port: int | None = None
    seed: int = 0
    corridor: dict[str, Any] = field(default_factory=dict)
    warm_up: int = 10

    @property
    def rollout(self) -> int:
        """Agent steps in an update."""
        return self.areas * self.n_steps

    @property
    def batch_size(self) -> int:
        """Agent steps in a minibatch."""
        return self.rollout // self.minibatches

    def to_json(self) -> str:
        """On one line."""
        return json.dumps(asdict(self))

    @staticmethod
    def given() -> "PeerSettings":
        """Those on the command line."""
        return PeerSettings(**json.loads(sys.argv[1]))
