"""A copy of a PettingZoo environment, whose agents act together or in turns."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from corridor_server.shared.given import shown
from corridor_server.simulations.declared_parameters import like
from corridor_server.simulations.observation_sensors import ACTION_MASK
from corridor_server.simulations.simulation import SimulationError


class Event(NamedTuple):
    """That an agent asks for an action, or ended.

    Attributes:
        agent: Its name.
        observation: What it observes.
        reward: Since it last acted.
        ended: Whether it ended.
        interrupted: Whether it was truncated.
        mask: Which choices its ``info`` allows; None if it doesn't say.
        acted: Whether it acted in its running, or just ended, episode.
    """

    agent: str
    observation: Any
    reward: float = 0.0
    ended: bool = False
    interrupted: bool = False
    mask: Any = None
    acted: bool = False


class AgentArea(ABC):
    """One copy.

    Args:
        make: Makes the environment.
        arguments: For ``make``.
        attributes: Of the unwrapped environment that may be set.

    Raises:
        SimulationError: The environment has no such attribute.
    """

    def __init__(self, make: Callable[..., Any], arguments: Mapping[str, Any], attributes: tuple[str, ...]) -> None:
        self._make, self._arguments, self._attributes = make, dict(arguments), attributes
        self._env = make(**self._arguments)
        for name in attributes:
            if not isinstance(getattr(self._env.unwrapped, name, None), int | float):
                raise SimulationError(
                    f"--parameters names {shown(name)}, but the environment has no such number; give an attribute of "
                    "the unwrapped environment."
                )

    @property
    def possible_agents(self) -> list[str]:
        """Every agent's name that there can be."""
        return list(self._env.possible_agents)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What the agent observes."""
        space: spaces.Space[Any] = self._env.observation_space(agent)
        return space

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """What the agent does."""
        space: spaces.Space[Any] = self._env.action_space(agent)
        return space

    def reset(self, seed: int | None, settings: Mapping[str, float]) -> None:
        """Begins an episode.

        Args:
            seed: None goes on with the random numbers of the episode before.
            settings: Attributes and arguments for it, by name; with other arguments it is made anew.
        """
        arguments = {
            key: like(self._arguments[key], value) for key, value in settings.items() if key in self._arguments
        }
        if any(self._arguments[name] != value for name, value in arguments.items()):
            self._arguments |= arguments
            if seed is None:
                seed = _next_seed(self._env)
            self._env.close()
            self._env = self._make(**self._arguments)
        for name in settings.keys() - arguments.keys():
            unwrapped = self._env.unwrapped
            setattr(unwrapped, name, like(getattr(unwrapped, name), settings[name]))
        self._begin(seed)
        if not self.asking():
            raise SimulationError("The environment began an episode in which no agent acts.")

    @abstractmethod
    def _begin(self, seed: int | None) -> None: ...

    @abstractmethod
    def step(self, actions: Mapping[str, Any]) -> list[Event]:
        """Gives agents that asked their actions; returns those that ended."""

    @abstractmethod
    def asking(self) -> list[Event]:
        """The agents that ask for an action."""

    def is_over(self) -> bool:
        """Whether no agent is left."""
        return not self._env.agents

    def close(self) -> None:
        """Closes it."""
        self._env.close()


class ParallelArea(AgentArea):
    """A copy whose agents all act together."""

    def _begin(self, seed: int | None) -> None:
        observations, infos = self._env.reset(seed=seed)
        self._asking = [Event(agent, observations[agent], mask=_mask(infos.get(agent))) for agent in self._env.agents]

    def step(self, actions: Mapping[str, Any]) -> list[Event]:
        """Gives them all their actions; returns those that ended."""
        observations, rewards, terminations, truncations, infos = self._env.step(dict(actions))
        ended: list[Event] = []
        self._asking = []
        new = [agent for agent in self._env.agents if agent not in actions]
        for agent in [*actions, *new]:
            terminated, truncated = bool(terminations[agent]), bool(truncations[agent])
            event = Event(
                agent,
                observations[agent],
                float(rewards[agent]),
                terminated or truncated,
                truncated and not terminated,
                _mask(infos.get(agent)),
                agent in actions,
            )
            (ended if event.ended else self._asking).append(event)
        return ended

    def asking(self) -> list[Event]:
        """All that are left."""
        return self._asking


class TurnsArea(AgentArea):
    """A copy whose agents act in turns."""

    def _begin(self, seed: int | None) -> None:
        self._env.reset(seed=seed)
        self._pass_ended()

    def step(self, actions: Mapping[str, Any]) -> list[Event]:
        """Gives the agent whose turn it is its action; returns those that ended."""
        (action,) = actions.values()
        self._env.step(action)
        return self._pass_ended()

    def _pass_ended(self) -> list[Event]:
        """Goes on to an agent that can act; returns those on the way, which ended."""
        ended: list[Event] = []
        while self._env.agents:
            observation, reward, terminated, truncated, info = self._env.last()
            agent = self._env.agent_selection
            over = bool(terminated or truncated)
            interrupted = bool(truncated and not terminated)
            event = Event(agent, observation, float(reward), over, interrupted, _mask(info))
            if not over:
                self._asking = [event]
                return ended
            ended.append(event)
            self._env.step(None)
        self._asking = []
        return ended

    def asking(self) -> list[Event]:
        """The one whose turn it is."""
        return self._asking


def _mask(info: Mapping[str, Any] | None) -> Any:
    return None if info is None else info.get(ACTION_MASK)


def _next_seed(env: Any) -> int:
    generator = getattr(env.unwrapped, "np_random", None)
    return int(generator.integers(2**31)) if isinstance(generator, np.random.Generator) else 0
