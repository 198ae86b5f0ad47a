"""Copies of a PettingZoo environment as training areas, whose agents are the players' agents."""

import importlib
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from corridor_server.protocol.samplers import Value
from corridor_server.protocol.side_channels import OF_ANY_LENGTH
from corridor_server.shared.given import shown
from corridor_server.simulations.action_choices import ActionChoices
from corridor_server.simulations.agent_areas import AgentArea, Event, ParallelArea, TurnsArea
from corridor_server.simulations.declared_parameters import DeclaredParameters
from corridor_server.simulations.environment_memory import Memory
from corridor_server.simulations.finite_numbers import check_finite, float32
from corridor_server.simulations.observation_sensors import ObservationSensors, batched
from corridor_server.simulations.running_episodes import PlaysAgain, RunningEpisodes
from corridor_server.simulations.simulation import (
    Moment,
    NotRestored,
    SimulationError,
    Statistics,
    blaming,
    try_to_close,
)

EVERY_BEHAVIOR = "*"


@dataclass(frozen=True)
class PettingZooEnvironment:
    """A PettingZoo environment, and what its agents are to a trainer.

    Attributes:
        module: That has ``parallel_env`` or, for agents that take turns, ``env``.
        arguments: Of that function.
        behaviors: Names and the patterns of their agents' names, the first that fits counts; an agent of none is of the
            behavior that it is named after, less its number: ``adversary_0`` is of ``adversary``.
        teams: The behaviors' teams; 0 where none is given.
        groups: Behaviors whose agents in an area are a group; ``*`` stands for all.
        parameters: Attributes of the unwrapped environment that a trainer may set, beside numbers of ``arguments``.
    """

    module: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    behaviors: tuple[tuple[str, re.Pattern[str]], ...] = ()
    teams: Mapping[str, int] = field(default_factory=dict)
    groups: frozenset[str] = frozenset()
    parameters: tuple[str, ...] = ()

    def check(self) -> Mapping[str, Behavior]:
        """Makes it once; returns its behaviors by their full names.

        Raises:
            SimulationError: It can't be made, or a space can't be carried.
        """
        simulation = PettingZooSimulation(self, 0, 1)
        simulation.close()
        return simulation.behaviors

    def area(self) -> AgentArea:
        """Makes a copy.

        Raises:
            SimulationError: It can't be made.
        """
        with blaming(f"The module of --pettingzoo {shown(self.module)} can't be imported"):
            module = importlib.import_module(self.module)
        kinds: list[tuple[str, type[AgentArea]]] = [("parallel_env", ParallelArea), ("env", TurnsArea)]
        for function, kind in kinds:
            make = getattr(module, function, None)
            if callable(make):
                with blaming(f"{self.module}.{function} can't be made"):
                    return kind(make, self.arguments, self.parameters)
        raise SimulationError(
            f"--pettingzoo is {shown(self.module)}, but a module with parallel_env or env was expected, such as "
            "mpe2.simple_spread_v3."
        )

    def behavior(self, agent: str) -> str:
        """The behavior of the agent with this name, without its team."""
        for name, pattern in self.behaviors:
            if pattern.fullmatch(str(agent)):
                return name
        return re.sub(r"(?<=.)_\d+$", "", str(agent))  # PettingZoo's agents may be numbers


class _Role(NamedTuple):
    """What the agents of one behavior have in common."""

    behavior: Behavior
    sensors: ObservationSensors
    choices: ActionChoices
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    grouped: bool


class PettingZooSimulation(PlaysAgain):
    """Copies of an environment.

    An agent's id is its place among all possible agents of its copy, after those of the copies before it. A group's
    number is its copy's and behavior's.

    Args:
        environment: Which.
        seed: Copy i is reset with ``seed + i``; a negative one counts as 2^32 more.
        num_areas: How many.

    Raises:
        SimulationError: It can't be made, or a space can't be carried.
    """

    def __init__(self, environment: PettingZooEnvironment, seed: int, num_areas: int) -> None:
        self._environment = environment
        self._areas, self._episodes = self._made(num_areas)
        self._seeds = [(seed + area) % 2**32 for area in range(num_areas)]
        numbers = [key for key, value in environment.arguments.items() if isinstance(value, int | float)]
        self._parameters = DeclaredParameters((*numbers, *environment.parameters), range(num_areas))
        with blaming(f"{environment.module} doesn't say what its agents are"):
            self._names = self._areas[0].possible_agents
            self._roles = _roles(environment, self._areas[0])
        self._role_of = {agent: self._roles[environment.behavior(agent)] for agent in self._names}
        self._numbers = {agent: number for number, agent in enumerate(self._names)}
        self._check_names()
        # Per behavior's full name, who asked in the last moment, as area and agent; in their order.
        self._asked: dict[str, list[tuple[int, str]]] = {}
        self._last: Moment = {}
        self.acts_when_idle = not isinstance(self._areas[0], TurnsArea)
        self._moved = np.ones(num_areas, np.bool_)  # areas whose running episode is not as it began by itself

    @property
    def behaviors(self) -> Mapping[str, Behavior]:
        """All that its possible agents have."""
        return {role.behavior.name: role.behavior for role in self._roles.values()}

    def set_parameter(self, name: str, value: Value) -> None:
        """Sets an argument or an attribute, from the next episode on."""
        if self._parameters.set(name, value):
            self._moved[:] = True
            self.restored = False

    def reset(self) -> Moment:
        """Begins an episode in every copy, but where one has just begun by itself."""
        events = []
        for number, area in enumerate(self._areas):
            if self._moved[number] and not self.restored:
                self._begin(number)
            events += [(number, event) for event in area.asking()]
        self._moved[:] = True  # it began by this reset
        return self._told(events, "a reset")

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Gives every agent that asked its action, and begins an episode where none of its agents is left."""
        self.restored = False
        asking = {name: agents.deciding.ids for name, agents in self._last.items() if self._asked[name]}
        if self._episodes is not None:
            self._episodes.act(asking, actions)
        chosen: list[dict[str, Any]] = [{} for _ in self._areas]
        for name, asked in self._asked.items():
            if asked:
                for (number, agent), action in zip(asked, self._read(asked[0][1], actions[name]), strict=True):
                    chosen[number][agent] = action
        ended, asks = [], []
        for number, area in enumerate(self._areas):
            with blaming(f"{self._environment.module} failed in a step"):
                ended += [(number, event) for event in area.step(chosen[number])]
            self._moved[number] = True
            if area.is_over():
                self._begin(number)
                self._moved[number] = False
            asks += [(number, event) for event in area.asking()]
        return self._told([*ended, *asks], "a step"), {}

    def snapshot(self) -> NDArray[np.void] | None:
        """The running episodes, to be played again; None if that can't be done."""
        if self._episodes is None:
            return None
        if not self._last:
            return np.empty(0, OF_ANY_LENGTH)
        return self._episodes.snapshot(self._last, {"parameters": self._parameters.state()})

    def close(self) -> None:
        """Closes every copy."""
        for area in self._areas:
            try_to_close(self._environment.module, area.close)

    def _begin(self, number: int) -> None:
        seed, self._seeds[number] = self._seeds[number], None  # a later episode goes on with its random numbers
        settings = self._parameters.draw(number)
        with blaming(f"{self._environment.module} failed in a reset"):
            if self._episodes is not None:
                self._episodes.begin(number, seed, settings)
            self._areas[number].reset(seed, settings)

    def _play_again(self, rows: NDArray[np.void]) -> None:
        if self._last:
            self._renew()
        episodes = self._episodes
        if episodes is None:
            raise NotRestored("its running episodes are not kept")
        acted, saved = episodes.take_up(
            rows, lambda number, seed, settings: self._areas[number].reset(seed, settings or {})
        )
        for number, area in enumerate(self._areas):
            ids = range(number * len(self._names), (number + 1) * len(self._names))
            chosen: dict[int, dict[str, Any]] = {}  # by step
            for done in acted.values():
                mine = done.of(ids, episodes.began_at(number))
                agents = [self._names[each - ids.start] for each in mine.ids.tolist()]
                actions = self._read(agents[0], mine.actions) if agents else ()
                for step, agent, action in zip(mine.steps.tolist(), agents, actions, strict=True):
                    chosen.setdefault(step, {})[agent] = action
            for step in sorted(chosen):
                area.step(chosen[step])
        self._told([(number, event) for number, area in enumerate(self._areas) for event in area.asking()], "a reset")
        episodes.check(self._last, saved)
        self._parameters.restore(saved["parameters"])
        self._seeds = [None] * len(self._areas)

    def _renew(self) -> None:
        """Makes the copies anew."""
        self.close()
        self._areas, self._episodes = self._made(len(self._areas))
        self._last, self._asked = {}, {}
        self._moved[:] = True

    def _made(self, count: int) -> tuple[list[AgentArea], RunningEpisodes]:
        of = self._environment
        areas = [of.area() for _ in range(count)]
        identity = (of.module, sorted(of.arguments.items()), of.parameters)
        return areas, RunningEpisodes(identity, [Memory(area.parts) for area in areas])

    def _read(self, agent: str, actions: ActionBatch) -> Iterator[Any]:
        """The actions of agents in this one's role, one by one."""
        role = self._role_of[agent]
        count = len(actions.discrete)
        one_by_one: Iterator[Any] = iterate(batch_space(role.action_space, count), role.choices.read(actions))
        return one_by_one

    def _told(self, events: Sequence[tuple[int, Event]], when: str) -> Moment:
        """The moment of what the environments said, which may be anything."""
        with blaming(f"{self._environment.module} gave in {when} what can't be used"):
            return self._moment(events)

    def _moment(self, events: Sequence[tuple[int, Event]]) -> Moment:
        of_roles: dict[str, list[tuple[int, Event]]] = {name: [] for name in self._roles}
        for number, event in events:
            role = self._role_of.get(event.agent)
            if role is None:
                raise SimulationError(
                    f"{self._environment.module} has an agent {shown(event.agent)}, which is not one of its possible."
                )
            of_roles[self._environment.behavior(event.agent)].append((number, event))
        self._asked = {}
        moment: dict[str, Agents] = {}
        for index, (name, found) in enumerate(of_roles.items()):
            full_name = self._roles[name].behavior.name
            self._asked[full_name] = [(number, event.agent) for number, event in found if not event.ended]
            if found:
                moment[full_name] = self._agents(self._roles[name], index, found)
        self._last = moment
        return moment

    def _agents(self, role: _Role, index: int, found: Sequence[tuple[int, Event]]) -> Agents:
        events = [event for _, event in found]
        numbers = [area * len(self._names) + self._numbers[event.agent] for area, event in found]
        ids = np.array(numbers, np.int32)
        batch = batched(role.observation_space, [event.observation for event in events])
        observations = role.sensors.read(batch, ids)
        given = np.array([event.reward for event in events])
        rewards = float32(given)
        check_finite(rewards, "a reward", ids, given)
        group_ids, group_rewards = np.zeros(len(ids), np.int32), np.zeros(len(ids), np.float32)
        if role.grouped:
            group_ids += np.array([1 + area * len(self._roles) + index for area, _ in found], np.int32)
            shared = _shared(found)
            rewards, group_rewards = np.where(shared, 0, rewards), np.where(shared, rewards, 0)
        return Agents(
            ids,
            rewards.astype(np.float32),
            np.array([event.ended for event in events], np.bool_),
            np.array([event.interrupted for event in events], np.bool_),
            observations,
            group_ids,
            group_rewards.astype(np.float32),
            self._masks(role, batch, events, ids),
        )

    def _masks(self, role: _Role, batch: Any, events: Sequence[Event], ids: NDArray[np.int32]) -> tuple[Any, ...]:
        if not role.choices.branches:
            return ()
        allowed = role.sensors.mask(batch)
        said = [event.mask for event in events]
        if allowed is None and any(mask is not None for mask in said):
            allowed = role.choices.allowed(said)
        if allowed is None:
            return ()
        return role.choices.forbidden(allowed, ids, np.array([event.ended for event in events], np.bool_))

    def _check_names(self) -> None:
        environment, names = self._environment, set(self._roles)
        for option, given in (("--team", set(environment.teams)), ("--group", environment.groups - {EVERY_BEHAVIOR})):
            for name in sorted(given - names):
                raise SimulationError(
                    f"{option} names behavior {shown(name)}, but {environment.module} has {', '.join(sorted(names))}."
                )
        for name, _ in environment.behaviors:
            if name not in names:
                raise SimulationError(
                    f"--behavior {shown(name)} fits none of the agents of {environment.module}: "
                    f"{', '.join(map(str, self._names))}."
                )
        if environment.groups and isinstance(self._areas[0], TurnsArea):
            raise SimulationError(
                f"--group needs agents that act together, but those of {environment.module} take turns."
            )


def _shared(found: Sequence[tuple[int, Event]]) -> list[bool]:
    """Whether each agent's reward is that of all of its group who acted."""
    of_areas: dict[int, set[float]] = {}
    for area, event in found:
        if event.acted:
            of_areas.setdefault(area, set()).add(event.reward)
    return [event.acted and len(of_areas[area]) == 1 for area, event in found]


def _roles(environment: PettingZooEnvironment, area: AgentArea) -> dict[str, _Role]:
    roles: dict[str, _Role] = {}
    for agent in area.possible_agents:
        name, observed, action = environment.behavior(agent), area.observation_space(agent), area.action_space(agent)
        if name in roles:
            if (observed, action) != (roles[name].observation_space, roles[name].action_space):
                raise SimulationError(
                    f"The agents of behavior {shown(name)} of {environment.module} differ in their spaces, {agent} "
                    "from those before it; give them behaviors of their own with --behavior NAME=REGEX."
                )
            continue
        owner = f"Agent {agent} of {environment.module}"
        sensors, choices = ObservationSensors(observed, owner), ActionChoices(action, owner)
        full_name = f"{name}?team={environment.teams.get(name, 0)}"
        behavior = Behavior(full_name, sensors.sensors, choices.continuous, choices.branches)
        grouped = name in environment.groups or EVERY_BEHAVIOR in environment.groups
        # A copy, as batches of a space make it a random generator, which would be the environment's.
        roles[name] = _Role(behavior, sensors, choices, observed, deepcopy(action), grouped)
    return roles
