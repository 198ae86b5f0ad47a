"""Evaluation of whatever a scene has: whole episodes of every behavior, without learning."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from corridor_server.protocol.agents import Agents
from trainer.players.scene import Message, Scene
from trainer.runs.behavior_learners import BehaviorLearners

# After so many agent steps, episodes that have not ended count as far as they came.
MOST_STEPS = 1_000_000
MOST_LENGTH = 10_000  # of one episode: its behavior is not waited for any longer


class PlayedEpisode(NamedTuple):
    """One episode of an evaluation.

    Attributes:
        total: Its rewards' sum, an agent's own and its group's.
        length: The agent's decisions.
        ended: Whether it ended, or the evaluation before it.
    """

    total: float
    length: int
    ended: bool


class _Running:
    def __init__(self, number: int) -> None:
        self.number, self.total, self.length = number, 0.0, -1


def evaluate_scene(
    learners: BehaviorLearners,
    scene: Scene,
    episodes: int,
    most_steps: int = MOST_STEPS,
    most_length: int = MOST_LENGTH,
    tell: Callable[[int], None] = lambda played: None,
) -> dict[str, list[PlayedEpisode]]:
    """Plays with the policies as they are.

    Of each behavior those episodes count that begin first: taking those that end first would favour short ones.

    Args:
        learners: Have the policies; they only act from here on.
        scene: The players.
        episodes: How many of each behavior.
        most_steps: Agent steps after which to stop.
        most_length: Of one episode, after which no other of its behavior is waited for.
        tell: Told how many episodes have ended of the behavior that has fewest, after every message.

    Returns:
        By behavior, without teams: the episodes in the order in which they began.
    """
    for _, learner in learners:
        learner.play()
    tally = _Tally(episodes, most_length)
    messages = scene.reset()
    while True:
        tally.count(messages)
        tell(tally.fewest)
        learners.take(messages)
        if tally.is_complete or tally.steps >= most_steps:
            return tally.played()
        scene.send(learners.act())
        messages = scene.receive()


class _Tally:
    """The episodes of an evaluation, by behavior."""

    def __init__(self, episodes: int, most_length: int) -> None:
        self._wanted, self._most_length = episodes, most_length
        self._running: dict[tuple[int, str, int], _Running] = {}
        self._begun: dict[str, int] = {}
        self._free: dict[str, list[int]] = {}  # numbers of episodes that were dropped
        self._endless: set[str] = set()
        self._ended: dict[str, dict[int, PlayedEpisode]] = {}
        self.steps = 0

    @property
    def is_complete(self) -> bool:
        """Whether every behavior has enough, or an episode that counts and seems never to end."""
        return bool(self._ended) and all(
            len(each) >= self._wanted or name in self._endless for name, each in self._ended.items()
        )

    @property
    def fewest(self) -> int:
        """How many episodes have ended, of those that count, of the behavior that has fewest."""
        return min(map(len, self._ended.values()), default=0)

    def count(self, messages: Sequence[Message]) -> None:
        """Takes what the players' agents say."""
        for player, message in enumerate(messages):
            if message.anew:
                self._drop(player)
            for name, agents in message.ended.items():
                self._end(player, name, agents)
            for name, agents in message.asking.items():
                self._ask(player, name, agents)

    def played(self) -> dict[str, list[PlayedEpisode]]:
        """The episodes so far; those that still run as far as they are."""
        found = {name: dict(each) for name, each in self._ended.items()}
        for (_, name, _), running in self._running.items():
            own = found[_behavior(name)]
            if running.number < self._wanted and len(own) < self._wanted:
                own[running.number] = PlayedEpisode(running.total, max(running.length, 0), False)
        return {name: [each[number] for number in sorted(each)] for name, each in found.items()}

    def _ask(self, player: int, name: str, agents: Agents) -> None:
        behavior = _behavior(name)
        self._ended.setdefault(behavior, {})
        for agent, reward in zip(agents.ids.tolist(), (agents.rewards + agents.group_rewards).tolist(), strict=True):
            running = self._running.get((player, name, agent))
            if running is None:
                self._running[player, name, agent] = running = _Running(self._number(behavior))
            else:
                running.total += reward
            running.length += 1
            self.steps += 1
            if running.length >= self._most_length and running.number < self._wanted:
                self._endless.add(behavior)

    def _number(self, behavior: str) -> int:
        free = self._free.get(behavior)
        if free:
            return free.pop(0)
        number = self._begun.get(behavior, 0)
        self._begun[behavior] = number + 1
        return number

    def _end(self, player: int, name: str, agents: Agents) -> None:
        ended = self._ended.setdefault(_behavior(name), {})
        for agent, reward in zip(agents.ids.tolist(), (agents.rewards + agents.group_rewards).tolist(), strict=True):
            running = self._running.pop((player, name, agent), None)
            if running is not None and running.number < self._wanted:
                ended[running.number] = PlayedEpisode(running.total + reward, running.length + 1, True)

    def _drop(self, player: int) -> None:
        """Forgets a player's running episodes, of which it says no more; others take their numbers."""
        for key in [each for each in self._running if each[0] == player]:
            self._free.setdefault(_behavior(key[1]), []).append(self._running.pop(key).number)


def _behavior(name: str) -> str:
    return name.partition("?")[0]


def summarise_scene(played: Mapping[str, Sequence[PlayedEpisode]]) -> dict[str, dict[str, Any]]:
    """For each behavior what an ``evaluation`` part of ``summary.json`` says."""
    return {
        name: {
            "episodes": len(episodes),
            "mean_return": float(np.mean([each.total for each in episodes])) if episodes else None,
            "mean_episode_length": float(np.mean([each.length for each in episodes])) if episodes else None,
            "unfinished": sum(not each.ended for each in episodes),
        }
        for name, episodes in played.items()
    }
