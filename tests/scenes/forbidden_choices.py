#!/usr/bin/env python3
"""Two branches of 20 and 50 choices, of which 66 of all 70 are forbidden, others at every decision.

It stands for Unity's rule that a masked choice is never taken. How many decisions there were, and how many forbidden
choices among them, is the last line of the player's log.
"""

import json
import logging
import sys

import numpy as np

from corridor_server.main import main
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.simulations.simulation import Simulation

BRANCHES, ALLOWED, LENGTH = (20, 50), (1, 3), 16
CHOOSER = Behavior("Chooser?team=0", (Sensor.of("noise", (4,)),), discrete_branches=BRANCHES)
BEHAVIORS = {CHOOSER.name: CHOOSER}


class ForbiddenChoices(Simulation):
    behaviors = BEHAVIORS

    def __init__(self, seed: int, num_areas: int) -> None:
        self.rng = np.random.default_rng(seed % 2**32)
        self.ids, self.time = np.arange(num_areas), 0
        self.counts = {"decisions": 0, "forbidden": 0}

    def reset(self):
        return {CHOOSER.name: self.asking(np.zeros(len(self.ids)))}

    def step(self, actions):
        choices = actions[CHOOSER.name].discrete
        self.counts["decisions"] += len(choices)
        for mask, choice in zip(self.masks, choices.T, strict=True):
            self.counts["forbidden"] += int(mask[self.ids, choice].sum())
        rewards, self.time = choices.sum(axis=1) / sum(BRANCHES), self.time + 1
        if self.time % LENGTH:
            return {CHOOSER.name: self.asking(rewards)}, {}
        ended = Agents.that_ended(self.ids, (self.observation(),), rewards, np.zeros(len(self.ids)))
        return {CHOOSER.name: ended.then(self.asking(np.zeros(len(self.ids))))}, {}

    def asking(self, rewards):
        order = [self.rng.random((len(self.ids), size)).argsort(axis=1) for size in BRANCHES]
        self.masks = tuple(each >= count for each, count in zip(order, ALLOWED, strict=True))
        return Agents.that_ask(self.ids, (self.observation(),), rewards, self.masks)

    def observation(self):
        return self.rng.normal(size=(len(self.ids), 4)).astype(np.float32)

    def close(self):
        logging.getLogger("scene").info(json.dumps(self.counts))


if __name__ == "__main__":
    sys.exit(main(make_simulation=ForbiddenChoices))
