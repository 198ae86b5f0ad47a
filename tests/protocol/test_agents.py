"""A batch of agents falls into those that ended and those that decide, in whatever order they came."""

import numpy as np
import pytest

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior, Sensor

PICTURE = (2, 3, 1)


def agents(done: list[bool]) -> Agents:
    """Agents with two vectors and a picture; all that is an agent's own tells its number."""
    count = len(done)
    numbers = np.arange(count)
    pictures = np.broadcast_to(numbers.astype(np.uint8)[:, None, None, None], (count, *PICTURE)).copy()
    return Agents(
        ids=10 + numbers.astype(np.int32),
        rewards=numbers.astype(np.float32),
        done=np.array(done, np.bool_),
        interrupted=np.array(done, np.bool_),
        observations=(np.outer(numbers, [1, 10]).astype(np.float32), numbers[:, None].astype(np.float32), pictures),
        group_ids=100 + numbers.astype(np.int32),
        group_rewards=-numbers.astype(np.float32),
        masks=(np.eye(max(count, 1), dtype=np.bool_)[:count],),
    )


PARTS = [
    ([True, True, False], [10, 11], [12]),
    ([False, False], [], [10, 11]),
    ([True], [10], []),
    ([], [], []),
    ([False, True, False, True], [11, 13], [10, 12]),
]


@pytest.mark.parametrize(("done", "ended", "deciding"), PARTS)
def test_every_agent_is_in_one_of_both_parts_with_all_that_is_its_own(done, ended, deciding):
    batch = agents(done)
    for part, ids in ((batch.ended, ended), (batch.deciding, deciding)):
        assert part.ids.tolist() == ids
        assert len(part) == len(ids)
        assert part.rewards.tolist() == [number - 10 for number in ids]
        assert part.observations[0][:, 1].tolist() == [10 * (number - 10) for number in ids]
        assert part.observations[1][:, 0].tolist() == [number - 10 for number in ids]
        assert part.group_ids.tolist() == [number + 90 for number in ids]
        assert part.group_rewards.tolist() == [10 - number for number in ids]
        assert [np.flatnonzero(row).tolist() for row in part.masks[0]] == [[number - 10] for number in ids]
    assert batch.ended.done.all()
    assert batch.ended.interrupted.all()
    assert not batch.deciding.done.any()


@pytest.mark.parametrize(("done", "ended", "deciding"), PARTS)
def test_a_picture_is_an_observation_as_any_other_and_its_bytes_stay_bytes(done, ended, deciding):
    batch = agents(done)
    for part, ids in ((batch.ended, ended), (batch.deciding, deciding)):
        pictures = part.observations[2]
        assert pictures.dtype == np.uint8
        assert pictures.shape == (len(ids), *PICTURE)
        assert [np.unique(picture).tolist() for picture in pictures] == [[number - 10] for number in ids]


def test_an_agent_on_its_own_has_no_group_no_group_reward_and_no_mask():
    batch = agents([True, False])
    alone = Agents.ungrouped(batch.ids, batch.rewards, batch.done, batch.interrupted, batch.observations)
    assert alone.group_ids.tolist() == [0, 0]
    assert alone.group_rewards.tolist() == [0.0, 0.0]
    assert alone.masks == ()


def test_an_agent_on_its_own_may_have_a_mask():
    batch = agents([True, False])
    alone = Agents.ungrouped(batch.ids, batch.rewards, batch.done, batch.interrupted, batch.observations, batch.masks)
    assert alone.masks is batch.masks


def test_parts_of_a_batch_in_a_messages_order_are_no_copies():
    batch = agents([True, False, False])
    batch.deciding.rewards[0] = 7.0
    batch.ended.observations[0][0] = 5.0
    batch.deciding.observations[2][1] = 9
    assert batch.rewards.tolist() == [0.0, 7.0, 2.0]
    assert batch.observations[0][0].tolist() == [5.0, 5.0]
    assert batch.observations[2][:, 0, 0, 0].tolist() == [0, 1, 9]


def test_a_sensors_shape_says_whether_it_is_a_vector_a_buffer_or_a_picture():
    """1 is a dimension without a property, 2 one along which a picture may be moved, 4 one of variable size."""
    assert Sensor.of("vector", (5,)) == Sensor("vector", (5,), (1,), 0)
    assert Sensor.of("buffer", (20, 4)) == Sensor("buffer", (20, 4), (4, 1), 0)
    assert Sensor.of("picture", (84, 84, 3)) == Sensor("picture", (84, 84, 3), (2, 2, 1), 0)


@pytest.mark.parametrize(("size", "branches"), [(2, ()), (0, (3, 2)), (1, (4,))])
def test_doing_nothing_is_0_in_every_number_and_the_first_choice_in_every_branch(size, branches):
    nothing = ActionBatch.zeros(3, Behavior("Any?team=0", (), size, branches))
    assert nothing.continuous.shape == (3, size)
    assert nothing.continuous.dtype == np.float32
    assert nothing.discrete.shape == (3, len(branches))
    assert nothing.discrete.dtype == np.int32
    assert not nothing.continuous.any()
    assert not nothing.discrete.any()
