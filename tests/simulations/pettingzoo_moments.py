"""What a PettingZoo simulation told in a moment, by agent, and the same action for all who ask."""

import numpy as np

from corridor_server.protocol.agents import ActionBatch


def envs(simulation):
    return [area._env for area in simulation._areas]


def zeros(simulation, moment, choice=0):
    return {
        name: ActionBatch(
            np.zeros((len(agents.deciding), simulation.behaviors[name].continuous_actions), np.float32),
            np.full((len(agents.deciding), len(simulation.behaviors[name].discrete_branches)), choice, np.int32),
        )
        for name, agents in moment.items()
        if len(agents.deciding)
    }


def answer(simulation, moment, choice=0):
    moment, statistics = simulation.step(zeros(simulation, moment, choice))
    assert statistics == {}
    return moment


def asking(moment):
    return {name.partition("?")[0]: agents.deciding.ids.tolist() for name, agents in moment.items()}


def ended(moment):
    """Of each that ended, by id: [episode, step] and whether it was interrupted."""
    return {
        number: (seen.tolist(), cut)
        for agents in moment.values()
        for number, seen, cut in zip(
            agents.ended.ids.tolist(), agents.ended.observations[0], agents.ended.interrupted.tolist(), strict=True
        )
    }


def rewards(moment):
    return {
        number: (float(own), float(shared))
        for agents in moment.values()
        for number, own, shared, done in zip(
            agents.ids.tolist(), agents.rewards, agents.group_rewards, agents.done, strict=True
        )
        if not done
    }
