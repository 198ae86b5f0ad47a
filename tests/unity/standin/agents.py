"""Agents: an id for life, episodes, rewards since the last message, and a ledger of what was sent."""

from dataclasses import asdict, dataclass, field

from standin.proto3 import integer, integers, real
from standin.sensors import observations
from standin.spec import AgentSpec, BehaviorSpec
from standin.worlds import World


@dataclass
class Episode:
    """What the trainer was told of an episode; ``first`` is the part of ``reward`` that came with its first request."""

    steps: int = 0
    decisions: int = 0
    reward: float = 0.0
    first: float = 0.0
    group_reward: float = 0.0
    end: str = "unfinished"  # terminated, interrupted, disabled, reset


@dataclass
class Info:
    """An AgentInfoProto to be sent, and what the ledger has to know of it."""

    agent: "Agent"
    episode: Episode
    data: bytes
    reward: float
    group_reward: float
    done: bool

    def enter(self) -> None:
        """Into the ledger: it is being sent."""
        self.episode.reward += self.reward
        self.episode.group_reward += self.group_reward
        if not self.done:
            if not self.episode.decisions:
                self.episode.first = self.reward
            self.episode.decisions += 1


@dataclass
class Agent:
    """One object with an agent on it, from the moment it is enabled until it is disabled.

    Attributes:
        number: Its id: it keeps it over episodes and RESETs.
        told: Whether its end was sent, and nothing since.
    """

    number: int
    spec: AgentSpec
    behavior: BehaviorSpec
    world: World
    area: int
    group: "Group | None"
    born: int
    continuous: list[float] = field(default_factory=list)
    discrete: list[int] = field(default_factory=list)
    reward: float = 0.0
    group_reward: float = 0.0
    asked: bool = False
    told: bool = False
    forbidden: int = 0
    masks: list[bool] = field(default_factory=list)
    episodes: list[Episode] = field(default_factory=list)

    def begin(self) -> None:
        """A new episode, with nothing to do until the first decision."""
        self.episodes.append(Episode())
        self.world.begin()
        self.take([], [])
        self.asked = False

    @property
    def episode(self) -> Episode:
        return self.episodes[-1]

    def take(self, continuous: list[float], discrete: list[int]) -> None:
        """The next action; what is missing is zero."""
        missing = [0.0] * (self.behavior.continuous - len(continuous))
        self.continuous = [*continuous[: self.behavior.continuous], *missing]
        branches = self.behavior.discrete
        self.discrete = [*discrete[: len(branches)], *[0] * (len(branches) - len(discrete))]

    def chosen(self, continuous: list[float], discrete: list[int]) -> None:
        """The trainer's answer."""
        self.take(continuous, discrete)
        first = 0
        for size, choice in zip(self.behavior.discrete, self.discrete, strict=True):
            self.forbidden += bool(self.masks) and choice < size and self.masks[first + choice]
            first += size

    def wants(self, step: int) -> bool:
        """Whether it asks for a decision at this step."""
        return step % self.spec.period == self.spec.offset

    def request(self) -> Info:
        """Asks for a decision."""
        self.asked, self.told = True, False
        self.masks = []
        if self.behavior.masks:
            self.masks = [each for mask in self.world.forbidden(self.behavior.discrete) for each in mask]
        return self._info()

    def act(self, must: bool = False) -> None:
        """One fixed step: acts if it decided, or acts between decisions, or ``must``."""
        self.episode.steps += 1
        if self.asked or self.spec.between or must:
            self.reward += self.world.act(self.continuous, self.discrete)
        self.asked = False

    def has_ended(self) -> str:
        """How its episode ended in this step by itself; empty if it goes on."""
        if self.group is not None:
            return ""
        limit = self.spec.episode
        if self.episode.steps >= limit if limit else self.world.arrived():
            return "terminated"
        return "interrupted" if 0 < self.spec.max_step <= self.episode.steps else ""

    def end(self, how: str) -> Info | None:
        """Ends the episode; nothing is sent for one that nothing was sent of since the last end."""
        self.episode.end = how
        if self.told:
            return None
        self.told = True
        return self._info(done=True, interrupted=how == "interrupted")

    def _info(self, done: bool = False, interrupted: bool = False) -> Info:
        reward, self.reward = self.reward, 0.0
        group_reward, self.group_reward = self.group_reward, 0.0
        data = real(7, reward) + integer(8, done) + integer(9, interrupted) + integer(10, self.number)
        data += integers(11, [] if done else self.masks) + observations(self.behavior.sensors, self.world)
        data += integer(14, self.group.number if self.group else 0) + real(15, group_reward)
        return Info(self, self.episode, data, reward, group_reward, done)

    def ledger(self) -> dict[str, object]:
        """What was sent, to be counted against what a trainer received."""
        group = self.group.number if self.group else 0
        own = {"id": self.number, "behavior": self.behavior.full_name, "area": self.area, "group": group}
        return {**own, "forbidden": self.forbidden, "episodes": [asdict(each) for each in self.episodes]}


@dataclass
class Group:
    """Agents that are paid together: half of what each earned on average, and 1 when all have arrived, which ends it.

    Attributes:
        number: Its id, from 1.
        max_step: Fixed steps until it is interrupted.
    """

    number: int
    max_step: int
    members: list[Agent] = field(default_factory=list)
    steps: int = 0

    def pay(self, earned: list[float]) -> str:
        """After everybody acted; returns how the group's episode ended, or an empty text."""
        if not self.members:
            return ""
        self.steps += 1
        arrived = all(each.world.arrived() for each in self.members)
        for each in self.members:
            each.group_reward += sum(earned) / len(earned) / 2 + arrived
        return "terminated" if arrived else "interrupted" if 0 < self.max_step <= self.steps else ""
