"""When an episode's end and the next episode's first request reach a trainer: in one message, or in two as in Unity."""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents, Behavior

Statistics = Mapping[str, NDArray[np.float64]]


class Simulation(Protocol):
    """What a player plays: episodes that begin anew by themselves, of agents that all ask for decisions in step."""

    @property
    def behavior(self) -> Behavior:
        """What its agents are to a trainer."""

    @property
    def restored(self) -> bool:
        """Whether it stands where a saved state was put back, and has not moved since."""

    def reset(self) -> Agents:
        """Begins an episode for every agent, each of which asks for an action."""

    def step(self, actions: NDArray[np.float32]) -> tuple[Agents, Statistics]:
        """Applies an action, (n, size), to each agent that asked.

        Returns:
            Agents whose episode ended, then every agent with its next request; and the ended episodes' statistics.
        """


class Timing(Protocol):
    """What of a simulation goes into which message; each call is the answer to one command."""

    def reset(self) -> tuple[Agents, Statistics]:
        """Answers RESET with the next message's agents, and the statistics of those that ended."""

    def step(self, actions: NDArray[np.float32]) -> tuple[Agents, Statistics]:
        """Answers STEP in the same way: one action, (n, size), for each agent of the last message that asked."""


class Together:
    """End and next request in one message, as Unity's with a decision period of 1: a message for every action."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def reset(self) -> tuple[Agents, Statistics]:
        """Begins an episode for every agent."""
        return self._simulation.reset(), {}

    def step(self, actions: NDArray[np.float32]) -> tuple[Agents, Statistics]:
        """Applies the actions."""
        return self._simulation.step(actions)


class Apart:
    """Ended agents in a message of their own, as Unity's with a longer decision period: the requests are in the next.

    A RESET arrives in the middle of Unity's step, which goes on: every agent acts once with a zero action before its
    first request, whose message has that action's reward. An agent that a saved state was just put back for does not.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._requests: Agents | None = None  # for the next message

    def reset(self) -> tuple[Agents, Statistics]:
        """Drops requests that are due, begins an episode for every agent and takes its first, idle step."""
        begun = self._simulation.reset()
        self._requests = None
        if self._simulation.restored:
            return begun, {}
        return self.step(np.zeros((len(begun), self._simulation.behavior.continuous_actions), np.float32))

    def step(self, actions: NDArray[np.float32]) -> tuple[Agents, Statistics]:
        """Applies the actions, or, after a message in which nobody asked for one, gives the requests that are due."""
        if self._requests is not None:
            requests, self._requests = self._requests, None
            return requests, {}
        agents, statistics = self._simulation.step(actions)
        ended = agents.ended
        if not len(ended):
            return agents, statistics
        self._requests = agents.deciding
        return ended, statistics


TIMINGS: dict[str, Callable[[Simulation], Timing]] = {"together": Together, "unity": Apart}
