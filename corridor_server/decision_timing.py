"""When an episode's end and the next episode's first request reach a trainer: in one message, or in two as in Unity."""

from collections.abc import Callable, Mapping
from typing import Protocol

from corridor_server.protocol.agents import ActionBatch
from corridor_server.simulations.simulation import Moment, Simulation, Statistics


class Timing(Protocol):
    """What of a simulation goes into which message; each call is the answer to one command."""

    def reset(self) -> tuple[Moment, Statistics]:
        """Answers RESET with the next message's agents, and the statistics of those that ended."""

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Answers STEP in the same way: one action for each agent of the last message that asked."""


class Together:
    """End and next request in one message, as Unity's with a decision period of 1: a message for every action."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def reset(self) -> tuple[Moment, Statistics]:
        """Begins an episode for every agent."""
        return self._simulation.reset(), {}

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Applies the actions."""
        return self._simulation.step(actions)


class Apart:
    """Ended agents in a message of their own, as Unity's with a longer decision period: the requests are in the next.

    A RESET arrives in the middle of Unity's step, which goes on: every agent acts once with a zero action before its
    first request, whose message has that action's reward. An agent that a saved state was just put back for does not.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._requests: Moment | None = None  # for the next message

    def reset(self) -> tuple[Moment, Statistics]:
        """Drops requests that are due, begins an episode for every agent and takes its first, idle step."""
        begun = self._simulation.reset()
        self._requests = None
        if self._simulation.restored or not self._simulation.acts_when_idle:
            return begun, {}
        behaviors = self._simulation.behaviors
        return self.step({name: ActionBatch.zeros(len(agents), behaviors[name]) for name, agents in begun.items()})

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Applies the actions, or, after a message in which nobody asked for one, gives the requests that are due."""
        if self._requests is not None:
            requests, self._requests = self._requests, None
            return requests, {}
        moment, statistics = self._simulation.step(actions)
        ended = {name: agents.ended for name, agents in moment.items()}
        if not any(map(len, ended.values())):
            return moment, statistics
        self._requests = {name: agents.deciding for name, agents in moment.items()}
        return ended, statistics


TIMINGS: dict[str, Callable[[Simulation], Timing]] = {"together": Together, "unity": Apart}
