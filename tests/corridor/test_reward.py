"""Eq. 9 by hand: every case, every boundary, and the order of the cases. Half-length is 10 m, radii are 0.5 m."""

import numpy as np
import pytest

GOAL = (6.0, 0.0)
AT_GOAL = (5.5, 0.0)


def test_an_ordinary_step_costs_a_thousandth(one_area):
    area = one_area()
    assert area.reward(area.state((3.0, 0.0))) == -0.001


def test_the_goal_with_the_switch_on_pays_one_and_ends_the_episode(one_area):
    area = one_area()
    _, outcome = area.step(area.state(AT_GOAL, goal=GOAL, switch_on=True))
    assert outcome.reward[0] == 1.0
    assert outcome.success[0]
    assert not outcome.failed[0]


def test_the_goal_without_the_switch_is_an_ordinary_step(one_area):
    area = one_area()
    _, outcome = area.step(area.state(AT_GOAL, goal=GOAL, switch_on=False))
    assert outcome.reward[0] == -0.001
    assert not outcome.ended[0]


@pytest.mark.parametrize(("distance", "reached"), [(0.75, True), (0.7501, False)])
def test_the_goal_is_reached_within_its_radius(one_area, distance, reached):
    area = one_area()
    state = area.state((5.0, 0.0), goal=(5.0 + distance, 0.0), switch_on=True)
    assert bool(area.step(state)[1].success[0]) is reached


def test_turning_the_switch_on_and_reaching_the_goal_in_one_step_counts(one_area):
    area = one_area()
    state = area.state((0.0, 3.0), goal=(0.0, 3.5), switch_on=False)
    assert area.step(state)[1].success[0]


def test_pushing_into_a_wall_costs_a_tenth(one_area):
    area = one_area()
    assert area.reward(area.state((0.0, -4.5)), (0.0, -1.0)) == -0.1


def test_standing_at_a_wall_or_moving_along_it_is_no_contact(one_area):
    area = one_area()
    assert area.reward(area.state((3.0, -4.5))) == -0.001
    assert area.reward(area.state((3.0, -4.5)), (1.0, 0.0)) == -0.001


@pytest.mark.parametrize(("apart", "expected"), [(0.9, -0.25), (1.0, -0.25)])
def test_touching_an_opponent_costs_a_quarter(one_area, apart, expected):
    """d_opp = 0 means that the surfaces touch: centres 1 m apart."""
    area = one_area()
    assert area.reward(area.state((0.0, 0.0), opponents=((apart, 0.0),))) == expected


def test_just_beyond_touch_is_the_near_zone(one_area):
    area = one_area()
    assert area.reward(area.state((0.0, 0.0), opponents=((1.5, 0.0),))) == pytest.approx(-0.1 - (1 - 0.15) / 4)


def test_the_near_zone_ends_at_a_fifth_exactly(one_area):
    area = one_area()
    at, inside = ((2.0, 0.0),), ((1.999, 0.0),)
    assert area.reward(area.state((0.0, 0.0), opponents=at)) == -0.001
    assert area.reward(area.state((0.0, 0.0), opponents=inside)) == pytest.approx(-0.1 - (1 - 0.1999) / 4)


def test_goal_comes_before_wall_contact_and_near_zone(one_area):
    area = one_area()
    state = area.state((9.5, 0.0), goal=(9.5, 0.0), switch_on=True, opponents=((9.5, 0.5),))
    assert area.reward(state, (1.0, 0.0)) == 1.0


def test_wall_comes_before_opponent_contact(one_area):
    area = one_area()
    assert area.reward(area.state((0.0, -4.5), opponents=((0.5, -4.5),)), (0.0, -1.0)) == -0.1


def test_contact_comes_before_the_near_zone(one_area):
    area = one_area()
    assert area.reward(area.state((0.0, 0.0), opponents=((0.5, 0.0),))) == -0.25


def test_the_nearest_of_several_opponents_counts(one_area):
    area = one_area(num_opponents=3)
    state = area.state((0.0, 0.0), opponents=((5.0, 0.0), (-1.5, 0.0), (0.0, 3.0)))
    assert area.reward(state) == pytest.approx(-0.1 - (1 - 0.15) / 4)


def test_a_return_just_above_minus_one_goes_on(one_area):
    area = one_area()
    _, outcome = area.step(area.state((3.0, 0.0), episode_return=-0.9989))
    assert outcome.reward[0] == -0.001
    assert not outcome.ended[0]


def test_a_return_of_minus_one_fails_and_costs_one_more(one_area):
    area = one_area()
    _, outcome = area.step(area.state((3.0, 0.0), episode_return=-0.999))
    assert outcome.failed[0]
    assert not outcome.truncated[0]
    assert outcome.reward[0] == pytest.approx(-1.001)


def test_a_thousand_ordinary_steps_fail_the_episode(one_area):
    area = one_area()
    state, ends = area.state((3.0, 0.0)), []
    for _ in range(1000):
        state, outcome = area.step(state)
        ends.append(bool(outcome.failed[0]))
    assert ends == [False] * 999 + [True]


def test_case_study_b_ends_the_episode_without_the_extra_penalty(one_area):
    area = one_area(failure_penalty=0.0)
    _, outcome = area.step(area.state((3.0, 0.0), episode_return=-0.9995))
    assert outcome.failed[0]
    assert outcome.reward[0] == -0.001


def test_reaching_the_goal_at_the_last_moment_is_no_failure(one_area):
    area = one_area()
    _, outcome = area.step(area.state(AT_GOAL, goal=GOAL, switch_on=True, episode_return=-0.9999))
    assert outcome.success[0]
    assert not outcome.failed[0]
    assert outcome.reward[0] == 1.0


def test_a_step_limit_truncates_without_penalty(one_area):
    area = one_area(max_episode_steps=5)
    _, outcome = area.step(area.state((3.0, 0.0), episode_steps=4))
    assert outcome.truncated[0]
    assert not outcome.failed[0]
    assert outcome.reward[0] == -0.001


def test_failing_at_the_step_limit_is_terminated_not_truncated(one_area):
    area = one_area(max_episode_steps=5)
    _, outcome = area.step(area.state((3.0, 0.0), episode_steps=4, episode_return=-1.0))
    assert outcome.failed[0]
    assert not outcome.truncated[0]


def test_the_accumulated_reward_leaves_the_failure_penalty_out(one_area):
    area = one_area()
    state, _ = area.step(area.state((3.0, 0.0), episode_return=-0.9995))
    assert np.isclose(state.episode_return[0], -1.0005)
