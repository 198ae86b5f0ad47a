"""A player's areas written down and taken up again: what follows is the same, bit for bit."""

import numpy as np
import pytest
from only_behavior import act, begin

from corridor_server.corridor import observation as layout
from corridor_server.corridor.areas import Areas, Statistics
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol import side_channels
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.samplers import Gaussian, Uniform

CONFIG = CorridorConfig(num_opponents=2)


def actions(generator: np.random.Generator, count: int) -> np.ndarray:
    return generator.uniform(-1, 1, (count, 2)).astype(np.float32)


def equal(one: Agents, other: Agents) -> bool:
    return all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("ids", "rewards", "done", "interrupted")
    ) and np.array_equal(one.observations[0], other.observations[0])


def equal_steps(one: tuple[Agents, Statistics], other: tuple[Agents, Statistics]) -> bool:
    return (
        equal(one[0], other[0])
        and one[1].keys() == other[1].keys()
        and all(np.array_equal(one[1][name], other[1][name]) for name in one[1])
    )


def saved(areas: Areas) -> bytes:
    [(_, payload)] = side_channels.split(side_channels.write_state(areas.snapshot()))
    return payload


def sampled(seed: int, count: int = 5) -> Areas:
    areas = Areas(CONFIG, seed, range(count))
    areas.set_parameter("opponent_speed", Uniform(3, 0.5, 2.0))
    areas.set_parameter("goal_z", Gaussian(4, 0.0, 1.0))
    areas.set_parameter("max_episode_steps", 30.0)
    return areas


def test_restored_areas_go_on_as_those_that_were_saved():
    areas, generator = sampled(seed=1), np.random.default_rng(0)
    begin(areas)
    for _ in range(100):
        last, _ = act(areas, actions(generator, 5))
    payload = saved(areas)

    restored = sampled(seed=99)
    restored.restore(side_channels.read_state(payload, restored.snapshot()))
    shown = begin(restored)
    assert np.array_equal(shown.ids, last.deciding.ids)
    assert np.array_equal(shown.observations[0], last.deciding.observations[0])
    assert equal(begin(restored), shown)  # resets keep what has not moved
    ended = 0
    for _ in range(200):
        chosen = actions(generator, 5)
        one, other = act(areas, chosen), act(restored, chosen)
        assert equal_steps(one, other)
        ended += len(one[0].ended)
    assert ended > 20
    assert saved(areas) == saved(restored)


def test_a_snapshot_changes_nothing():
    watched, alone = sampled(seed=1), sampled(seed=1)
    begin(watched)
    begin(alone)
    generator = np.random.default_rng(0)
    for _ in range(100):
        chosen = actions(generator, 5)
        watched.snapshot()
        assert equal_steps(act(watched, chosen), act(alone, chosen))


def test_after_a_restored_episode_has_moved_a_reset_begins_another():
    areas, restored = sampled(seed=1), sampled(seed=2)
    begin(areas)
    restored.restore(side_channels.read_state(saved(areas), restored.snapshot()))
    first = begin(restored)
    act(restored, np.zeros((5, 2), np.float32))
    assert not np.intersect1d(begin(restored).observations[0][:, layout.POSITION], first.observations[0]).size


def test_a_state_from_when_every_episode_had_its_own_id_is_taken_up_without_its_ids():
    areas, restored = sampled(seed=1), sampled(seed=2)
    begun = begin(areas)
    rows = areas.snapshot()
    rows["id"] = [71, 68, 70, 72, 69]
    [(_, payload)] = side_channels.split(side_channels.write_state(rows))
    restored.restore(side_channels.read_state(payload, restored.snapshot()))
    assert equal(begin(restored), begun)
    assert saved(restored) == saved(areas)


@pytest.mark.parametrize("other", [sampled(1, count=6), Areas(CONFIG, 1, range(5)), Areas(CorridorConfig(), 1, [0])])
def test_the_state_of_other_areas_is_refused(other):
    with pytest.raises(side_channels.SideChannelError, match="saved with other settings or by another version"):
        side_channels.read_state(saved(sampled(1)), other.snapshot())


def test_a_state_with_numbers_that_are_not_finite_is_refused():
    areas = sampled(1)
    begin(areas)
    rows = areas.snapshot()
    rows["position"][2] = np.nan
    [(_, payload)] = side_channels.split(side_channels.write_state(rows))
    with pytest.raises(side_channels.SideChannelError, match="'position' that is NaN or infinite"):
        side_channels.read_state(payload, areas.snapshot())
