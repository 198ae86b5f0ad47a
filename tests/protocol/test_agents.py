"""A batch of agents falls into those that ended and those that decide, in whatever order they came."""

import numpy as np
import pytest

from corridor_server.protocol.agents import Agents


def agents(done: list[bool], images: bool = False) -> Agents:
    count = len(done)
    numbers = np.arange(count)
    return Agents(
        ids=10 + numbers.astype(np.int32),
        rewards=numbers.astype(np.float32),
        done=np.array(done, np.bool_),
        interrupted=np.array(done, np.bool_),
        observations=(np.outer(numbers, [1, 10]).astype(np.float32), numbers[:, None].astype(np.float32)),
        group_ids=100 + numbers.astype(np.int32),
        group_rewards=-numbers.astype(np.float32),
        masks=(np.eye(max(count, 1), dtype=np.bool_)[:count],),
        images=numbers.astype(np.uint8).reshape(count, 1, 1, 1) if images else None,
    )


@pytest.mark.parametrize(
    ("done", "ended", "deciding"),
    [
        ([True, True, False], [10, 11], [12]),
        ([False, False], [], [10, 11]),
        ([True], [10], []),
        ([], [], []),
        ([False, True, False, True], [11, 13], [10, 12]),
    ],
)
def test_every_agent_is_in_one_of_both_parts_with_all_that_is_its_own(done, ended, deciding):
    batch = agents(done, images=True)
    for part, ids in ((batch.ended, ended), (batch.deciding, deciding)):
        assert part.ids.tolist() == ids
        assert len(part) == len(ids)
        assert part.rewards.tolist() == [number - 10 for number in ids]
        assert part.observations[0][:, 1].tolist() == [10 * (number - 10) for number in ids]
        assert part.observations[1][:, 0].tolist() == [number - 10 for number in ids]
        assert part.group_ids.tolist() == [number + 90 for number in ids]
        assert part.group_rewards.tolist() == [10 - number for number in ids]
        assert [np.flatnonzero(row).tolist() for row in part.masks[0]] == [[number - 10] for number in ids]
        assert part.images.ravel().tolist() == [number - 10 for number in ids]
    assert batch.ended.done.all()
    assert batch.ended.interrupted.all()
    assert not batch.deciding.done.any()


def test_without_a_camera_there_are_no_pictures():
    assert agents([True, False]).deciding.images is None


def test_an_agent_on_its_own_has_no_group_no_group_reward_and_no_mask():
    batch = agents([True, False])
    alone = Agents.ungrouped(batch.ids, batch.rewards, batch.done, batch.interrupted, batch.observations)
    assert alone.group_ids.tolist() == [0, 0]
    assert alone.group_rewards.tolist() == [0.0, 0.0]
    assert alone.masks == ()


def test_parts_of_a_batch_in_a_messages_order_are_no_copies():
    batch = agents([True, False, False])
    batch.deciding.rewards[0] = 7.0
    batch.ended.observations[0][0] = 5.0
    assert batch.rewards.tolist() == [0.0, 7.0, 2.0]
    assert batch.observations[0][0].tolist() == [5.0, 5.0]
