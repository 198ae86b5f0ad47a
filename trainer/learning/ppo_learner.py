"""PPO for one behavior of any kind, with a value head for each reward if so wished."""

import copy
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import torch

from corridor_server.protocol.agents import Behavior
from trainer.behavior_settings import BehaviorSettings, PPOHyperparameters
from trainer.learning.actor_critic import ActorCritic
from trainer.learning.lean_actor_critic import LeanActorCritic, flat
from trainer.learning.learner import LOSS_TAGS, Learner, part_of, tensors_of
from trainer.learning.ppo_update import PPOUpdate, minibatches
from trainer.learning.rewards import IntrinsicReward, Signal
from trainer.learning.tensors import CPU, tensor, tensors
from trainer.learning.transitions import (
    Decided,
    EndedEpisode,
    Indices,
    Observed,
    Singles,
    Transitions,
    advantages,
)

CHUNK = 1024  # observations that are valued at once: pictures need memory


class _Updated(NamedTuple):
    """What an update made of transitions.

    Attributes:
        metrics: What there is to log.
        episodes: Of each transition, (n,).
        intrinsic: Its rewards of the learner's own making, (n,); None if there are none.
        over: Episodes that had ended when they were taken.
    """

    metrics: dict[str, float]
    episodes: Indices
    intrinsic: Singles | None
    over: list[int]


class PPOLearner(Learner):
    """Learns one behavior, whatever its teams.

    With ``threaded`` an update runs beside the next steps: agents are decided for with the policy before it until there
    is enough for the next one. When that is depends on steps alone, never on who is fast.

    Args:
        behavior: What its agents observe and do.
        settings: How it is learned.
        signals: The rewards that it is learned from.
        seed: Of the minibatches.
        device: Where its networks compute.
    """

    policy: ActorCritic

    def __init__(
        self,
        behavior: Behavior,
        settings: BehaviorSettings,
        signals: tuple[Signal, ...],
        seed: int,
        device: torch.device = CPU,
    ) -> None:
        assert isinstance(settings.hyperparameters, PPOHyperparameters)
        self._own = settings.hyperparameters
        self._heads = 1 if self._own.value_heads == "one" else len(signals)
        super().__init__(behavior, settings, signals, device)
        network = settings.network_settings
        self.policy = ActorCritic(
            behavior,
            hidden_units=network.hidden_units,
            num_layers=network.num_layers,
            vis_encode_type=network.vis_encode_type,
            goal_conditioning_type=network.goal_conditioning_type,
            value_heads=self._heads,
            shared_critic=self._own.shared_critic,
        )
        self.policy.to(device)
        self._acting_policy = copy.deepcopy(self.policy) if settings.threaded else self.policy
        self._lean = _lean(self.policy, behavior)
        self._acting_lean = _lean(self._acting_policy, behavior) if settings.threaded else self._lean
        self._beside = ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(1,))
        self._running: Future[_Updated] | None = None
        self._ppo = PPOUpdate(self.policy, self._own, self._lean)
        self._generator = np.random.default_rng(seed)
        # A terminated episode is worth nothing more to the environment's reward; of curiosity there is more to come.
        ends = [float(signal.module is not None) for signal in signals] if self._heads > 1 else [0.0]
        self._after_end = np.array(ends, np.float32)
        self._sums: dict[int, float] = {}  # of intrinsic rewards, by episode
        self._over: list[int] = []  # episodes that ended since the last update

    def learn(self) -> bool:
        """Makes an update of what was taken, or begins one; see ``Learner.learn``."""
        self.finish()
        transitions = self._take_closed()
        progress = self.progress
        over, self._over = self._over, []
        if self.settings.threaded and not self.is_done:
            self._running = self._beside.submit(self._update, transitions, over, progress)
            return False
        self._conclude(self._update(transitions, over, progress))
        self._act_as_learned()
        return True

    def finish(self) -> bool:
        """Waits for an update that runs beside; from here on, agents are decided for with what it made."""
        was_running = self._wait()
        self._act_as_learned()
        return was_running

    def play(self) -> None:
        """See ``Learner.play``."""
        self.finish()
        super().play()

    def state_dict(self) -> dict[str, Any]:
        """All of it, between two messages: arrays and plain values, by ``<part>/<name>``."""
        self._wait()
        acting = self._acting_policy.state_dict() if self.settings.threaded else {}
        return {
            **super().state_dict(),
            **{f"acting/{name}": each.cpu().numpy() for name, each in acting.items()},
            **{f"optimizer/{name}": value for name, value in self._ppo.state_dict().items()},
            "sums": [[number, total] for number, total in self._sums.items()],
            "over": list(self._over),
            "random": self._generator.bit_generator.state,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave, running episodes too.

        Raises:
            KeyError: Something is missing.
            RuntimeError: The policy has other parameters.
        """
        super().load_state_dict(state)
        if self.settings.threaded:
            self._acting_policy.load_state_dict(tensors_of(part_of(state, "acting")))
        self._ppo.load_state_dict(part_of(state, "optimizer"))
        self._sums = {int(number): total for number, total in state["sums"]}
        self._over = list(state["over"])
        self._generator.bit_generator.state = state["random"]

    def load_policy(self, state: Mapping[str, Any]) -> None:
        """See ``Learner.load_policy``."""
        super().load_policy(state)
        self._act_as_learned()

    def _update(self, transitions: Transitions, over: list[int], progress: float) -> _Updated:
        """Learns from transitions; of what the main thread changes meanwhile, it touches nothing."""
        worth = self._values(transitions.observations)
        self._check_finite(worth)
        values, next_values = worth[transitions.seen], worth[transitions.next_seen]
        next_values[transitions.terminated] *= self._after_end
        rewards = self._rewards(transitions)
        advantage, returns = self._targets(transitions, rewards, values, next_values)
        batches = [each for _ in range(self._own.num_epoch) for each in self._minibatches(transitions)]
        metrics = self._ppo.update(transitions, advantage, returns, values[:, 0], progress, batches)
        for head, signal in enumerate(self._signals[: self._heads]):
            estimate = float(values[:, head].mean())
            metrics[f"Policy/{signal.name.capitalize()} Value Estimate"] = estimate
        metrics |= self._learn_signals(transitions)
        own = [each for each, signal in zip(rewards, self._signals, strict=True) if signal.module is not None]
        return _Updated(metrics, transitions.episodes, np.sum(own, axis=0) if own else None, over)

    def _wait(self) -> bool:
        """Waits for an update that runs beside; whether there was one."""
        if self._running is None:
            return False
        running, self._running = self._running, None
        self._conclude(running.result())
        return True

    def _conclude(self, updated: _Updated) -> None:
        self.metrics |= updated.metrics
        if updated.intrinsic is not None:
            self._add_up(updated.episodes, updated.intrinsic, updated.over)
        self.updates += 1

    def _act_as_learned(self) -> None:
        if self.settings.threaded:
            self._acting_policy.load_state_dict(self.policy.state_dict())

    def _is_enough(self, transitions: int) -> bool:
        return transitions >= min(self._own.buffer_size, self.settings.max_steps - self.learned)

    def _decide(self, observed: Observed, deterministic: bool) -> Decided:
        if self._acting_lean is not None:
            rows = flat(observed.observations)
            noise = None if deterministic else self._acting_lean.noise(len(rows))
            return Decided(*self._acting_lean.act(rows, observed.allowed, noise))
        acted = self._acting_policy.act(
            tensors(observed.observations, self._device), tensor(observed.allowed, self._device), deterministic
        )
        return Decided(*(part.cpu().numpy() for part in acted))

    def _ended(self, episodes: list[EndedEpisode]) -> None:
        self._over.extend(episode.number for episode in episodes)

    def _values(self, observations: tuple[Singles, ...]) -> Singles:
        if self._lean is not None:
            return self._lean.values(flat(observations))
        parts = [
            self.policy.values(tensors([each[start : start + CHUNK] for each in observations], self._device)).cpu()
            for start in range(0, len(observations[0]), CHUNK)
        ]
        values: Singles = torch.cat(parts).numpy()
        return values

    def _rewards(self, transitions: Transitions) -> list[Singles]:
        """Of each signal, (n,), times its strength."""
        return [
            (transitions.rewards if signal.module is None else self._reward(signal.module, transitions))
            * np.float32(signal.strength)
            for signal in self._signals
        ]

    def _reward(self, module: IntrinsicReward, transitions: Transitions) -> Singles:
        seen, then = (tensors(each, self._device) for each in (transitions.observed, transitions.next_observed))
        decided = transitions.decided
        continuous, discrete = tensors((decided.continuous, decided.discrete), self._device)
        return module.reward(seen, continuous, discrete, then)

    def _add_up(self, episodes: Indices, rewards: Singles, over: list[int]) -> None:
        """Adds intrinsic rewards to their episodes, and takes those that are over into the last ones' window."""
        numbers, which = np.unique(episodes, return_inverse=True)
        for number, total in zip(numbers.tolist(), np.bincount(which, rewards).tolist(), strict=True):
            self._sums[number] = self._sums.get(number, 0.0) + total
        self.recent["intrinsic"].extend(self._sums.pop(number, 0.0) for number in over)
        expected = self.experience.running | {*self._over}  # a player that died says no end of its episodes
        self._sums = {number: total for number, total in self._sums.items() if number in expected}
        self.metrics["rollout/intrinsic_reward"] = float(rewards.mean())

    def _targets(
        self, transitions: Transitions, rewards: list[Singles], values: Singles, next_values: Singles
    ) -> tuple[Singles, Singles]:
        """The advantages, (n,), and what each value head is to say, (n, heads)."""
        if self._heads == 1:
            rewards = [np.sum(rewards, axis=0, dtype=np.float32)]
        gammas, lambd = [signal.gamma for signal in self._signals], self._own.lambd
        each = [
            advantages(transitions.previous, own, values[:, head], next_values[:, head], gammas[head], lambd)
            for head, own in enumerate(rewards)
        ]
        stacked = np.stack(each, axis=1)
        return stacked.mean(axis=1), stacked + values

    def _minibatches(self, transitions: Transitions) -> list[Indices]:
        return list(minibatches(len(transitions), self._own.batch_size, self._generator))

    def _learn_signals(self, transitions: Transitions) -> dict[str, float]:
        """Has each signal that learns go through the transitions once; what there is to log."""
        observations, decided = tensors(transitions.observations, self._device), transitions.decided
        places = tensors((transitions.seen, transitions.next_seen), self._device)
        continuous, discrete = tensors((decided.continuous, decided.discrete), self._device)
        metrics = {}
        for signal in self._signals:
            if signal.module is None:
                continue
            losses = []
            for indices in self._minibatches(transitions):
                rows = torch.from_numpy(indices).to(self._device)
                before, after = ([each[place[rows]] for each in observations] for place in places)
                losses.append(signal.module.learn(before, continuous[rows], discrete[rows], after))
            for name in losses[0]:
                metrics[LOSS_TAGS[name]] = float(np.mean([loss[name] for loss in losses]))
        return metrics


def _lean(policy: ActorCritic, behavior: Behavior) -> LeanActorCritic | None:
    """A policy in NumPy, if it has such a form."""
    return LeanActorCritic(policy, behavior.discrete_branches) if LeanActorCritic.fits(policy) else None
