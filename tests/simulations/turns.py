"""A PettingZoo environment whose agents take turns."""

import numpy as np
from gymnasium import spaces

VECTOR = spaces.Box(-np.inf, np.inf, (2,))


class Turns:
    """Agents act one after the other; observes [episode, turn] in one array. An agent ends at its turn as it is told.

    ``ends`` says after how many turns of the game which agents end, and how.
    """

    def __init__(self, ends=None, agents=("a", "b"), first_ends=()):
        self.possible_agents, self.ends = (
            list(agents),
            {4: dict.fromkeys(agents, "terminated")} if ends is None else ends,
        )
        self.first_ends, self.seen, self.seeds = first_ends, np.zeros(2, np.float32), []

    unwrapped = property(lambda self: self)

    def observation_space(self, agent):
        return VECTOR

    def action_space(self, agent):
        return spaces.Discrete(3)

    def reset(self, seed=None, options=None):
        self.seeds.append(seed)
        self.agents, self.turn = list(self.possible_agents), 0
        self.over = dict.fromkeys(self.first_ends, "terminated")
        self.got = dict.fromkeys(self.agents, 0.0)
        self.agent_selection = self.agents[0]
        self.seen[:] = self.seen[0] + 1, 0

    def last(self):
        agent = self.agent_selection
        what = self.over.get(agent)
        return (
            self.seen,
            self.got[agent],
            what in ("terminated", "both"),
            what in ("truncated", "both"),
            self.info(agent),
        )

    def step(self, action):
        agent, at = self.agent_selection, self.agents.index(self.agent_selection)
        if agent in self.over:
            assert action is None
            self.seen[:] = self.seen[0], -1
            self.agents.remove(agent)
        else:
            self.turn += 1
            self.got[agent] = 0.0
            for other in self.agents:
                self.got[other] += 1 + action
            self.seen[:] = self.seen[0], self.turn
            self.over |= self.ends.get(self.turn, {})
            at += 1
        if self.agents:
            self.agent_selection = self.agents[at % len(self.agents)]

    def info(self, agent):
        return {"action_mask": np.array([agent == "a", 1, 1])}

    def close(self):
        pass
