#!/usr/bin/env python3
"""Three behaviors with a decision an episode, at which the best is worth exactly 1: what an agent may see and do.

``Aim`` has hybrid actions: 1 - |error| for pointing at the place of the lit one of three targets, if that is the one it
chose. ``Herd`` has a buffer of up to eight others, padded with zeros as Unity does: 1 for the quadrant of the closest.
``Errand`` has a goal signal: 1 for the choice that its numbers ask for where the goal says to look.
"""

import sys

import numpy as np

from corridor_server.main import main
from corridor_server.protocol.agents import ActionBatch, Agents, Behavior, Sensor
from corridor_server.simulations.simulation import Simulation

MOST, GOAL_SIGNAL = 8, 1
GOAL = Sensor.of("goal", (3,))._replace(kind=GOAL_SIGNAL)
AIM = Behavior("Aim?team=0", (Sensor.of("places and lit", (6,)),), continuous_actions=1, discrete_branches=(3,))
HERD = Behavior("Herd?team=0", (Sensor.of("others", (MOST, 2)),), discrete_branches=(4,))
ERRAND = Behavior("Errand?team=0", (Sensor.of("numbers", (3,)), GOAL), discrete_branches=(2,))
BEHAVIORS = {each.name: each for each in (AIM, HERD, ERRAND)}


class KnownOptima(Simulation):
    behaviors = BEHAVIORS

    def __init__(self, seed: int, num_areas: int) -> None:
        self.rng = np.random.default_rng(seed % 2**32)
        self.count, self.rows = num_areas, np.arange(num_areas)

    def reset(self):
        self.show()
        return {name: self.asking(name) for name in self.behaviors}

    def step(self, actions):
        rewards = {
            AIM.name: self.aimed(actions[AIM.name]),
            HERD.name: actions[HERD.name].discrete[:, 0] == self.quadrant,
            ERRAND.name: actions[ERRAND.name].discrete[:, 0] == self.wanted,
        }
        ended = {
            name: Agents.that_ended(self.ids(name), self.seen[name], paid, np.zeros(self.count))
            for name, paid in rewards.items()
        }
        self.show()
        return {name: each.then(self.asking(name)) for name, each in ended.items()}, {}

    def aimed(self, action: ActionBatch) -> np.ndarray:
        error = abs(action.continuous[:, 0] - self.places[self.rows, self.lit])
        return np.where(action.discrete[:, 0] == self.lit, 1 - error, 0)

    def show(self):
        """Draws what there is to decide, and what would be best."""
        rng, rows = self.rng, self.rows
        self.places, self.lit = rng.uniform(-0.9, 0.9, (self.count, 3)), rng.integers(0, 3, self.count)
        far = (rng.permuted(np.tile(np.arange(MOST), (self.count, 1)), axis=1) + 1) / MOST
        far[np.arange(MOST) >= rng.integers(1, MOST + 1, self.count)[:, None]] = np.inf  # not there
        angle = rng.uniform(0, 2 * np.pi, far.shape)
        self.quadrant = (angle[rows, far.argmin(axis=1)] // (np.pi / 2)).astype(int)
        others = np.where(np.isfinite(far), far, 0)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        numbers, goal = rng.uniform(-1, 1, (self.count, 3)), rng.integers(0, 3, self.count)
        self.wanted = numbers[rows, goal] > 0
        self.seen = {
            AIM.name: (np.concatenate([self.places, np.eye(3)[self.lit]], axis=1, dtype=np.float32),),
            HERD.name: (others.astype(np.float32),),
            ERRAND.name: (numbers.astype(np.float32), np.eye(3, dtype=np.float32)[goal]),
        }

    def asking(self, name):
        return Agents.that_ask(self.ids(name), self.seen[name], np.zeros(self.count))

    def ids(self, name):
        return self.rows + list(self.behaviors).index(name) * self.count


if __name__ == "__main__":
    sys.exit(main(make_simulation=KnownOptima))
