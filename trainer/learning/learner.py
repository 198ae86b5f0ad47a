"""What learners of one behavior have in common, whatever their algorithm: agents come, go and ask when they like.

The path of a step: ``take`` closes what agents' last actions led to, ``learn`` learns from it once there is enough,
``act`` decides for all agents that asked, and ``remember`` begins the transitions of what they do, for which no player
has to wait.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from trainer.behavior_settings import BehaviorSettings
from trainer.errors import TrainerError
from trainer.learning.experience import Asking, Experience
from trainer.learning.observation_scaling import ObservationScaling
from trainer.learning.rewards import Signal
from trainer.learning.transitions import Decided, EndedEpisode, Observed, Singles, Transitions, joined

WINDOW = 100  # episodes that running means are over
POLICY = "policy"  # the part of a state that acts
LOSS_TAGS = {
    "forward_loss": "Losses/Curiosity Forward Loss",
    "inverse_loss": "Losses/Curiosity Inverse Loss",
    "rnd_loss": "Losses/RND Loss",
}


class _Waiting(NamedTuple):
    """Agents of one player and behavior that wait for an action."""

    player: int
    behavior: str
    observed: Observed
    asking: Asking | None  # None for agents that are not learned from any more


class Learner(ABC):
    """Learns one behavior, whatever its teams.

    Args:
        behavior: What its agents observe and do.
        settings: How it is learned.
        signals: The rewards that it is learned from.
        device: Where its networks compute.

    Attributes:
        policy: Its networks.
        observations: How they take what agents observe.
        learned: Transitions that ``learn`` has taken.
        updates: How many updates were made.
        episodes: How many episodes have ended.
        metrics: Of the last update, by the tags of Stable-Baselines3 and ML-Agents.
        ended_returns: Of episodes that ended since whoever reads this has emptied it.
        recent: Of the last episodes, ``returns``, ``lengths`` and, as far as it was paid, ``intrinsic`` rewards.
    """

    policy: nn.Module

    def __init__(
        self,
        behavior: Behavior,
        settings: BehaviorSettings,
        signals: tuple[Signal, ...],
        device: torch.device,
    ) -> None:
        self.behavior, self.settings = behavior, settings
        self.observations = ObservationScaling(behavior, settings.network_settings.normalize)
        self.experience = Experience(behavior, settings.time_horizon)
        self.learned = self.updates = self.episodes = 0
        self.metrics: dict[str, float] = {}
        self.recent = {name: deque[float](maxlen=WINDOW) for name in ("returns", "lengths", "intrinsic")}
        self.ended_returns: list[float] = []
        self._signals, self._device = signals, device
        self._waiting: list[_Waiting] = []
        self._acting: tuple[list[_Waiting], Decided] | None = None  # what is still to be remembered
        self._plays = False

    @property
    def steps(self) -> int:
        """Transitions so far, over all parts of the run."""
        return self.learned + self.experience.closed

    @property
    def progress(self) -> float:
        """The share of its steps that it has learned from, 0 to 1."""
        return min(self.learned / self.settings.max_steps, 1.0)

    @property
    def strengths(self) -> dict[str, float]:
        """Of each reward that it learns from, by the signal's name."""
        return {signal.name: signal.strength for signal in self._signals}

    @property
    def intrinsic_strength(self) -> float:
        """How strong the rewards of its own making are, all together; 0 if it has none."""
        return sum(signal.strength for signal in self._signals if signal.module is not None)

    @property
    def is_curious(self) -> bool:
        """Whether it learns from a reward of its own making, too."""
        return any(signal.module is not None for signal in self._signals)

    @property
    def is_done(self) -> bool:
        """Whether it has learned from all its steps; from then on it only acts."""
        return self.learned >= self.settings.max_steps

    @property
    def is_full(self) -> bool:
        """Whether there is enough for an update."""
        return not self.is_done and self._is_enough(self.experience.closed)

    def may_be_full(self, messages: int = 1) -> bool:
        """Whether so many next messages of every player may bring enough for an update."""
        closed, acting = self.experience.closed, 0 if self._acting is None else len(self._acting[1].log_probs)
        return not self.is_done and self._is_enough(closed + messages * (len(self.experience) - closed + acting))

    def play(self) -> None:
        """From here on it only acts, and takes the most likely actions: what an evaluation does."""
        self._plays = True

    def begin_anew(self, player: int) -> None:
        """Forgets a player's running episodes, and who waits for an action in them."""
        self.remember()
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
        self.remember()
        if self.is_done or self._plays:
            if asking is not None:
                self._waiting.append(_Waiting(player, behavior, self._observed(asking), None))
            return
        if asking is not None and not again:
            self.observations.learn(asking)
        if ended is not None:
            self._end(player, behavior, ended)
        if asking is not None:
            observed = self._observed(asking)
            asked = self.experience.ask(player, behavior, asking, observed, again)
            self._waiting.append(_Waiting(player, behavior, observed, asked))

    def act(self) -> dict[tuple[int, str], ActionBatch]:
        """Decides for every agent that asked: for each player and behavior, in the order in which they asked.

        Raises:
            TrainerError: An action is NaN or infinite.
        """
        self.remember()
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return {}
        deterministic = self._plays or self.settings.network_settings.deterministic
        decided = self._decide(joined([each.observed for each in waiting]), deterministic)
        self._check_finite(decided.continuous)
        self._acting = waiting, decided
        clipped, discrete = np.clip(decided.continuous, -1.0, 1.0), decided.discrete.astype(np.int32)
        return {
            (each.player, each.behavior): ActionBatch(clipped[part], discrete[part]) for each, part in _parts(waiting)
        }

    def remember(self) -> None:
        """Begins the transitions of what ``act`` decided; once."""
        if self._acting is None:
            return
        (waiting, decided), self._acting = self._acting, None
        for each, part in _parts(waiting):
            if each.asking is not None:
                self.experience.act(each.asking, decided.rows(part))

    @abstractmethod
    def learn(self) -> bool:
        """Learns from what was taken; agents that wait are decided for with the new policy.

        Returns:
            Whether that is done. If not, it goes on beside, and ``finish`` waits for it; agents that wait are decided
            for with the policy as it was before.
        """

    def finish(self) -> bool:
        """Waits for learning that goes on beside; whether there was any."""
        return False

    def weights(self) -> dict[str, NDArray[Any]]:
        """The policy's parameters by their names; views."""
        return {name: each.cpu().numpy() for name, each in self.policy.state_dict().items()}

    def state_dict(self) -> dict[str, Any]:
        """All of it, between two messages: arrays and plain values, by ``<part>/<name>``."""
        self.remember()
        parts: dict[str, Mapping[str, Any]] = {
            POLICY: self.weights(),
            "observations": self.observations.state_dict(),
            "experience": self.experience.state_dict(),
            **{signal.name: signal.module.state_dict() for signal in self._signals if signal.module is not None},
            "recent": {name: np.array(values) for name, values in self.recent.items()},
        }
        flat = {f"{part}/{name}": value for part, state in parts.items() for name, value in state.items()}
        return flat | {
            "counts": [self.learned, self.updates, self.episodes],
            "ended_returns": list(self.ended_returns),
            "metrics": {tag: value if math.isfinite(value) else None for tag, value in self.metrics.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave, running episodes too.

        Raises:
            KeyError: Something is missing.
            RuntimeError: The policy has other parameters.
        """
        self.load_policy(state)
        self.experience.load_state_dict(part_of(state, "experience"))
        for signal in self._signals:
            if signal.module is not None:
                signal.module.load_state_dict(part_of(state, signal.name))
        for name, values in self.recent.items():
            values.extend(state[f"recent/{name}"].tolist())
        self.learned, self.updates, self.episodes = state["counts"]
        self.ended_returns = list(state["ended_returns"])
        self.metrics = {tag: math.nan if value is None else value for tag, value in state["metrics"].items()}

    def load_policy(self, state: Mapping[str, Any]) -> None:
        """Takes over what it takes to play: the policy, and how observations are scaled.

        Raises:
            KeyError: Something is missing.
            RuntimeError: The policy has other parameters.
        """
        self.policy.load_state_dict(tensors_of(part_of(state, POLICY)))
        self.observations.load_state_dict(part_of(state, "observations"))

    @abstractmethod
    def _is_enough(self, transitions: int) -> bool:
        """Whether so many transitions, which ``learn`` has not taken yet, are enough for it."""

    @abstractmethod
    def _decide(self, observed: Observed, deterministic: bool) -> Decided:
        """What agents that observe this shall do."""

    def _observed(self, agents: Agents) -> Observed:
        """What agents observe, as it is remembered."""
        return self.observations.of(agents)

    def _ended(self, episodes: list[EndedEpisode]) -> None:  # noqa: B027 - not all learners have to know
        """Looks at episodes that ended."""

    def _take_closed(self) -> Transitions:
        """Takes out what is to be learned from."""
        waiting = [each.asking for each in self._waiting if each.asking is not None]
        transitions, moved = self.experience.take(waiting)
        self.learned += len(transitions)
        done, moving = self.is_done, iter(moved)
        self._waiting = [
            each._replace(asking=None if done or each.asking is None else next(moving)) for each in self._waiting
        ]
        return transitions

    def _end(self, player: int, behavior: str, ended: Agents) -> None:
        self.experience.end(player, behavior, ended, self._observed(ended).observations)
        episodes, self.experience.ended = self.experience.ended, []
        self._ended(episodes)
        for episode in episodes:
            self.episodes += 1
            self.ended_returns.append(episode.total)
            self.recent["returns"].append(episode.total)
            self.recent["lengths"].append(episode.length)

    def _check_finite(self, numbers: Singles) -> None:
        if not np.isfinite(numbers).all():
            raise self._diverged()

    def _diverged(self) -> TrainerError:
        return TrainerError(
            f"The policy of {self.behavior.name} gave numbers that are not finite; the run has diverged: try a "
            "smaller learning rate."
        )


def _parts(waiting: list[_Waiting]) -> Iterator[tuple[_Waiting, slice]]:
    """Who waits, with their rows among all."""
    start = 0
    for each in waiting:
        part = slice(start, start + len(each.observed))
        yield each, part
        start = part.stop


def part_of(state: Mapping[str, Any], part: str) -> dict[str, Any]:
    """What ``state_dict`` has of one part."""
    start = f"{part}/"
    return {name.removeprefix(start): value for name, value in state.items() if name.startswith(start)}


def tensors_of(arrays: Mapping[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    """Copies, as ``load_state_dict`` of torch's modules takes them."""
    return {name: torch.from_numpy(each.copy()) for name, each in arrays.items()}
