"""What a trainer changes in a PettingZoo environment: attributes, arguments and samplers."""

import pytest
from gymnasium import spaces
from simulations.foxes_and_hares import FOXES_AND_HARES, Together
from simulations.pettingzoo_moments import answer, asking, envs

from corridor_server.protocol.samplers import Uniform
from corridor_server.simulations.simulation import SimulationError


def test_a_declared_attribute_is_set_from_the_next_episode_on(play_pettingzoo):
    simulation = play_pettingzoo(num_areas=2, parameters=("gravity", "length"))
    answer(simulation, simulation.reset())
    simulation.set_parameter("gravity", 3.0)
    simulation.set_parameter("length", 1.0)
    assert [env.gravity for env in envs(simulation)] == [1, 1]
    simulation.reset()
    assert [env.gravity for env in envs(simulation)] == [3, 3]
    assert [env.length for env in envs(simulation)] == [1, 1]


def test_an_argument_is_set_by_making_the_environment_anew_deterministically(play_pettingzoo):
    def drawn():
        simulation = play_pettingzoo(arguments={"length": 1}, num_areas=2, seed=4)
        found = []
        for length in (1.0, 2.0, 1.0):
            simulation.set_parameter("length", length)
            answer(simulation, simulation.reset())
            assert {env.length for env in envs(simulation)} == {int(length)}
            found += [env.drawn[0] for env in envs(simulation)]
        return found

    first = drawn()
    assert first == drawn()
    assert len(set(first)) == 6  # also of an environment whose random numbers nobody can ask for


def test_a_sampler_draws_for_every_copy_and_episode(play_pettingzoo):
    simulation = play_pettingzoo(num_areas=2, parameters=("gravity",), arguments={"length": 1})
    simulation.set_parameter("gravity", Uniform(7, 1.0, 2.0))
    moment = simulation.reset()
    first = [env.gravity for env in envs(simulation)]
    answer(simulation, moment)
    assert len({*first, *(env.gravity for env in envs(simulation))}) == 4


def test_an_argument_that_changes_the_spaces_is_refused_and_fewer_agents_are_not(play_pettingzoo):
    class Sized(Together):
        def __init__(self, count=3, size=2):
            super().__init__(agents=FOXES_AND_HARES[:count])
            self.size = size

        def observation_space(self, agent):
            return spaces.Box(-9, 9, (self.size,))

    simulation = play_pettingzoo(Sized, arguments={"count": 3, "size": 2})
    simulation.reset()
    simulation.set_parameter("count", 2.0)
    assert asking(simulation.reset()) == {"fox": [0, 1]}
    simulation.set_parameter("size", 3.0)
    with pytest.raises(
        SimulationError, match=r"With count = 2, size = 3 the environment has other spaces than a trainer"
    ):
        simulation.reset()


def test_a_parameter_that_is_not_declared_is_refused(play_pettingzoo):
    with pytest.raises(ValueError, match="'x' is no environment parameter here: none is declared"):
        play_pettingzoo().set_parameter("x", 1.0)
    with pytest.raises(SimulationError, match="--parameters names 'plot', but the environment has no such number"):
        play_pettingzoo(parameters=("plot",))
