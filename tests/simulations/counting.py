"""A Gymnasium environment that counts, and the answers to the agents that its copies are."""

import gymnasium
import numpy as np
from gymnasium import spaces

from corridor_server.protocol.agents import ActionBatch

VECTOR = spaces.Box(-np.inf, np.inf, (3,))


class Count(gymnasium.Env):
    """Observes [episode, step, a number drawn when the episode began] in one array that it goes on writing into."""

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - Gymnasium's
    observation_space = VECTOR
    action_space = spaces.Discrete(3)

    def __init__(self, length=3, ends="terminated", render_mode=None):
        self.length, self.ends, self.render_mode = length, ends, render_mode
        self.gravity, self.seen, self.seeds = 9.8, np.zeros(3, np.float32), []
        self.half = np.float32(0.5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        assert options is None
        self.seeds.append(seed)
        self.seen[:] = self.seen[0] + 1, 0, self.np_random.random()
        return self.seen, self.info()

    def step(self, action):
        self.seen[1] += 1
        over = self.seen[1] == self.length
        terminated, truncated = over and self.ends != "truncated", over and self.ends != "terminated"
        return self.seen, 10 * self.seen[1] + action, terminated, truncated, self.info()

    def info(self):
        return {}

    def render(self):
        return np.full((40, 60, 3), 200, np.uint8)


def only(moment):
    [agents] = moment.values()
    return agents


def answer(simulation, discrete=0, continuous=0.0):
    """Steps with the same action for all; returns those that ended and those that ask."""
    [(name, behavior)] = simulation.behaviors.items()
    count = len(simulation._ids)
    numbers = np.full((count, behavior.continuous_actions), continuous, np.float32)
    choices = np.full((count, len(behavior.discrete_branches)), discrete, np.int32)
    moment, statistics = simulation.step({name: ActionBatch(numbers, choices)})
    assert statistics == {}
    agents = only(moment)
    ended = len(agents.ended)
    assert agents.done.tolist() == [True] * ended + [False] * count  # ends stand before requests
    return agents.ended, agents.deciding
