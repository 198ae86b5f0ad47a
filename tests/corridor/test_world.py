"""Motion, switch, opponent, spawns and eq. 10's observation, by hand."""

import math

import numpy as np
import pytest
from only_behavior import act, begin

from corridor_server.corridor import world
from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.parameters import EpisodeParameters
from corridor_server.corridor.streams import area_generator


def test_velocity_lags_behind_the_action_as_the_exact_solution_says(one_area):
    area = one_area()
    state, _ = area.step(area.state(velocity=(0.4, 0.0)), (1.0, -0.5))
    decay = math.exp(-0.1 / 0.5)
    assert state.velocity[0] == pytest.approx([2 + (0.4 - 2) * decay, -1 + 1 * decay])
    assert state.position[0] == pytest.approx(
        [2 * 0.1 + (0.4 - 2) * 0.5 * (1 - decay), -1 * 0.1 + 1 * 0.5 * (1 - decay)]
    )


def test_one_long_decision_moves_as_five_short_ones(one_area):
    long, short = one_area(), one_area(decision_period=1)
    at_once, _ = long.step(long.state(velocity=(1.0, -1.0)), (0.3, 0.9))
    bit_by_bit = short.state(velocity=(1.0, -1.0))
    for _ in range(5):
        bit_by_bit, _ = short.step(bit_by_bit, (0.3, 0.9))
    assert np.allclose(at_once.position, bit_by_bit.position)
    assert np.allclose(at_once.velocity, bit_by_bit.velocity)


def test_without_a_time_constant_velocity_follows_at_once(one_area):
    area = one_area(agent_time_constant=0.0)
    state, _ = area.step(area.state(), (0.5, 0.0))
    assert state.velocity[0] == pytest.approx([1.0, 0.0])
    assert state.position[0] == pytest.approx([0.1, 0.0])


def test_actions_beyond_one_are_clipped(one_area):
    area = one_area()
    assert np.array_equal(
        area.step(area.state(), (7.0, -7.0))[0].position, area.step(area.state(), (1.0, -1.0))[0].position
    )


def test_a_wall_stops_only_the_axis_that_meets_it(one_area):
    area = one_area()
    state, _ = area.step(area.state((9.45, 0.0), velocity=(2.0, 2.0)), (1.0, 1.0))
    assert state.position[0, 0] == 9.5
    assert state.velocity[0, 0] == 0.0
    assert state.velocity[0, 1] == pytest.approx(2.0)
    assert state.wall_contacts[0] == 1


@pytest.mark.parametrize(("z", "on"), [(1.5, True), (1.499, False)])
def test_the_switch_turns_on_within_its_radius(one_area, z, on):
    area = one_area()
    assert bool(area.step(area.state((0.0, z)))[0].switch_on[0]) is on


def test_the_switch_stays_on(one_area):
    area = one_area()
    assert area.step(area.state((8.0, -4.0), switch_on=True))[0].switch_on[0]


def test_the_opponent_goes_straight_to_its_target_and_stays(one_area):
    area = one_area()
    state = area.state((8.0, 4.0), opponents=((3.0, 0.0),), opponent_targets=((2.85, 0.2),))
    state, _ = area.step(state)
    assert state.opponent_position[0, 0] == pytest.approx([2.94, 0.08])
    assert state.opponent_velocity[0, 0] == pytest.approx([-0.6, 0.8])
    for _ in range(3):
        state, _ = area.step(state)
    assert np.array_equal(state.opponent_position[0, 0], [2.85, 0.2])
    assert np.array_equal(state.opponent_velocity[0, 0], [0.0, 0.0])


def test_the_observation_is_eq_10_in_half_lengths(one_area):
    area = one_area(num_opponents=2)
    state = area.state(
        (1.0, -2.0), velocity=(0.5, -1.5), goal=(4.0, 2.0), switch_on=True, opponents=((1.0, 1.0), (-5.0, 6.0))
    )
    expected = [0.1, -0.2, 0.05, -0.15, 0.4, 0.2, 0.5, 1, 0.1, 0.1, 0.3, 0, 0, -0.5, 0.6, 1.0, 0, 0]
    observation = world.observation(area.p, state)
    assert observation.dtype == np.float32
    assert observation[0] == pytest.approx(expected)


def test_neither_the_opponents_target_nor_the_switchs_place_is_observed(one_area):
    area, elsewhere = one_area(), one_area(switch_x=5.0, switch_z=-3.0)
    here = area.state(opponents=((5.0, 0.0),), opponent_targets=((-9.0, 0.0),))
    other = area.state(opponents=((5.0, 0.0),), opponent_targets=((-9.0, 2.0),))
    assert np.array_equal(world.observation(area.p, here), world.observation(elsewhere.p, other))


def test_spawns_lie_in_their_ranges_and_use_them_whole():
    config = CorridorConfig()
    p = EpisodeParameters(config, tuple(range(4000))).columns
    state = world.initial(p, 1, [area_generator(0, area) for area in range(4000)])
    for values, low, high in (
        (state.position[:, 0], -4, -2),
        (state.position[:, 1], -3, 3),
        (state.goal[:, 1], -3, 3),
        (state.opponent_position[:, 0, 0], 7, 8.5),
        (state.opponent_position[:, 0, 1], -3, 3),
        (state.opponent_target[:, 0, 1], -2.5, 2.5),
    ):
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() <= high
    assert (state.goal[:, 0] == 9).all()
    assert (state.opponent_target[:, 0, 0] == -9).all()
    assert np.allclose(np.hypot(*state.opponent_velocity[:, 0].T), 1.0)


def test_nothing_spawns_inside_a_wall_whatever_the_parameters():
    config = CorridorConfig(spawn_z=100.0, goal_x=500.0, agent_spawn_x=(-900.0, -800.0))
    p = EpisodeParameters(config, (0,)).columns
    state = world.initial(p, 1, [area_generator(3, 0)])
    assert np.abs(state.position[0]) == pytest.approx([9.5, min(4.5, abs(state.position[0, 1]))])
    assert state.goal[0, 0] == 9.5


def test_an_areas_episodes_do_not_depend_on_how_many_areas_there_are():
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (400, 7, 2)).astype(np.float32)
    many, alone = Areas(CorridorConfig(), 5, range(7)), Areas(CorridorConfig(), 5, [4])
    assert np.array_equal(begin(many).observations[0][4], begin(alone).observations[0][0])
    ended = 0
    for action in actions:
        (together, _), (single, _) = act(many, action), act(alone, action[4:5])
        assert np.array_equal(together.deciding.observations[0][4], single.deciding.observations[0][0])
        assert together.deciding.rewards[4] == single.deciding.rewards[0]
        ended += len(single.ended)
    assert ended > 0


def test_different_seeds_and_areas_begin_differently():
    starts = [
        tuple(begin(Areas(CorridorConfig(), seed, range(2))).observations[0][area])
        for seed in (0, 1)
        for area in (0, 1)
    ]
    assert len(set(starts)) == 4
