"""Agents across episodes: ids, rewards, ends, and what a reset keeps."""

import numpy as np
import pytest

from corridor_server.corridor import observation as layout
from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform

IDLE = np.zeros((3, 2), np.float32)


def areas(count: int = 3, **config: float) -> Areas:
    return Areas(CorridorConfig(**config), 0, range(count))  # type: ignore[arg-type]


def test_an_agents_id_is_its_areas_number_over_episodes_and_resets():
    corridor = areas(max_episode_steps=4)
    for _ in range(3):
        assert corridor.reset().ids.tolist() == [0, 1, 2]
        for _ in range(10):
            agents, _ = corridor.step(IDLE)
            assert agents.deciding.ids.tolist() == [0, 1, 2]
            assert agents.ended.ids.tolist() in ([], [0, 1, 2])


def test_an_area_looked_at_alone_has_the_agent_that_it_has_among_others():
    assert Areas(CorridorConfig(), 0, [4]).reset().ids.tolist() == [4]


def test_an_episodes_end_and_the_next_ones_beginning_come_in_one_batch():
    corridor = areas(max_episode_steps=1)
    corridor.reset()
    agents, _ = corridor.step(IDLE)
    assert agents.done.tolist() == [True] * 3 + [False] * 3
    assert agents.ids.tolist() == [0, 1, 2] * 2
    assert agents.ended.interrupted.all()
    assert not agents.deciding.interrupted.any()
    assert (agents.deciding.rewards == 0).all()
    assert np.allclose(agents.ended.rewards, -0.001)
    assert not np.array_equal(agents.ended.observations[0], agents.deciding.observations[0])


def test_only_where_one_ended_an_episode_begins_and_every_area_keeps_its_place():
    corridor = areas(max_episode_steps=4)
    corridor.reset()
    corridor.step(IDLE)
    last, _ = corridor.step(IDLE)
    corridor.state.episode_steps[1] = 3
    agents, _ = corridor.step(IDLE)
    assert agents.done.tolist() == [True, False, False, False]
    assert agents.ids.tolist() == [1, 0, 1, 2]
    assert agents.deciding.rewards[1] == 0.0
    assert (agents.deciding.rewards[[0, 2]] != 0.0).all()
    unmoved = layout.POSITION, layout.GOAL
    for part in unmoved:
        assert np.array_equal(agents.deciding.observations[0][[0, 2], part], last.observations[0][[0, 2], part])
        assert np.array_equal(agents.ended.observations[0][0, part], last.observations[0][1, part])


def test_statistics_come_with_every_end_and_only_then():
    corridor = areas(max_episode_steps=2)
    corridor.reset()
    assert corridor.step(IDLE)[1] == {}
    _, statistics = corridor.step(IDLE)
    assert list(statistics["Corridor/Episode Length"]) == [2, 2, 2]
    assert list(statistics["Corridor/Success"]) == [0, 0, 0]


def test_a_reset_in_mid_episode_begins_new_episodes():
    corridor = areas()
    first = corridor.reset()
    corridor.step(IDLE)
    assert not np.array_equal(corridor.reset().observations[0], first.observations[0])


def test_two_resets_begin_two_episodes():
    corridor = areas()
    assert not np.array_equal(corridor.reset().observations[0], corridor.reset().observations[0])


def test_a_reset_after_an_end_keeps_the_episode_that_already_began():
    corridor = areas(max_episode_steps=1)
    corridor.reset()
    begun = corridor.step(IDLE)[0].deciding
    assert np.array_equal(begun.observations[0], corridor.reset().observations[0])


def test_a_parameter_takes_effect_at_the_next_episode():
    corridor = areas(max_episode_steps=2)
    corridor.reset()
    corridor.set_parameter("goal_x", 5.0)
    assert corridor.step(IDLE)[0].deciding.observations[0][:, 4] == pytest.approx(0.9)
    assert corridor.step(IDLE)[0].deciding.observations[0][:, 4] == pytest.approx(0.5)


def test_a_parameter_set_after_an_end_reaches_the_next_reset():
    corridor = areas(max_episode_steps=1)
    corridor.reset()
    corridor.step(IDLE)
    corridor.set_parameter("goal_x", 5.0)
    assert corridor.reset().observations[0][:, 4] == pytest.approx(0.5)


def test_a_parameter_that_is_set_again_to_the_same_changes_nothing():
    corridor = areas(max_episode_steps=1)
    corridor.set_parameter("goal_x", 5.0)
    corridor.reset()
    begun = corridor.step(IDLE)[0].deciding
    corridor.set_parameter("goal_x", 5.0)
    assert np.array_equal(corridor.reset().observations, begun.observations)


def test_a_ranges_own_name_sets_both_its_ends():
    corridor = areas()
    corridor.set_parameter("agent_spawn_x", -3.5)
    assert corridor.reset().observations[0][:, 0] == pytest.approx(-0.35)
    corridor.set_parameter("agent_spawn_x_max", -1.0)
    assert len(set(corridor.reset().observations[0][:, 0])) == 3


@pytest.mark.parametrize(
    ("sampler", "low", "high"),
    [
        (Uniform(1, 4.0, 6.0), 0.4, 0.6),
        (Gaussian(1, 5.0, 0.1), 0.45, 0.55),
        (MultiRangeUniform(1, ((2.0, 2.5), (7.0, 7.5))), 0.2, 0.75),
    ],
)
def test_samplers_draw_anew_for_every_episode_and_area(sampler, low, high):
    corridor = areas(50)
    corridor.set_parameter("goal_x", sampler)
    drawn = np.concatenate([corridor.reset().observations[0][:, 4] for _ in range(4)])
    assert len(set(drawn)) == 200
    assert low <= drawn.min() < drawn.max() <= high
    if isinstance(sampler, MultiRangeUniform):
        inside = (drawn <= 0.25) | (drawn >= 0.7)
        assert inside.all()
        assert 40 < (drawn < 0.5).sum() < 160


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("gaol_x", 1.0, "is not an environment parameter of the corridor; the nearest is goal_x, -1000 to 1000."),
        ("num_opponents", 2.0, "'num_opponents' is not an environment parameter"),
        ("agent_speed", -1.0, "agent_speed = -1 is out of its range, 0 to 100"),
        ("agent_speed", float("nan"), "out of its range"),
        ("agent_speed", Uniform(0, 1.0, 1e9), "agent_speed = 1e+09 is out of its range"),
    ],
)
def test_what_cant_be_set_says_why(name, value, says):
    with pytest.raises(ValueError, match="range|not an environment") as error:
        areas().set_parameter(name, value)
    assert says in str(error.value)
