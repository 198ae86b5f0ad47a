#!/usr/bin/env python3
"""An agent in each area that asks at its own times, as Unity's decision requesters with other periods: for measuring.

Agents chase a place on a line: they see where it is, and 14 numbers that say nothing.
"""

import sys

import numpy as np

from corridor_server.main import main
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.simulations.simulation import Simulation

LENGTH, PERIODS = 200, 5
CHASER = Behavior("Chaser?team=0", (Sensor.of("numbers", (16,)),), continuous_actions=2)
BEHAVIORS = {CHASER.name: CHASER}


class UnevenVectors(Simulation):
    behaviors = BEHAVIORS

    def __init__(self, seed: int, num_areas: int) -> None:
        self.rng, self.ids, self.time = np.random.default_rng(seed % 2**32), np.arange(num_areas), 0
        self.period = 1 + self.ids % PERIODS
        self.place, self.aim = self.rng.uniform(-1, 1, (2, num_areas, 2))
        self.speed, self.reward = np.zeros((num_areas, 2)), np.zeros(num_areas)

    def reset(self):
        return {CHASER.name: self.asking(self.ids)}

    def step(self, actions):
        self.speed[self.asked] = actions[CHASER.name].continuous
        while True:
            self.time += 1
            self.place += 0.1 * self.speed
            self.reward -= abs(self.place - self.aim).sum(axis=1) / LENGTH
            over = (self.time + self.ids) % LENGTH == 0
            due = (self.time + self.ids) % self.period == 0
            if due.any() or over.any():
                break
        ended = Agents.that_ended(self.ids[over], (self.observation(self.ids[over]),), self.reward[over], over[over])
        self.reward[over] = self.speed[over] = 0
        self.place[over], self.aim[over] = self.rng.uniform(-1, 1, (2, int(over.sum()), 2))
        return {CHASER.name: ended.then(self.asking(self.ids[due]))}, {}

    def asking(self, which):
        self.asked = which
        rewards = self.reward[which]
        self.reward[which] = 0
        return Agents.that_ask(which, (self.observation(which),), rewards)

    def observation(self, which):
        noise = self.rng.random((len(which), 12), np.float32)
        return np.concatenate([self.place[which], self.aim[which], noise], axis=1, dtype=np.float32)


if __name__ == "__main__":
    sys.exit(main(make_simulation=UnevenVectors))
