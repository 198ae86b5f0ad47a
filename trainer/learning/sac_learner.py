"""Stable-Baselines3's SAC for one behavior with continuous actions, with ML-Agents' settings."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger

from corridor_server.protocol.agents import Agents, Behavior
from trainer.behavior_settings import BehaviorSettings, SACHyperparameters
from trainer.errors import TrainerError
from trainer.learning.adam_state import adam_state, load_adam_state
from trainer.learning.learner import LOSS_TAGS, Learner, part_of
from trainer.learning.observation_encoder import ObservationEncoder, observation_space
from trainer.learning.ppo_update import LEAST_RATE, scheduled
from trainer.learning.replay_memory import ReplayMemory
from trainer.learning.rewards import Signal
from trainer.learning.tensors import CPU, tensors
from trainer.learning.transitions import Decided, Observed


class SACLearner(Learner):
    """Learns one behavior, whatever its teams.

    As in ML-Agents, the policy itself, not a uniform one, fills the buffer; the first update comes once that has a
    minibatch and ``buffer_init_steps`` are behind, and updates that were due by then are made up for. All rewards are
    added up before the critics, of which ML-Agents has a pair for each.

    Args:
        behavior: What its agents observe and do.
        settings: How it is learned.
        signals: The rewards that it is learned from.
        device: Where its networks compute.

    Attributes:
        updates: Gradient steps.

    Raises:
        TrainerError: Its actions are not continuous, its rewards are discounted differently, or its replay buffer does
            not fit into memory.
    """

    def __init__(
        self, behavior: Behavior, settings: BehaviorSettings, signals: tuple[Signal, ...], device: torch.device = CPU
    ) -> None:
        assert isinstance(settings.hyperparameters, SACHyperparameters)
        _check(behavior, signals)
        super().__init__(behavior, settings, signals, device)
        self._own = own = settings.hyperparameters
        try:
            self._sac = self._build()
        except MemoryError as error:
            raise TrainerError(
                f"The replay buffer of behavior {_name(behavior)} does not fit into memory ({error}); lower its "
                f"buffer_size of {own.buffer_size}."
            ) from error
        self._sac.set_logger(Logger(None, []))
        self.policy = self._sac.policy
        assert isinstance(self._sac.replay_buffer, ReplayMemory)
        self.replay = self._sac.replay_buffer
        self._signal_updates = 0

    def learn(self) -> bool:
        """Stores what was taken, and makes the updates that are due; see ``Learner.learn``."""
        transitions = self._take_closed()
        self.replay.store(transitions)
        updates, signal_updates = self._due(self.learned, self.replay.size())
        if updates:
            with self._finite():
                self._sac.train(updates, self._own.batch_size)
            self.updates += updates
            self._note()
        if signal_updates and self.is_curious:
            self._learn_signals(signal_updates)
        self._signal_updates += signal_updates
        return True

    def state_dict(self) -> dict[str, Any]:
        """All of it, between two messages: arrays and plain values, by ``<part>/<name>``."""
        parts: dict[str, Mapping[str, Any]] = {
            name: adam_state(optimizer) for name, optimizer in self._optimizers().items()
        }
        if self._own.save_replay_buffer:
            parts["replay"] = self.replay.state_dict()
        return {
            **super().state_dict(),
            **{f"{part}/{name}": value for part, state in parts.items() for name, value in state.items()},
            "entropy": self._log_entropy_coefficient.detach().cpu().numpy(),
            "signal_updates": self._signal_updates,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave, running episodes too.

        Raises:
            KeyError: Something is missing.
            RuntimeError: The policy has other parameters.
            ValueError: The replay buffer is of another size.
        """
        super().load_state_dict(state)
        for name, optimizer in self._optimizers().items():
            load_adam_state(optimizer, part_of(state, name))
        if self._own.save_replay_buffer:
            self.replay.load_state_dict(part_of(state, "replay"))
        with torch.no_grad():
            self._log_entropy_coefficient.copy_(torch.from_numpy(state["entropy"]))
        self._signal_updates = state["signal_updates"]

    @property
    def _rate(self) -> float:
        return scheduled(self._own.learning_rate, LEAST_RATE, self._own.learning_rate_schedule, self.progress)

    @property
    def _log_entropy_coefficient(self) -> torch.Tensor:
        assert self._sac.log_ent_coef is not None
        return self._sac.log_ent_coef

    def _build(self) -> SAC:
        network = self.settings.network_settings
        return SAC(
            "MultiInputPolicy",
            _Spaces(self.behavior),
            learning_rate=lambda _: self._rate,
            buffer_size=self._own.buffer_size,
            tau=self._own.tau,
            gamma=self._signals[0].gamma,
            ent_coef=f"auto_{self._own.init_entcoef}",
            replay_buffer_class=ReplayMemory,
            replay_buffer_kwargs={"scaling": self.observations, "signals": self._signals},
            policy_kwargs={
                "optimizer_kwargs": {"fused": True},
                "net_arch": [network.hidden_units] * network.num_layers,
                "features_extractor_class": ObservationEncoder,
                "features_extractor_kwargs": {
                    "sensors": self.behavior.sensors,
                    "hidden_units": network.hidden_units,
                    "vis_encode_type": network.vis_encode_type,
                    "goal_conditioning_type": network.goal_conditioning_type,
                },
            },
            device=self._device,
        )

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        entropy = self._sac.ent_coef_optimizer
        assert entropy is not None
        return {
            "actor_optimizer": self._sac.actor.optimizer,
            "critic_optimizer": self._sac.critic.optimizer,
            "entropy_optimizer": entropy,
        }

    def _is_enough(self, transitions: int) -> bool:
        steps, stored = self.learned + transitions, self.replay.size() + transitions
        if not transitions:
            return False
        return steps >= self.settings.max_steps or transitions >= self._own.batch_size or any(self._due(steps, stored))

    def _due(self, steps: int, stored: int) -> tuple[int, int]:
        """How many updates of the policy and of reward signals have to be made after so many steps."""
        own = self._own
        beyond = steps - own.buffer_init_steps
        if beyond < 0 or stored < own.batch_size:
            return 0, 0
        return (
            max(int(beyond / own.steps_per_update) - self.updates, 0),
            max(int(beyond / own.reward_signal_steps_per_update) - self._signal_updates, 0),
        )

    @torch.no_grad()
    def _decide(self, observed: Observed, deterministic: bool) -> Decided:
        scaled = tensors(self.observations.scaled(observed.observations), self._device)
        named = {f"obs_{number}": each for number, each in enumerate(scaled)}
        with self._finite():
            actions = self._sac.actor(named, deterministic).cpu().numpy()
        count = len(actions)
        return Decided(actions, np.zeros((count, 0), np.int64), np.zeros(count, np.float32))

    @contextmanager
    def _finite(self) -> Iterator[None]:
        """Has torch's refusal to draw from a distribution around NaN said in the run's own words."""
        try:
            yield
        except ValueError as error:
            raise self._diverged() from error

    def _observed(self, agents: Agents) -> Observed:
        """As they came: they are scaled when they are drawn."""
        return Observed(tuple(np.asarray(each, np.float32) for each in agents.observations))

    def _learn_signals(self, updates: int) -> None:
        losses: dict[str, list[float]] = {}
        for _ in range(updates):
            drawn = self.replay.sample(self._own.batch_size)
            choices = torch.zeros(len(drawn.actions), 0, dtype=torch.int64, device=self._device)
            before, after = (list(each.values()) for each in (drawn.observations, drawn.next_observations))
            for signal in self._signals:
                if signal.module is not None:
                    for name, loss in signal.module.learn(before, drawn.actions, choices, after).items():
                        losses.setdefault(LOSS_TAGS[name], []).append(loss)
        self.metrics |= {tag: float(np.mean(values)) for tag, values in losses.items()}

    def _note(self) -> None:
        """Takes over what Stable-Baselines3 has recorded, by ML-Agents' tags too."""
        recorded = {tag: float(value) for tag, value in self._sac.logger.name_to_value.items()}
        self.metrics |= recorded | {
            "Losses/Policy Loss": recorded["train/actor_loss"],
            "Policy/Continuous Entropy Coeff": recorded["train/ent_coef"],
            "Policy/Learning Rate": recorded["train/learning_rate"],
        }
        if self.is_curious:
            self.metrics["rollout/intrinsic_reward"] = self.replay.intrinsic_reward


class _Spaces(gymnasium.Env[Any, Any]):
    """What agents observe and do, as Stable-Baselines3 asks for it; nobody steps in it."""

    def __init__(self, behavior: Behavior) -> None:
        self.observation_space = observation_space(behavior)
        self.action_space = spaces.Box(-1.0, 1.0, (behavior.continuous_actions,), np.float32)


def _check(behavior: Behavior, signals: Sequence[Signal]) -> None:
    """Refuses what this SAC can't learn.

    Raises:
        TrainerError: Actions are not continuous, or rewards are discounted differently.
    """
    name = _name(behavior)
    if behavior.discrete_branches or not behavior.continuous_actions:
        has = f"discrete branches {list(behavior.discrete_branches)}" if behavior.discrete_branches else "no actions"
        raise TrainerError(
            f"Behavior {name} has {has}, but Stable-Baselines3's SAC takes continuous actions alone; give it "
            "trainer_type: ppo."
        )
    if len({signal.gamma for signal in signals}) > 1:
        gammas = ", ".join(f"{signal.name} {signal.gamma:g}" for signal in signals)
        raise TrainerError(
            f"The reward signals of behavior {name} have different discount factors ({gammas}), but with sac one "
            "critic values their sum; give all of them the same gamma."
        )


def _name(behavior: Behavior) -> str:
    return behavior.name.partition("?")[0]
