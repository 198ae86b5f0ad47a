"""PPO for one behavior of any kind: agents come, go and ask when they like; a value head for each reward if so wished.

The path of a step: ``take`` closes what agents' last actions led to, ``learn`` makes an update of it once there is
enough, and ``act`` decides for all agents that asked.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from trainer.behavior_settings import BehaviorSettings, PPOHyperparameters
from trainer.errors import TrainerError
from trainer.learning.actor_critic import ActorCritic
from trainer.learning.experience import Asking, Experience
from trainer.learning.observation_scaling import ObservationScaling
from trainer.learning.ppo_update import CPU, PPOUpdate, minibatches, tensor, tensors
from trainer.learning.rewards import Signal
from trainer.learning.transitions import Decided, Observed, Singles, Transitions, advantages, joined

WINDOW = 100  # episodes that running means are over
LOSS_TAGS = {
    "forward_loss": "Losses/Curiosity Forward Loss",
    "inverse_loss": "Losses/Curiosity Inverse Loss",
    "rnd_loss": "Losses/RND Loss",
}


_Columns = tuple[tuple[Tensor, ...], Tensor, Tensor, tuple[Tensor, ...]]


class _Waiting(NamedTuple):
    """Agents of one player and behavior that wait for an action."""

    player: int
    behavior: str
    observed: Observed
    asking: Asking | None  # None for agents that are not learned from any more


class PPOLearner:
    """Learns one behavior, whatever its teams.

    Args:
        behavior: What its agents observe and do.
        settings: How it is learned.
        signals: The rewards that it is learned from.
        seed: Of the minibatches.
        device: Where its networks compute.

    Attributes:
        updates: How many updates were made.
        episodes: How many episodes have ended.
        metrics: Of the last update, by the tags of Stable-Baselines3 and ML-Agents.
        ended_returns: Of episodes that ended since whoever reads this has emptied it.
        recent: Of the last episodes, ``returns``, ``lengths`` and, as far as it was paid, ``intrinsic`` rewards.
    """

    def __init__(
        self,
        behavior: Behavior,
        settings: BehaviorSettings,
        signals: tuple[Signal, ...],
        seed: int,
        device: torch.device = CPU,
    ) -> None:
        assert isinstance(settings.hyperparameters, PPOHyperparameters)
        self.behavior, self.settings, self._own = behavior, settings, settings.hyperparameters
        self._signals = signals
        self._heads = 1 if self._own.value_heads == "one" else len(signals)
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
        self._device = device
        self.policy.to(device)
        self._ppo = PPOUpdate(self.policy, self._own)
        self.observations = ObservationScaling(behavior, network.normalize)
        self.experience = Experience(behavior, self._heads, settings.time_horizon)
        self._generator = np.random.default_rng(seed)
        self._waiting: list[_Waiting] = []
        # A terminated episode is worth nothing more to the environment's reward; of curiosity there is more to come.
        ends = [float(signal.module is not None) for signal in signals] if self._heads > 1 else [0.0]
        self._after_end = np.array(ends, np.float32)
        self._learned = self.updates = self.episodes = 0
        self._plays = False
        self.metrics: dict[str, float] = {}
        self.recent = {name: deque[float](maxlen=WINDOW) for name in ("returns", "lengths", "intrinsic")}
        self.ended_returns: list[float] = []
        self._sums: dict[int, float] = {}  # of intrinsic rewards, by episode
        self._over: list[int] = []  # episodes that ended since the last update

    @property
    def steps(self) -> int:
        """Transitions so far, over all parts of the run."""
        return self._learned + self.experience.closed

    @property
    def learned(self) -> int:
        """Transitions that it has learned from, over all parts of the run."""
        return self._learned

    @property
    def is_curious(self) -> bool:
        """Whether it learns from a reward of its own making, too."""
        return any(signal.module is not None for signal in self._signals)

    @property
    def is_done(self) -> bool:
        """Whether it has learned from all its steps; from then on it only acts."""
        return self._learned >= self.settings.max_steps

    @property
    def is_full(self) -> bool:
        """Whether there is enough for an update."""
        enough = min(self._own.buffer_size, self.settings.max_steps - self._learned)
        return not self.is_done and self.experience.closed >= enough

    @property
    def is_nearly_full(self) -> bool:
        """Whether the next messages may bring enough for an update."""
        enough = min(self._own.buffer_size, self.settings.max_steps - self._learned)
        return not self.is_done and len(self.experience) >= enough

    def play(self) -> None:
        """From here on it only acts, and takes the most likely actions: what an evaluation does."""
        self._plays = True

    def begin_anew(self, player: int) -> None:
        """Forgets a player's running episodes, and who waits for an action in them."""
        self.experience.begin_anew(player)
        self._waiting = [each for each in self._waiting if each.player != player]

    def take(
        self, player: int, behavior: str, ended: Agents | None, asking: Agents | None, again: bool = False
    ) -> None:
        """Takes what one player's agents say.

        Args:
            player: Which player.
            behavior: The behavior's full name.
            ended: Agents whose episode ended.
            asking: Agents that ask for a decision.
            again: Whether their request was taken before: of a run that goes on where it was saved.
        """
        if self.is_done or self._plays:
            if asking is not None:
                self._waiting.append(_Waiting(player, behavior, self.observations.of(asking), None))
            return
        if asking is not None and not again:
            self.observations.learn(asking)
        if ended is not None:
            self._end(player, behavior, ended)
        if asking is not None:
            observed = self.observations.of(asking)
            asked = self.experience.ask(player, behavior, asking, observed)
            self._waiting.append(_Waiting(player, behavior, observed, asked))

    def act(self) -> dict[tuple[int, str], ActionBatch]:
        """Decides for every agent that asked: for each player and behavior, in the order in which they asked.

        Raises:
            TrainerError: An action or a value is NaN or infinite.
        """
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return {}
        observed = joined([each.observed for each in waiting])
        deterministic = self._plays or self.settings.network_settings.deterministic
        acted = self.policy.act(
            tensors(observed.observations, self._device), tensor(observed.allowed, self._device), deterministic
        )
        decided = Decided(*(part.cpu().numpy() for part in acted))
        self._check_finite(decided)
        actions, start = {}, 0
        for player, behavior, own, asking in waiting:
            part = slice(start, start + len(own))
            start = part.stop
            chosen = decided.rows(part)
            if asking is not None:
                self.experience.estimate(asking.transitions, chosen.values)
                self.experience.act(asking, chosen)
            clipped = np.clip(chosen.continuous, -1.0, 1.0)
            actions[player, behavior] = ActionBatch(clipped, chosen.discrete.astype(np.int32))
        return actions

    def learn(self) -> None:
        """Makes an update of what was taken; agents that wait are decided for with the new policy."""
        for each in self._waiting:
            if each.asking is not None:
                values = self._values(each.observed.observations)
                self.experience.estimate(each.asking.transitions, values)
        transitions, moved = self.experience.take([each.asking for each in self._waiting if each.asking is not None])
        progress = self.progress
        self._learned += len(transitions)
        done = self.is_done
        moving = iter(moved)
        self._waiting = [
            each._replace(asking=None if done or each.asking is None else next(moving)) for each in self._waiting
        ]
        rewards = self._rewards(transitions)
        advantage, returns = self._targets(transitions, rewards)
        self.metrics |= self._ppo.update(transitions, advantage, returns, progress, self._generator)
        for head, signal in enumerate(self._signals[: self._heads]):
            estimate = float(transitions.decided.values[:, head].mean())
            self.metrics[f"Policy/{signal.name.capitalize()} Value Estimate"] = estimate
        self._learn_signals(transitions)
        self.updates += 1

    def weights(self) -> dict[str, NDArray[Any]]:
        """The policy's parameters by their names; views."""
        return {name: each.cpu().numpy() for name, each in self.policy.state_dict().items()}

    def state_dict(self) -> dict[str, Any]:
        """All of it, between two messages: arrays and plain values, by ``<part>/<name>``."""
        parts: dict[str, Mapping[str, Any]] = {
            "policy": self.weights(),
            "optimizer": self._ppo.state_dict(),
            "observations": self.observations.state_dict(),
            "experience": self.experience.state_dict(),
            **{signal.name: signal.module.state_dict() for signal in self._signals if signal.module is not None},
            "recent": {name: np.array(values) for name, values in self.recent.items()},
        }
        flat = {f"{part}/{name}": value for part, state in parts.items() for name, value in state.items()}
        return flat | {
            "counts": [self._learned, self.updates, self.episodes],
            "metrics": {tag: value if math.isfinite(value) else None for tag, value in self.metrics.items()},
            "sums": [[number, total] for number, total in self._sums.items()],
            "over": list(self._over),
            "ended_returns": list(self.ended_returns),
            "random": self._generator.bit_generator.state,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave, running episodes too.

        Raises:
            KeyError: Something is missing.
            RuntimeError: The policy has other parameters.
        """
        self.load_policy(state)
        self._ppo.load_state_dict(part_of(state, "optimizer"))
        self.experience.load_state_dict(part_of(state, "experience"))
        for signal in self._signals:
            if signal.module is not None:
                signal.module.load_state_dict(part_of(state, signal.name))
        for name, values in self.recent.items():
            values.extend(state[f"recent/{name}"].tolist())
        self._learned, self.updates, self.episodes = state["counts"]
        self.metrics = {tag: math.nan if value is None else value for tag, value in state["metrics"].items()}
        self._sums = {int(number): total for number, total in state["sums"]}
        self._over = list(state["over"])
        self.ended_returns = list(state["ended_returns"])
        self._generator.bit_generator.state = state["random"]

    def load_policy(self, state: Mapping[str, Any]) -> None:
        """Takes over what it takes to play: the policy, and how observations are scaled.

        Raises:
            KeyError: Something is missing.
            RuntimeError: The policy has other parameters.
        """
        weights = {name: torch.from_numpy(each.copy()) for name, each in part_of(state, "policy").items()}
        self.policy.load_state_dict(weights)
        self.observations.load_state_dict(part_of(state, "observations"))

    @property
    def progress(self) -> float:
        """The share of its steps that it has learned from, 0 to 1."""
        return min(self._learned / self.settings.max_steps, 1.0)

    def _end(self, player: int, behavior: str, ended: Agents) -> None:
        observations = self.observations.of(ended).observations
        transitions = self.experience.end(player, behavior, ended, observations)
        counts = np.where(ended.interrupted[:, None], np.float32(1), self._after_end)
        if counts.any():
            self.experience.estimate(transitions, self._values(observations) * counts)
        for episode in self.experience.ended:
            self.episodes += 1
            self.ended_returns.append(episode.total)
            self.recent["returns"].append(episode.total)
            self.recent["lengths"].append(episode.length)
            self._over.append(episode.number)
        self.experience.ended.clear()

    def _values(self, observations: tuple[Singles, ...]) -> Singles:
        values: Singles = self.policy.values(tensors(observations, self._device)).cpu().numpy()
        return values

    def _rewards(self, transitions: Transitions) -> list[Singles]:
        """Of each signal, (n,), times its strength."""
        columns = _columns(transitions, self._device)
        found = [
            (transitions.rewards if signal.module is None else signal.module.reward(*columns))
            * np.float32(signal.strength)
            for signal in self._signals
        ]
        learned = [each for each, signal in zip(found, self._signals, strict=True) if signal.module is not None]
        if learned:
            self._add_up(transitions, np.sum(learned, axis=0))
        self._over.clear()
        return found

    def _add_up(self, transitions: Transitions, rewards: Singles) -> None:
        """Adds intrinsic rewards to their episodes, and takes those that are over into the last ones' window."""
        numbers, which = np.unique(transitions.episodes, return_inverse=True)
        for number, total in zip(numbers.tolist(), np.bincount(which, rewards).tolist(), strict=True):
            self._sums[number] = self._sums.get(number, 0.0) + total
        self.recent["intrinsic"].extend(self._sums.pop(number, 0.0) for number in self._over)
        self.metrics["rollout/intrinsic_reward"] = float(rewards.mean())

    def _targets(self, transitions: Transitions, rewards: list[Singles]) -> tuple[Singles, Singles]:
        """The advantages, (n,), and what each value head is to say, (n, heads)."""
        if self._heads == 1:
            rewards = [np.sum(rewards, axis=0, dtype=np.float32)]
        gammas, lambd = [signal.gamma for signal in self._signals], self._own.lambd
        each = [advantages(transitions, own, head, gammas[head], lambd) for head, own in enumerate(rewards)]
        stacked = np.stack(each, axis=1)
        return stacked.mean(axis=1), stacked + transitions.decided.values

    def _learn_signals(self, transitions: Transitions) -> None:
        seen, continuous, discrete, then = _columns(transitions, self._device)
        for signal in self._signals:
            if signal.module is None:
                continue
            losses = []
            for indices in minibatches(len(transitions), self._own.batch_size, self._generator):
                rows = torch.from_numpy(indices).to(self._device)
                before, after = ([each[rows] for each in part] for part in (seen, then))
                losses.append(signal.module.learn(before, continuous[rows], discrete[rows], after))
            for name in losses[0]:
                self.metrics[LOSS_TAGS[name]] = float(np.mean([loss[name] for loss in losses]))

    def _check_finite(self, decided: Decided) -> None:
        if not (np.isfinite(decided.continuous).all() and np.isfinite(decided.values).all()):
            raise TrainerError(
                f"The policy of {self.behavior.name} gave numbers that are not finite; the run has diverged: try a "
                "smaller learning rate."
            )


def _columns(transitions: Transitions, device: torch.device) -> _Columns:
    """Of what an intrinsic reward is made."""
    decided, seen = transitions.decided, transitions.observed.observations
    continuous, discrete = tensors((decided.continuous, decided.discrete), device)
    return tensors(seen, device), continuous, discrete, tensors(transitions.next_observations, device)


def part_of(state: Mapping[str, Any], part: str) -> dict[str, Any]:
    """What ``state_dict`` has of one part."""
    start = f"{part}/"
    return {name.removeprefix(start): value for name, value in state.items() if name.startswith(start)}
