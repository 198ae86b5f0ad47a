"""Environments of others, saved in the middle of episodes, go on in new copies as they would have, to the bit."""

import numpy as np
import pytest
from simulations.test_running_episodes import over_the_wire, told
from simulations.test_zoo_of_gymnasium import ONLY_THE_PICTURE, ZOO
from simulations.test_zoo_of_pettingzoo import IN_TURNS, TOGETHER
from simulations.zoo import SEED

from corridor_server.protocol.agents import ActionBatch

STEPS = 200
NOT_SAVED = "BipedalWalker-v3"  # its Box2D world lives on in the next episode, and remembers in compiled code


def opened(name):
    if name in ZOO:
        from corridor_server.simulations.gymnasium_simulation import GymnasiumEnvironment, GymnasiumSimulation

        wrappers = (ONLY_THE_PICTURE,) if name.startswith("minigrid") else ()
        return GymnasiumSimulation(GymnasiumEnvironment(name, wrappers=wrappers), SEED, 2)
    from corridor_server.simulations.pettingzoo_simulation import PettingZooEnvironment, PettingZooSimulation

    return PettingZooSimulation(PettingZooEnvironment(name), SEED, 2)


def play(simulation, moment, rng):
    """What is told in steps of random actions that the masks allow, and the last moment."""
    found = []
    for _ in range(STEPS):
        actions = {}
        for name, agents in moment.items():
            asking, behavior = agents.deciding, simulation.behaviors[name]
            discrete = np.zeros((len(asking), len(behavior.discrete_branches)), np.int32)
            for row, branch in np.ndindex(discrete.shape):
                forbidden = asking.masks[branch][row] if asking.masks else np.zeros(behavior.discrete_branches[branch])
                discrete[row, branch] = rng.choice(np.flatnonzero(forbidden == 0))
            numbers = rng.uniform(-1, 1, (len(asking), behavior.continuous_actions)).astype(np.float32)
            actions[name] = ActionBatch(numbers, discrete)
        moment, _ = simulation.step(actions)
        found.append(told(moment))
    return found, moment


@pytest.mark.slow
@pytest.mark.parametrize("name", [each for each in (*ZOO, *dict(TOGETHER), *IN_TURNS) if each != NOT_SAVED])
def test_two_hundred_steps_after_two_hundred_are_the_same_in_new_copies(name):
    first, again, rng = opened(name), opened(name), np.random.default_rng(1)
    _, moment = play(first, first.reset(), rng)
    over_the_wire(first, again)
    state = rng.bit_generator.state
    expected, _ = play(first, moment, rng)
    rng.bit_generator.state = state
    found, _ = play(again, again.reset(), rng)
    assert found == expected
    first.close()
    again.close()


@pytest.mark.slow
def test_from_the_second_episode_on_an_environment_that_remembers_in_compiled_code_has_no_state():
    simulation, rng = opened(NOT_SAVED), np.random.default_rng(1)
    moment = simulation.reset()
    assert simulation.snapshot() is not None
    ended = False
    while not ended:
        found, moment = play(simulation, moment, rng)
        ended = any(any(done) for step in found for _, _, _, done, *_ in step)
    assert simulation.snapshot() is None
    simulation.close()
