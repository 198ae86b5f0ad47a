"""PufferLib's PuffeRL, with the same networks: its PPO draws whole segments by priority, and corrects with V-trace."""

import contextlib
import math
import sys
from typing import Any

import numpy as np
import pufferlib
import torch
from gymnasium import spaces
from pufferlib.pufferl import PuffeRL
from torch import Tensor, nn
from torch.distributions import Normal

from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.peer_settings import PeerSettings
from trainer.bench.peers.turns import Turns

FOR_EVER = 10**12


class PufferCorridor(pufferlib.PufferEnv):  # type: ignore[misc]  # it has no type information
    """Every area is an agent of a native environment.

    Args:
        corridor: The areas.
    """

    def __init__(self, corridor: CorridorArrays) -> None:
        self.corridor = corridor
        self.num_agents = self.agents_per_batch = len(corridor)
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (corridor.size,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (corridor.action_size,), np.float32)
        super().__init__()

    def reset(self, seed: int | None = None) -> tuple[Any, list[Any]]:
        """Begins an episode in every area."""
        self.observations[:] = self.corridor.reset()
        return self.observations, []

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, list[Any]]:
        """Steps every area."""
        stepped = self.corridor.step(actions)
        self.observations[:] = stepped.observations
        self.rewards[:], self.terminals[:], self.truncations[:] = stepped[1:4]
        return self.observations, self.rewards, self.terminals, self.truncations, []

    def close(self) -> None:
        """Nothing is open."""


class PufferPolicy(nn.Module):
    """An actor and a critic of two tanh layers each."""

    def __init__(self, size: int, action_size: int, hidden: int, log_std: float) -> None:
        super().__init__()

        def network(outputs: int) -> nn.Sequential:
            layers = nn.Linear(size, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh()
            return nn.Sequential(*layers, nn.Linear(hidden, outputs))

        self.actor, self.critic = network(action_size), network(1)
        self.log_std = nn.Parameter(torch.full((1, action_size), log_std))

    def forward_eval(self, observations: Tensor, state: Any = None) -> tuple[Normal, Tensor]:
        """The distribution of actions, and values, (n, 1)."""
        mean = self.actor(observations)
        return Normal(mean, self.log_std.expand_as(mean).exp()), self.critic(observations)

    def forward(self, observations: Tensor, state: Any = None) -> tuple[Normal, Tensor]:
        """The same, for learning."""
        return self.forward_eval(observations, state)


def main(settings: PeerSettings) -> None:
    """Learns in turns."""
    torch.manual_seed(settings.seed)
    corridor = CorridorArrays(settings.areas, settings.seed, settings.corridor, normalised=True)
    policy = PufferPolicy(corridor.size, corridor.action_size, settings.hidden_size, settings.log_std_init)
    config = {
        "env": "corridor",
        "seed": settings.seed,
        "device": "cpu",
        "cpu_offload": False,
        "torch_deterministic": True,
        "precision": "float32",
        "compile": False,
        "use_rnn": False,
        "optimizer": "adam",
        "adam_beta1": 0.9,
        "adam_beta2": 0.999,
        "adam_eps": 1e-8,
        "anneal_lr": False,
        "learning_rate": settings.learning_rate,
        "total_timesteps": FOR_EVER,
        "batch_size": settings.rollout,
        "bptt_horizon": settings.n_steps,
        "minibatch_size": settings.batch_size,
        "max_minibatch_size": settings.batch_size,
        "update_epochs": settings.epochs,
        "gamma": settings.gamma,
        "gae_lambda": settings.gae_lambda,
        "clip_coef": settings.clip_range,
        "vf_coef": settings.vf_coef,
        "vf_clip_coef": settings.clip_range_vf,
        "ent_coef": settings.ent_coef,
        "max_grad_norm": settings.max_grad_norm,
        "vtrace_rho_clip": 1.0,
        "vtrace_c_clip": 1.0,
        "prio_alpha": 0.8,
        "prio_beta0": 0.2,
        "data_dir": ".",
        "checkpoint_interval": FOR_EVER,
    }
    # Its dashboard goes where nobody reads it.
    with contextlib.redirect_stdout(sys.stderr):
        learner = PuffeRL(config, PufferCorridor(corridor), policy)
    turns = Turns(settings.warm_up)
    while turns.goes_on(corridor.steps, corridor.reward, learner.losses.get("value_loss", math.nan)):
        with contextlib.redirect_stdout(sys.stderr):
            learner.evaluate()
            learner.train()
    learner.utilization.stop()


if __name__ == "__main__":
    main(PeerSettings.given())
