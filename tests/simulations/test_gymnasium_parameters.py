"""What a trainer or its user changes in a Gymnasium environment: attributes, arguments, samplers and wrappers."""

import sys
import types

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from simulations.counting import Count, answer, only

from corridor_server.protocol.samplers import Uniform
from corridor_server.simulations.declared_parameters import like
from corridor_server.simulations.simulation import SimulationError


def in_envs(simulation, name):
    return [getattr(env.unwrapped, name) for env in simulation._copies.envs]


def test_a_declared_attribute_is_set_from_the_next_episode_on(play_gymnasium):
    simulation = play_gymnasium(parameters=("gravity", "length"), arguments={})
    simulation.reset()
    simulation.set_parameter("gravity", 3.0)
    simulation.set_parameter("length", 2.0)
    answer(simulation)
    assert in_envs(simulation, "gravity") == [9.8, 9.8]
    simulation.reset()
    assert in_envs(simulation, "gravity") == [3.0, 3.0]
    assert in_envs(simulation, "length") == [2, 2]  # it is a whole number, and stays one
    assert isinstance(in_envs(simulation, "length")[0], int)


@pytest.mark.parametrize(
    ("present", "value", "expected"),
    [
        (10, 9.81, 9.81),
        (10, 12.0, 12),
        (10, -0.5, -0.5),
        (10.0, 12.0, 12.0),
        (np.int64(10), 9.81, 9.81),
        (np.int64(10), 12.0, np.int64(12)),
        (np.float32(1), 0.25, np.float32(0.25)),
        (True, 0.0, False),
        (False, 0.5, True),
        (np.bool_(False), 1.0, np.bool_(True)),
    ],
)
def test_a_value_has_the_type_of_what_it_replaces_but_none_is_rounded(present, value, expected):
    found = like(present, value)
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize("declared", [{"parameters": ("length",)}, {"arguments": {"length": 3}}])
def test_a_value_that_is_not_whole_is_not_rounded_where_an_integer_was(declared, play_gymnasium):
    simulation = play_gymnasium(**declared)
    simulation.set_parameter("length", 2.5)
    simulation.reset()
    assert in_envs(simulation, "length") == [2.5, 2.5]


def test_numpys_numbers_are_parameters_too(play_gymnasium):
    simulation = play_gymnasium(parameters=("half",))
    simulation.set_parameter("half", 0.25)
    simulation.reset()
    assert in_envs(simulation, "half") == [0.25, 0.25]
    assert isinstance(in_envs(simulation, "half")[0], np.float32)


def test_a_parameter_that_is_set_before_the_first_reset_counts_for_it_in_every_copys_process(play_gymnasium):
    simulation = play_gymnasium("Pendulum-v1", parameters=("g",), mode="async")
    simulation.set_parameter("g", 0.0)
    simulation.reset()
    assert simulation._copies.vector.get_attr("unwrapped")[0].g == 0


def test_a_parameter_begins_even_an_episode_that_began_by_itself_anew(play_gymnasium):
    simulation = play_gymnasium(arguments={"length": 1}, parameters=("gravity",))
    simulation.reset()
    answer(simulation)
    simulation.set_parameter("gravity", 1.0)
    assert only(simulation.reset()).observations[0][:, 0].tolist() == [3, 3]
    answer(simulation)
    simulation.set_parameter("gravity", 1.0)  # nothing new
    assert only(simulation.reset()).observations[0][:, 0].tolist() == [4, 4]


def test_an_argument_is_set_by_making_the_environment_anew_deterministically(play_gymnasium):
    def episodes():
        simulation = play_gymnasium(arguments={"length": 1}, seed=4)
        simulation.reset()
        seen = []
        for length in (2.0, 1.0, 1.0):
            simulation.set_parameter("length", length)
            seen.append(only(simulation.reset()).observations[0].tolist())
            assert in_envs(simulation, "length") == [length] * 2
            answer(simulation)
        return seen

    first = episodes()
    assert first == episodes()
    numbers = [row[2] for moment in first[:2] for row in moment]
    assert len(set(numbers)) == 4  # each episode and copy has random numbers of its own


def test_an_argument_that_changes_the_spaces_is_refused(play_gymnasium):
    class Sized(Count):
        def __init__(self, size=3):
            super().__init__()
            self.observation_space = spaces.Box(-1, 1, (size,))

        def reset(self, **options):
            super().reset(**options)
            return np.zeros(self.observation_space.shape, np.float32), {}

    simulation = play_gymnasium(Sized, arguments={"size": 3})
    simulation.reset()
    simulation.set_parameter("size", 4.0)
    with pytest.raises(
        SimulationError, match=r"With size = 4 the environment has other spaces than a trainer was told"
    ):
        simulation.reset()


def test_a_sampler_draws_for_every_copy_and_episode_the_same_each_time(play_gymnasium):
    def drawn():
        simulation = play_gymnasium(parameters=("gravity",), arguments={"length": 1})
        simulation.set_parameter("gravity", Uniform(7, 1.0, 2.0))
        simulation.reset()
        found = in_envs(simulation, "gravity")
        answer(simulation)
        return found + in_envs(simulation, "gravity")

    first = drawn()
    assert first == drawn()
    assert len(set(first)) == 4
    assert all(1 <= value <= 2 for value in first)


def test_a_wrapper_with_a_setting_of_its_own_gets_none_of_ours(play_gymnasium, monkeypatch):
    class Own(gymnasium.Wrapper):
        def __init__(self, env):
            super().__init__(env)
            self.settings = "mine"

    monkeypatch.setitem(sys.modules, "my_wrappers", types.SimpleNamespace(Own=Own))
    simulation = play_gymnasium(parameters=("gravity",), wrappers=("my_wrappers:Own",))
    simulation.set_parameter("gravity", 3.0)
    simulation.reset()
    assert in_envs(simulation, "gravity") == [3, 3]
    assert [env.get_wrapper_attr("settings") for env in simulation._copies.envs] == ["mine", "mine"]


@pytest.mark.parametrize(
    ("declared", "wrapped"), [({}, False), ({"parameters": ("gravity",)}, True), ({"arguments": {"length": 3}}, True)]
)
def test_a_copy_has_a_wrapper_of_ours_in_its_way_only_where_something_can_be_set(declared, wrapped, play_gymnasium):
    for env in play_gymnasium(**declared)._copies.envs:
        assert env.has_wrapper_attr("settings_from_trainer") == wrapped


def test_a_parameter_that_is_not_declared_is_refused_with_the_nearest(play_gymnasium):
    with pytest.raises(
        ValueError, match="'gravty' is no environment parameter here: the nearest that is declared is grav"
    ):
        play_gymnasium(parameters=("gravity",)).set_parameter("gravty", 1.0)
    with pytest.raises(ValueError, match="none is declared; an attribute is declared with --parameters"):
        play_gymnasium().set_parameter("length", 1.0)


@pytest.mark.parametrize("name", ["nothing", "ends", "seen"])
def test_an_attribute_that_is_no_number_cant_be_declared(name, play_gymnasium):
    with pytest.raises(SimulationError, match=f"--parameters names '{name}', but Mine0-v0 has no such number"):
        play_gymnasium(parameters=(name,))


# Wrappers.


def test_wrappers_are_put_around_it_from_the_inmost_and_may_change_the_spaces(play_gymnasium):
    simulation = play_gymnasium(
        "FrozenLake-v1",
        wrappers=("gymnasium.wrappers:FlattenObservation", "my_wrappers:three_actions"),
    )
    assert [sensor.shape for sensor in simulation._behavior.sensors] == [(16,)]
    assert simulation._behavior.discrete_branches == (3,)
    assert only(simulation.reset()).observations[0].sum(axis=1).tolist() == [1, 1]


@pytest.fixture(autouse=True)
def my_wrappers(monkeypatch):
    def three_actions(env):
        return gymnasium.wrappers.TransformAction(env, lambda action: action, spaces.Discrete(3))

    monkeypatch.setitem(sys.modules, "my_wrappers", types.SimpleNamespace(three_actions=three_actions))
