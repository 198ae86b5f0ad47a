"""How a trainer's actions become those of an action space."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector.utils import batch_space, iterate
from gymnasium.wrappers import RescaleAction

from corridor_server.protocol.agents import ActionBatch
from corridor_server.simulations.action_choices import ActionChoices
from corridor_server.simulations.simulation import SimulationError


def acting(continuous=(), discrete=()):
    """A row each."""
    rows = max(len(continuous), len(discrete))
    numbers = np.array(continuous, np.float32).reshape(rows, -1) if len(continuous) else np.zeros((rows, 0), np.float32)
    choices = np.array(discrete, np.int32).reshape(rows, -1) if len(discrete) else np.zeros((rows, 0), np.int32)
    return ActionBatch(numbers, choices)


def actions_of(space, batch):
    """As a vector environment gives them to its copies."""
    return list(iterate(batch_space(space, len(batch.continuous)), ActionChoices(space, "It").read(batch)))


class Echo(gymnasium.Env):
    observation_space = spaces.Discrete(1)

    def __init__(self, space):
        self.action_space = space

    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        self.got = action
        return 0, 0.0, False, False, {}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("low", "high"), [(-1, 1), (0, 1), (-3, 5), (2, 2.5), (-1e6, 1e3)])
def test_minus_1_to_1_is_scaled_to_the_bounds_as_gymnasium_does_it(low, high, dtype):
    space = spaces.Box(low, high, (3,), dtype)
    env = Echo(space)
    rescaled = RescaleAction(env, -np.ones(3, dtype), np.ones(3, dtype))
    numbers = np.random.default_rng(0).uniform(-1, 1, (50, 3)).astype(np.float32)
    numbers[:2] = [[-1] * 3, [1] * 3]
    for row, action in zip(numbers, actions_of(space, acting(numbers)), strict=True):
        rescaled.step(row.astype(dtype))
        assert np.allclose(action, env.got, rtol=1e-5, atol=1e-5 * max(abs(low), abs(high)))
        assert action.dtype == dtype
        assert space.contains(action)


def test_the_ends_are_the_bounds_and_what_lies_beyond_is_cut():
    space = spaces.Box(np.array([-2, 0], np.float32), np.array([2, 10], np.float32))
    found = actions_of(space, acting([[-1, 1], [-7, 7], [0, 0]]))
    assert np.array_equal(found, [[-2, 10], [-2, 10], [0, 5]])


def test_a_number_without_bounds_is_itself():
    space = spaces.Box(-np.inf, np.inf, (2,))
    assert np.array_equal(actions_of(space, acting([[0.25, -30]])), [[0.25, -30]])


def test_a_number_with_one_bound_is_itself_up_to_that():
    space = spaces.Box(np.array([0, -np.inf], np.float32), np.array([np.inf, 0.5], np.float32))
    assert np.array_equal(actions_of(space, acting([[-1, -1], [3, 3]])), [[0, -1], [3, 0.5]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_largest_bounds_that_there_are_give_finite_actions(dtype):
    most = np.finfo(dtype).max
    found = np.array(actions_of(spaces.Box(-most, most, (1,), dtype), acting([[-1], [0], [1]])))
    assert np.isfinite(found).all()
    assert found[1] == 0


def test_a_box_of_any_rank_gets_its_shape():
    space = spaces.Box(-1, 1, (2, 3))
    [action] = actions_of(space, acting([[0, 0.1, 0.2, 0.3, 0.4, 0.5]]))
    assert np.array_equal(action, np.array([[0, 0.1, 0.2], [0.3, 0.4, 0.5]], np.float32))
    assert actions_of(spaces.Box(0, 4, ()), acting([[0.5], [-1]])) == [3, 0]


@pytest.mark.parametrize("start", [0, 1, -5])
def test_a_choice_counts_from_the_spaces_start(start):
    space = spaces.Discrete(3, start=start)
    assert ActionChoices(space, "It").branches == (3,)
    found = actions_of(space, acting((), [[0], [2]]))
    assert found == [start, start + 2]
    assert all(space.contains(each) for each in found)


def test_several_choices_are_branches_and_count_from_their_starts():
    space = spaces.MultiDiscrete([2, 3], start=[1, -1])
    assert ActionChoices(space, "It").branches == (2, 3)
    [action] = actions_of(space, acting((), [[1, 2]]))
    assert action.tolist() == [2, 1]
    assert space.contains(action)
    [grid] = actions_of(spaces.MultiDiscrete([[2, 2], [2, 3]]), acting((), [[0, 1, 1, 2]]))
    assert grid.tolist() == [[0, 1], [1, 2]]


def test_flags_are_branches_of_two():
    space = spaces.MultiBinary((2, 2))
    assert ActionChoices(space, "It").branches == (2, 2, 2, 2)
    [action] = actions_of(space, acting((), [[1, 0, 0, 1]]))
    assert action.tolist() == [[1, 0], [0, 1]]
    assert space.contains(action)


def test_numbers_and_choices_of_nested_parts_are_one_hybrid_action():
    space = spaces.Dict(
        {
            "arm": spaces.Box(0, 2, (2,)),
            "legs": spaces.Tuple([spaces.Discrete(2), spaces.Dict({"lift": spaces.Box(-5, 5, (1,))})]),
            "mode": spaces.MultiDiscrete([3, 4]),
        }
    )
    choices = ActionChoices(space, "It")
    assert (choices.continuous, choices.branches) == (3, (2, 3, 4))
    first, second = actions_of(space, acting([[0, 1, -1], [-1, -1, 1]], [[1, 2, 3], [0, 0, 0]]))
    assert first["arm"].tolist() == [1, 2]
    assert first["legs"][0] == 1
    assert first["legs"][1]["lift"].tolist() == [-5]
    assert first["mode"].tolist() == [2, 3]
    assert second["arm"].tolist() == [0, 0]
    assert second["legs"][1]["lift"].tolist() == [5]
    assert space.contains(first)
    assert space.contains(second)


def test_a_mask_says_what_is_allowed_and_travels_as_what_is_forbidden():
    choices = ActionChoices(spaces.MultiDiscrete([2, 3]), "It")
    allowed = np.array([[1, 0, 1, 1, 0], [1, 1, 1, 1, 1]], np.int8)
    masks = choices.forbidden(allowed, np.arange(2, dtype=np.int32), np.zeros(2, np.bool_))
    assert [mask.tolist() for mask in masks] == [
        [[False, True], [False, False]],
        [[False, False, True], [False, False, False]],
    ]


def test_a_mask_that_leaves_a_branch_no_choice_is_refused_but_of_who_ended():
    choices = ActionChoices(spaces.MultiDiscrete([2, 3]), "It")
    allowed, ids = np.array([[1, 1, 1, 1, 1], [1, 0, 0, 0, 0]], np.int8), np.array([4, 7], np.int32)
    with pytest.raises(SimulationError) as caught:
        choices.forbidden(allowed, ids, np.array([False, False]))
    assert str(caught.value) == (
        "The environment gave agent 7 an action_mask that forbids all choices of branch 1, but at least one that is "
        "allowed was expected: no policy can answer it."
    )
    masks = choices.forbidden(allowed, ids, np.array([False, True]))
    assert not any(mask.any() for mask in masks)


@pytest.mark.parametrize("shape", [(4,), (6,), (5, 1), ()])
def test_a_mask_of_another_number_of_choices_is_refused(shape):
    with pytest.raises(SimulationError) as caught:
        ActionChoices(spaces.MultiDiscrete([2, 3]), "It").check_mask(np.ones(shape))
    said = (
        f"The environment gave an action_mask of shape {shape}, but one value for each of its 5 choices was expected."
    )
    assert str(caught.value) == said


@pytest.mark.parametrize(
    ("space", "part"),
    [
        (spaces.Text(5), "the action as Text"),
        (spaces.Box(0, 9, (2,), np.int32), "the action as Box of int32"),
        (spaces.Dict({"a": spaces.Tuple([spaces.Sequence(spaces.Discrete(2))])}), "the action['a'][0] as Sequence"),
    ],
)
def test_a_part_that_cant_be_carried_is_named(space, part):
    with pytest.raises(SimulationError) as caught:
        ActionChoices(space, "Env-v0")
    assert str(caught.value).startswith(f"Env-v0 has {part}, which can't be carried: only Box of floats, Discrete, ")
    assert str(caught.value).endswith("change it with a wrapper.")


@pytest.mark.parametrize(
    ("space", "numbers", "choices"),
    [
        (spaces.Discrete(2**31), 0, 2**31),
        (spaces.MultiDiscrete([6_000, 6_000]), 0, 12_000),
        (spaces.Box(0, 1, (10_001,)), 10_001, 0),
    ],
)
def test_too_many_choices_are_refused(space, numbers, choices):
    with pytest.raises(SimulationError) as caught:
        ActionChoices(space, "Env-v0")
    said = f"Env-v0 has {numbers} numbers and {choices} choices in an action, but at most 10000 can be carried."
    assert str(caught.value) == said


@pytest.mark.parametrize("space", [spaces.Tuple(()), spaces.Dict({})])
def test_an_agent_that_does_nothing_is_refused(space):
    with pytest.raises(
        SimulationError, match=r"^Env-v0 does nothing: an action of at least one number or choice was ex"
    ):
        ActionChoices(space, "Env-v0")
