"""A PettingZoo environment whose agents act together, by a plot."""

import numpy as np
from gymnasium import spaces

VECTOR = spaces.Box(-np.inf, np.inf, (2,))
FOXES_AND_HARES = ("fox_0", "fox_1", "hare_0")


class Together:
    """Observes [episode, step] in one array per agent that it goes on writing into; ``plot`` says who ends and comes.

    The plot is, by step, of whom what is said: "terminated", "truncated", "both", "gone" without a word, or "comes".
    """

    def __init__(self, plot=None, agents=FOXES_AND_HARES, first=None, rewards=None, length=3, gravity=1.0):
        self.plot, self.possible_agents, self.first = plot or {}, list(agents), list(first or agents)
        self.rewards, self.length, self.gravity, self.seeds = rewards or {}, length, gravity, []
        self.np_random = None
        self.seen = {agent: np.zeros(2, np.float32) for agent in agents}
        self.drawn = []

    @property
    def unwrapped(self):
        return self

    def observation_space(self, agent):
        return VECTOR

    def action_space(self, agent):
        return spaces.Discrete(3)

    def reset(self, seed=None, options=None):
        self.seeds.append(seed)
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self.drawn.append(self.np_random.random())
        self.agents, self.step_number = list(self.first), 0
        for seen in self.seen.values():
            seen[:] = seen[0] + 1, 0
        return {agent: self.seen[agent] for agent in self.agents}, {agent: self.info(agent) for agent in self.agents}

    def step(self, actions):
        assert actions.keys() == set(self.agents)
        self.step_number += 1
        said = dict(self.plot.get(self.step_number, {}))
        if self.step_number == self.length:
            said |= dict.fromkeys(self.agents, "terminated")
        told = list(self.agents) + [agent for agent, what in said.items() if what == "comes"]
        for agent in told:
            self.seen[agent][1] = self.step_number
        self.agents = [agent for agent in told if said.get(agent, "comes") == "comes"]
        return (
            {agent: self.seen[agent] for agent in told},
            {agent: self.rewards.get(agent, 0.0) + actions.get(agent, 0) for agent in told},
            {agent: said.get(agent) in ("terminated", "both") for agent in told},
            {agent: said.get(agent) in ("truncated", "both") for agent in told},
            {agent: self.info(agent) for agent in told},
        )

    def info(self, agent):
        return {}

    def close(self):
        pass
