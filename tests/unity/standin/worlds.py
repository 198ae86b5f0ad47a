"""What agents play: a target on a line, whose rewards anybody can recompute, and the corridor of docs/contract.md."""

import math
import random
import subprocess
from collections.abc import Callable, Iterator, Sequence

Read = Callable[[str, float], float]  # an environment parameter, and its default


class World:
    """One agent's world. ``age`` counts the actions of an episode.

    Args:
        generator: Where episodes begin.
        read: Reads an environment parameter.
    """

    def __init__(self, generator: random.Random, read: Read) -> None:
        self.random, self.read = generator, read
        self.age = 0

    def begin(self) -> None:
        """A new episode."""
        raise NotImplementedError

    def act(self, continuous: Sequence[float], discrete: Sequence[int]) -> float:
        """One action; returns its reward."""
        raise NotImplementedError

    def arrived(self) -> bool:
        """Whether the last action ended the episode."""
        raise NotImplementedError

    def seen(self) -> list[float]:
        """What vector sensors show."""
        raise NotImplementedError

    def place(self) -> float:
        """The agent along its world, from -1 to 1."""
        return self.seen()[0]

    def aim(self) -> float:
        """Its target, from -1 to 1."""
        raise NotImplementedError

    def statistics(self) -> Iterator[tuple[str, float]]:
        """Names and values, at an episode's end."""
        raise NotImplementedError


class Line(World):
    """A target on a line from -1 to 1.

    The reward is how much nearer an action brought the agent, and 1 more when it arrives.
    """

    STEP, NEAR = 0.1, 0.05
    MOVES = (0.0, -1.0, 1.0)  # of a discrete branch: stay, left and right; every other choice stays as well

    def begin(self) -> None:
        self.x, self.target = self.random.uniform(-1, 1), self.read("target", self.random.uniform(-1, 1))
        self.age, self.there = 0, False

    def act(self, continuous: Sequence[float], discrete: Sequence[int]) -> float:
        moves = [max(-1.0, min(1.0, each)) for each in continuous] + [
            sum(self.MOVES[each : each + 1]) for each in discrete
        ]
        before = abs(self.target - self.x)
        self.x = max(-1.0, min(1.0, self.x + self.STEP * sum(moves) / len(moves)))
        self.age += 1
        after = abs(self.target - self.x)
        arrives = after <= self.NEAR and not self.there
        self.there = self.there or arrives
        return before - after + arrives

    def arrived(self) -> bool:
        return self.there

    def seen(self) -> list[float]:
        return [self.x, self.target, self.target - self.x]

    def aim(self) -> float:
        return max(-1.0, min(1.0, self.target))

    def statistics(self) -> Iterator[tuple[str, float]]:
        yield "Line/Arrived", float(self.there)
        yield "Line/Actions", self.age

    def forbidden(self, branches: Sequence[int]) -> list[list[bool]]:
        """A mask: no way left on the left half, none right on the right half; and the last choice only now and then."""
        masks = []
        for size in branches:
            mask = [(choice == 1 and self.x < -0.5) or (choice == 2 and self.x > 0.5) for choice in range(size)]
            masks.append([*mask[:-1], mask[-1] or (size > 3 and self.age % 2 == 1)])
        return masks


class Corridor(World):
    """The paper's corridor, in metres, as somebody else would build it who knows docs/contract.md."""

    SECONDS = 0.1

    def begin(self) -> None:
        self.total, self.age, self.switch, self.success = 0.0, 0, False, False
        self.contacts = self.walls = 0
        self.nearest = math.inf
        self.position = [self.random.uniform(-4, -2), self.random.uniform(-3, 3)]
        self.velocity = [0.0, 0.0]
        self.goal = [self.read("goal_x", 9.0), self.random.uniform(-3, 3)]
        self.opponent = [self.random.uniform(7, 8.5), self.random.uniform(-3, 3)]
        self.opponent_aim = [-9.0, self.random.uniform(-2.5, 2.5)]
        self.opponent_speed, self.penalty = self.read("opponent_speed", 1.0), self.read("failure_penalty", 1.0)
        self.opponent_velocity = [0.0, 0.0]

    def seen(self) -> list[float]:
        lengths = [*self.position, *self.velocity, *self.goal, math.dist(self.position, self.goal)]
        opponent = [*self.opponent, math.dist(self.position, self.opponent), *self.opponent_velocity]
        return [*(each / 10 for each in lengths), float(self.switch), *(each / 10 for each in opponent)]

    def aim(self) -> float:
        return self.goal[0] / 10

    def act(self, continuous: Sequence[float], discrete: Sequence[int]) -> float:
        walked = self._walk(list(continuous) or [choice - 1 for choice in discrete] * 2)
        way = math.dist(self.opponent, self.opponent_aim)
        speed = min(self.opponent_speed, way / self.SECONDS)
        ways = [aim - place for aim, place in zip(self.opponent_aim, self.opponent, strict=True)]
        self.opponent_velocity = [speed * each / way if way else 0.0 for each in ways]
        moved = zip(self.opponent, self.opponent_velocity, strict=True)
        self.opponent = [place + velocity * self.SECONDS for place, velocity in moved]
        self.switch = self.switch or math.dist(self.position, [0.0, 3.0]) <= 1.5
        self.age += 1
        distance = math.dist(self.position, self.opponent) / 10
        self.nearest = min(self.nearest, distance)
        self.contacts += distance <= 0.1
        self.walls += walked
        self.success = self.switch and math.dist(self.position, self.goal) <= 0.75
        reward = self._pay(walked, distance)
        self.total += reward
        return reward - self.penalty * self._failed()

    def _walk(self, action: Sequence[float]) -> bool:
        walked = False
        for axis, limit in ((0, 9.5), (1, 4.5)):
            wanted = 2.0 * max(-1.0, min(1.0, action[axis]))
            self.velocity[axis] += (wanted - self.velocity[axis]) * (1 - math.exp(-self.SECONDS / 0.5))
            self.position[axis] += self.velocity[axis] * self.SECONDS
            if abs(self.position[axis]) > limit:
                self.position[axis], self.velocity[axis] = math.copysign(limit, self.position[axis]), 0.0
                walked = True
        return walked

    def _pay(self, walked: bool, distance: float) -> float:
        if self.success:
            return 1.0
        if walked:
            return -0.1
        if distance <= 0.1:
            return -0.25
        return -0.1 - (1 - distance) / 4 if distance < 0.2 else -0.001

    def _failed(self) -> bool:
        return not self.success and self.total <= -1 + 1e-9

    def arrived(self) -> bool:
        return self.success or self._failed()

    def statistics(self) -> Iterator[tuple[str, float]]:
        yield "Corridor/Success", float(self.success)
        yield "Corridor/Switch Triggered", float(self.switch)
        yield "Corridor/Opponent Contacts", self.contacts
        yield "Corridor/Wall Contacts", self.walls
        yield "Corridor/Closest Approach", self.nearest
        yield "Corridor/Episode Length", self.age


class Scene(World):
    """An agent that another program plays: the C# of docs/unity.md, compiled with Scene.cs."""

    command: tuple[str, ...] = ()
    process: "subprocess.Popen[str] | None" = None
    count = 0
    NAMES = ("goal_x", "opponent_speed", "failure_penalty")

    def __init__(self, generator: random.Random, read: Read) -> None:
        super().__init__(generator, read)
        if Scene.process is None:
            command = [*self.command, str(generator.randrange(2**31))]
            Scene.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.number = Scene.count
        Scene.count += 1

    def _ask(self, *request: object) -> list[str]:
        read = [(name, self.read(name, math.nan)) for name in self.NAMES]
        settings = [word for name, value in read if not math.isnan(value) for word in (name, value)]
        print(self.number, *request, *settings, file=self.process.stdin, flush=True)
        return self.process.stdout.readline().split()

    def begin(self) -> None:
        self.shown = [float(word) for word in self._ask("begin")]
        self.ended = False

    def act(self, continuous: Sequence[float], discrete: Sequence[int]) -> float:
        ended, reward, *rest = self._ask("step", *continuous)
        size = len(self.shown)
        self.shown, names, values = [float(word) for word in rest[:size]], rest[size::2], rest[size + 1 :: 2]
        self.added = [(name.replace("_", " "), float(value)) for name, value in zip(names, values, strict=True)]
        self.ended = ended == "1"
        return float(reward)

    def arrived(self) -> bool:
        return self.ended

    def seen(self) -> list[float]:
        return self.shown

    def aim(self) -> float:
        return self.shown[4]

    def statistics(self) -> Iterator[tuple[str, float]]:
        yield from self.added


WORLDS = {"line": Line, "corridor": Corridor, "scene": Scene}
