#!/usr/bin/env python3
"""Agents as Unity's scenes have them, every decision of whom is written down: in the player's log, a line a message.

Of Unity's it stands for: agents ask with their own periods and offsets, get rewards at any time, their group's too,
and end terminated or interrupted, some before they ever asked; an end is followed by a new episode, at once or later,
or the agent is gone for good and another one, with a new id, comes. Two teams play the behavior ``Walker``; ``Late``
comes when they have played a while.

What an agent sees is a number of which there is only one, over ``SCALE``. Rewards are sixteenths, so sums are exact.
"""

import json
import logging
import sys
from dataclasses import dataclass, field

import numpy as np

from corridor_server.main import main
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.simulations.simulation import Simulation

SCALE, LATE, POPULATION = 2.0**14, 150, 8
NAMES = ("Walker?team=0", "Walker?team=1", "Late?team=0")
BEHAVIORS = {
    name: Behavior(name, (Sensor.of("number", (1,)),), continuous_actions=1, discrete_branches=(3,)) for name in NAMES
}
logger = logging.getLogger("scene")


@dataclass
class Agent:
    """One of them, and its running episode."""

    behavior: str
    period: int
    offset: int
    begins: int
    asked: list = field(default_factory=list)  # what it saw when it asked last, and what it then did
    total: float = 0.0  # of the episode, from its first decision on
    length: int = 0
    reward: float = 0.0  # since it asked
    group_reward: float = 0.0


class LoggedAgents(Simulation):
    behaviors = BEHAVIORS

    def __init__(self, seed: int, num_areas: int) -> None:
        self.rng = np.random.default_rng(seed % 2**32)
        self.number = seed % 16 * 2**20  # which float32 has exactly, over SCALE
        self.time, self.next_id, self.agents = 0, 0, {}
        self.population = POPULATION * num_areas

    def reset(self):
        self.agents = {}
        while len(self.agents) < self.population:
            self.come(NAMES[len(self.agents) % 2], self.time)
        return self.moment(ends=False)

    def come(self, behavior, begins):
        period = int(self.rng.integers(1, 8))
        self.agents[self.next_id] = Agent(behavior, period, int(self.rng.integers(period)), begins)
        self.next_id += 1

    def step(self, actions):
        for name, batch in actions.items():
            for row, agent in enumerate(self.asking.get(name, ())):
                self.agents[agent].asked.append([float(batch.continuous[row, 0]), int(batch.discrete[row, 0])])
        return self.moment(ends=True), {}

    def moment(self, ends):
        """Ticks until an agent asks or ends, and tells of it."""
        self.asking: dict[str, list[int]] = {}
        self.said = {"steps": [], "episodes": [], "undecided": 0}
        rows: dict[str, list[tuple]] = {name: [] for name in NAMES}
        while not any(rows.values()):
            self.time += 1
            if self.time == LATE:
                for _ in range(self.population // 2):
                    self.come(NAMES[2], self.time + 1)
            for number, agent in list(self.agents.items()):
                self.tick(number, agent, ends, rows[agent.behavior])
        logger.info(json.dumps(self.said))
        return {name: self.batch(name, told) for name, told in rows.items() if told}

    def tick(self, number, agent, ends, rows):
        if self.time < agent.begins:
            return
        agent.reward += int(self.rng.integers(-8, 9)) / 16 * (self.rng.random() < 0.5)
        agent.group_reward += (agent.behavior == NAMES[1] and self.rng.random() < 0.2) / 16
        if ends and self.rng.random() < 0.04:
            interrupted = bool(self.rng.random() < 0.5)
            rows.append((number, *self.settle(agent, True, interrupted), True, interrupted))
            agent.asked, agent.total, agent.length = [], 0.0, 0
            agent.begins = self.time + int(self.rng.integers(0, 4))
            if self.rng.random() < 0.3:
                del self.agents[number]
                self.come(agent.behavior, agent.begins + 1)
                return
        if agent.begins <= self.time and (self.time - agent.offset) % agent.period == 0:
            rows.append((number, *self.settle(agent, False, False), False, False))
            agent.asked = [rows[-1][1]]
            self.asking.setdefault(agent.behavior, []).append(number)

    def settle(self, agent, over, interrupted):
        """What the agent sees now and got since it asked; writes its decision down, if it had made one."""
        self.number += 1
        own, group, agent.reward, agent.group_reward = agent.reward, agent.group_reward, 0.0, 0.0
        name = agent.behavior
        if agent.asked:
            agent.total, agent.length = agent.total + own + group, agent.length + 1
            (seen, acted) = agent.asked
            self.said["steps"].append([name, seen, *acted, own + group, self.number, over and not interrupted])
            if over:
                self.said["episodes"].append([name, agent.total, agent.length])
        elif over:
            self.said["undecided"] += 1
        return self.number, own, group

    def batch(self, name, told):
        told = sorted(told, key=lambda row: not row[4])  # those that ended first
        ids, numbers, own, group, done, interrupted = map(np.array, zip(*told, strict=True))
        return Agents(
            ids.astype(np.int32),
            own.astype(np.float32),
            done,
            interrupted,
            ((numbers / SCALE).astype(np.float32)[:, None],),
            np.full(len(ids), NAMES.index(name), np.int32) * (name == NAMES[1]),
            group.astype(np.float32),
        )


if __name__ == "__main__":
    sys.exit(main(make_simulation=LoggedAgents))
