"""A copy of a PettingZoo environment, whose agents act together or in turns."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any, NamedTuple

from gymnasium import spaces

from corridor_server.simulations.declared_parameters import ParameterTaker
from corridor_server.simulations.observation_sensors import ACTION_MASK
from corridor_server.simulations.simulation import SimulationError, number_of


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
        self._env = make(**arguments)
        self._taker = ParameterTaker("the environment", self._env, make, arguments, attributes, _spaces)

    def parts(self) -> tuple[object, ...]:
        """What remembers anything from one episode to the next."""
        return self._env, self._taker

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
        self._env, seed = self._taker.take_up(self._env, settings, seed)
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
        """Whether no agent is left: some environments still count those that ended."""
        return not self.asking()

    def close(self) -> None:
        """Closes it."""
        self._env.close()


class ParallelArea(AgentArea):
    """A copy whose agents all act together."""

    def _begin(self, seed: int | None) -> None:
        observations, infos = self._env.reset(seed=seed)
        self._asking = [
            Event(agent, _of(observations, agent, "observation"), mask=_mask(infos.get(agent)))
            for agent in self._env.agents
        ]

    def step(self, actions: Mapping[str, Any]) -> list[Event]:
        """Gives them all their actions; returns those that ended."""
        observations, rewards, terminations, truncations, infos = self._env.step(dict(actions))
        ended: list[Event] = []
        self._asking = []
        for agent in actions:
            terminated = bool(_of(terminations, agent, "termination"))
            over = terminated or bool(_of(truncations, agent, "truncation")) or agent not in self._env.agents
            observation = _of(observations, agent, "observation")
            if over:  # a reset may write into it
                observation = deepcopy(observation)
            reward, mask = number_of(_of(rewards, agent, "reward")), _mask(infos.get(agent))
            event = Event(agent, observation, reward, over, over and not terminated, mask, acted=True)
            (ended if over else self._asking).append(event)
        for agent in self._env.agents:  # one that came; of one that ended before, some environments tell on
            if agent not in actions and not terminations.get(agent, False) and not truncations.get(agent, False):
                reward, mask = number_of(rewards.get(agent, 0.0)), _mask(infos.get(agent))
                self._asking.append(Event(agent, _of(observations, agent, "observation"), reward, mask=mask))
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
            event = Event(agent, observation, number_of(reward), over, interrupted, _mask(info))
            if not over:
                self._asking = [event]
                return ended
            ended.append(event._replace(observation=deepcopy(observation)))  # the next step may write into it
            self._env.step(None)
            if agent in self._env.agents:  # it would be passed for ever
                raise SimulationError(f"Agent {agent} ended, but is still one of agents after a step with None.")
        self._asking = []
        return ended

    def asking(self) -> list[Event]:
        """The one whose turn it is."""
        return self._asking


def _of(told: Mapping[str, Any], agent: str, what: str) -> Any:
    if agent not in told:
        raise SimulationError(f"The environment gave no {what} of agent {agent}, who was to have one in this step.")
    return told[agent]


def _mask(info: Mapping[str, Any] | None) -> Any:
    return None if info is None else info.get(ACTION_MASK)


def _spaces(env: Any) -> dict[str, object]:
    return {agent: (env.observation_space(agent), env.action_space(agent)) for agent in env.possible_agents}
