"""Eq. 10 by hand: what stands where, with one opponent and with three."""

import numpy as np
import pytest

from corridor_server.corridor import observation as layout
from corridor_server.corridor import world


def test_every_number_has_a_name_and_a_place():
    seen = np.arange(13)
    assert seen[layout.POSITION].tolist() == [0, 1]
    assert seen[layout.VELOCITY].tolist() == [2, 3]
    assert seen[layout.GOAL].tolist() == [4, 5]
    assert seen[layout.GOAL_DISTANCE] == 6
    assert seen[layout.SWITCH] == 7
    [opponent] = layout.opponent_blocks(seen)
    assert opponent[layout.OPPONENT_POSITION].tolist() == [8, 9]
    assert opponent[layout.OPPONENT_DISTANCE] == 10
    assert opponent[layout.OPPONENT_VELOCITY].tolist() == [11, 12]


@pytest.mark.parametrize(("opponents", "floats"), [(1, 13), (2, 18), (3, 23), (64, 328)])
def test_an_observation_has_8_floats_and_5_for_each_opponent(opponents, floats):
    assert layout.size(opponents) == floats
    assert layout.opponents(floats) == opponents
    assert layout.is_size(floats)


@pytest.mark.parametrize("floats", [0, 3, 8, 12, 14, 17])
def test_other_numbers_of_floats_are_not_eq_10s(floats):
    assert not layout.is_size(floats)


def test_opponents_blocks_follow_each_other_and_are_no_copy():
    seen = np.zeros((4, 23), np.float32)
    blocks = layout.opponent_blocks(seen)
    assert blocks.shape == (4, 3, 5)
    blocks[1, 2, layout.OPPONENT_DISTANCE] = 7.0
    assert seen[1, 20] == 7.0


def test_the_world_writes_what_the_names_say(one_area):
    area = one_area()
    state = area.state((-3.0, 2.0), goal=(9.0, -3.0), switch_on=True, opponents=((5.0, 2.0),))
    [seen] = world.observation(area.p, state)
    assert seen[layout.POSITION] == pytest.approx([-0.3, 0.2])
    assert seen[layout.GOAL] == pytest.approx([0.9, -0.3])
    assert seen[layout.GOAL_DISTANCE] == pytest.approx(1.3)
    assert seen[layout.SWITCH] == 1.0
    [opponent] = layout.opponent_blocks(seen)
    assert opponent[layout.OPPONENT_POSITION] == pytest.approx([0.5, 0.2])
    assert opponent[layout.OPPONENT_DISTANCE] == pytest.approx(0.8)
