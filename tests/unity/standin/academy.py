"""The academy: fixed steps in which agents come, ask, act and end; a message whenever there is something to say."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from standin.agents import Agent, Group, Info
from standin.proto3 import block, integer, integers, text
from standin.side_channels import SideChannels, statistic
from standin.spec import AgentSpec, BehaviorSpec, Spec
from standin.worlds import WORLDS

Actions = dict[str, list[tuple[list[float], list[int]]]]


@dataclass(frozen=True)
class Reply:
    """What the trainer said: whether to begin anew, and the actions of those that asked, by behavior."""

    reset: bool = False
    actions: Actions = field(default_factory=dict)


@dataclass
class Place:
    """Where an object with an agent stands: in the scene from ``appears`` on, with an agent while it is enabled."""

    spec: AgentSpec
    behavior: BehaviorSpec
    area: int
    group: Group | None
    appears: int
    agent: Agent | None = None


class Academy:
    """The scene while it runs.

    Args:
        spec: What it is made of.
        seed: Of everything random in it.
        num_areas: What the trainer asked for.
        old_trainer: Whether the trainer knows no hybrid actions and so reads the deprecated fields.
        channels: The side channels.
        exchange: Sends a UnityOutputProto and returns the trainer's reply.
    """

    def __init__(
        self,
        spec: Spec,
        seed: int,
        num_areas: int,
        old_trainer: bool,
        channels: SideChannels,
        exchange: Callable[[bytes], Reply],
    ) -> None:
        self._random = random.Random(seed)
        self._old_trainer, self._channels, self._exchange = old_trainer, channels, exchange
        self._places: list[Place] = []
        self._groups: list[Group] = []
        self._agents: list[Agent] = []
        self.everybody: list[Agent] = []  # those that were disabled as well
        self._batch: dict[str, list[Info]] = {}
        self._statistics = b""
        self._announced: set[str] = set()
        self._step = self.fixed_steps = 0  # since the last RESET, and in all
        for area in range(max(num_areas, 1) if spec.replicator else 1):
            groups = {
                name: Group(len(self._groups) + place, limit)
                for place, (name, limit) in enumerate(spec.groups.items(), 1)
            }
            self._groups += groups.values()
            for behavior in spec.behaviors:
                for each in behavior.agents:
                    group = groups[each.group] if each.group else None
                    self._places.append(Place(each, behavior, area, group, each.born))

    def fixed_step(self) -> None:
        """One of Unity's fixed steps."""
        self._come_and_go()
        for agent in self._agents:
            if agent.wants(self._step):
                self._say(agent.request())
        self._step += 1
        self.fixed_steps += 1
        reply = self._tell() if self._batch else Reply()
        if reply.reset:
            self._step = 0
            for agent in self._agents:
                agent.episode.end = "reset"
                agent.reward = agent.group_reward = 0.0
                agent.begin()
            for group in self._groups:
                group.steps = 0
        self._act(must=reply.reset)

    def _come_and_go(self) -> None:
        for place in self._places:
            agent, lives = place.agent, place.spec.lives
            if agent is not None and lives and self.fixed_steps - agent.born >= lives:
                self._say(agent.end("disabled"))
                self._agents.remove(agent)
                if agent.group:
                    agent.group.members.remove(agent)
                place.agent = None
                place.appears = self.fixed_steps + place.spec.away if place.spec.away else -1
            if place.agent is None and place.appears == self.fixed_steps:
                self._enable(place)

    def _enable(self, place: Place) -> None:
        world = WORLDS[place.behavior.world](self._random, self._channels.parameter)
        number = len(self.everybody)
        agent = Agent(number, place.spec, place.behavior, world, place.area, place.group, self.fixed_steps)
        agent.begin()
        place.agent = agent
        self._agents.append(agent)
        self.everybody.append(agent)
        if place.group:
            place.group.members.append(agent)

    def _say(self, info: Info | None) -> None:
        if info is not None:
            self._batch.setdefault(info.agent.behavior.full_name, []).append(info)

    def _act(self, must: bool) -> None:
        earned: dict[int, list[float]] = {}
        for agent in self._agents:
            before = agent.reward
            agent.act(must)
            if agent.group:
                earned.setdefault(agent.group.number, []).append(agent.reward - before)
            if how := agent.has_ended():
                self._end(agent, how)
        for group in self._groups:
            if how := group.pay(earned.get(group.number, [])):
                group.steps = 0
                for agent in group.members:
                    self._end(agent, how)

    def _end(self, agent: Agent, how: str) -> None:
        wanted = agent.behavior.statistics
        if wanted == "always" or wanted == how:
            for name, value in agent.world.statistics():
                self._statistics += statistic(name, value)
        self._say(agent.end(how))
        agent.begin()

    def _tell(self) -> Reply:
        """One message: those that ended and those that ask, in the order in which they did."""
        batch, self._batch = self._batch, {}
        entries, brains = b"", b""
        for name, infos in batch.items():
            entries += block(2, text(1, name) + block(2, b"".join(block(1, info.data) for info in infos)))
            if name not in self._announced:
                self._announced.add(name)
                brains += block(5, self._brain(infos[0].agent.behavior))
            for info in infos:
                info.enter()
        statistics, self._statistics = self._statistics, b""
        output = block(1, entries + (block(3, statistics) if statistics else b""))
        reply = self._exchange(output + (block(2, brains) if brains else b""))
        if not reply.reset:
            for name, infos in batch.items():
                asked = [info.agent for info in infos if not info.done]
                for agent, action in zip(asked, reply.actions.get(name, [])):  # noqa: B905 - counts are not checked
                    agent.chosen(*action)
                for agent in asked[len(reply.actions.get(name, [])) :]:
                    agent.chosen([], [])
        return reply

    def _brain(self, behavior: BehaviorSpec) -> bytes:
        continuous, branches = behavior.continuous, list(behavior.discrete)
        old = b""
        if self._old_trainer:
            old = integers(3, branches or [continuous]) + integer(6, not branches)
        action_spec = integer(1, continuous) + integer(2, len(branches)) + integers(3, branches)
        return old + text(7, behavior.full_name) + integer(8, True) + block(9, action_spec)
