"""Agents across episodes: ids, rewards, ends, and what a reset keeps."""

import numpy as np
import pytest
from only_behavior import BEHAVIOR, act, begin

from corridor_server.corridor import observation as layout
from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.drawing import top_view
from corridor_server.protocol.agents import Behavior, Sensor
from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform

IDLE = np.zeros((3, 2), np.float32)


def areas(count: int = 3, **config: float) -> Areas:
    return Areas(CorridorConfig(**config), 0, range(count))  # type: ignore[arg-type]


def test_an_agents_id_is_its_areas_number_over_episodes_and_resets():
    corridor = areas(max_episode_steps=4)
    for _ in range(3):
        assert begin(corridor).ids.tolist() == [0, 1, 2]
        for _ in range(10):
            agents, _ = act(corridor, IDLE)
            assert agents.deciding.ids.tolist() == [0, 1, 2]
            assert agents.ended.ids.tolist() in ([], [0, 1, 2])


def test_an_area_looked_at_alone_has_the_agent_that_it_has_among_others():
    assert begin(Areas(CorridorConfig(), 0, [4])).ids.tolist() == [4]


def test_an_episodes_end_and_the_next_ones_beginning_come_in_one_batch():
    corridor = areas(max_episode_steps=1)
    begin(corridor)
    agents, _ = act(corridor, IDLE)
    assert agents.done.tolist() == [True] * 3 + [False] * 3
    assert agents.ids.tolist() == [0, 1, 2] * 2
    assert agents.ended.interrupted.all()
    assert not agents.deciding.interrupted.any()
    assert (agents.deciding.rewards == 0).all()
    assert np.allclose(agents.ended.rewards, -0.001)
    assert not np.array_equal(agents.ended.observations[0], agents.deciding.observations[0])


def test_only_where_one_ended_an_episode_begins_and_every_area_keeps_its_place():
    corridor = areas(max_episode_steps=4)
    begin(corridor)
    act(corridor, IDLE)
    last, _ = act(corridor, IDLE)
    corridor.state.episode_steps[1] = 3
    agents, _ = act(corridor, IDLE)
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
    begin(corridor)
    assert act(corridor, IDLE)[1] == {}
    _, statistics = act(corridor, IDLE)
    assert list(statistics["Corridor/Episode Length"]) == [2, 2, 2]
    assert list(statistics["Corridor/Success"]) == [0, 0, 0]


def test_a_reset_in_mid_episode_begins_new_episodes():
    corridor = areas()
    first = begin(corridor)
    act(corridor, IDLE)
    assert not np.array_equal(begin(corridor).observations[0], first.observations[0])


def test_two_resets_begin_two_episodes():
    corridor = areas()
    assert not np.array_equal(begin(corridor).observations[0], begin(corridor).observations[0])


def test_a_reset_after_an_end_keeps_the_episode_that_already_began():
    corridor = areas(max_episode_steps=1)
    begin(corridor)
    begun = act(corridor, IDLE)[0].deciding
    assert np.array_equal(begun.observations[0], begin(corridor).observations[0])


def test_a_parameter_takes_effect_at_the_next_episode():
    corridor = areas(max_episode_steps=2)
    begin(corridor)
    corridor.set_parameter("goal_x", 5.0)
    assert act(corridor, IDLE)[0].deciding.observations[0][:, 4] == pytest.approx(0.9)
    assert act(corridor, IDLE)[0].deciding.observations[0][:, 4] == pytest.approx(0.5)


def test_a_parameter_set_after_an_end_reaches_the_next_reset():
    corridor = areas(max_episode_steps=1)
    begin(corridor)
    act(corridor, IDLE)
    corridor.set_parameter("goal_x", 5.0)
    assert begin(corridor).observations[0][:, 4] == pytest.approx(0.5)


def test_a_parameter_that_is_set_again_to_the_same_changes_nothing():
    corridor = areas(max_episode_steps=1)
    corridor.set_parameter("goal_x", 5.0)
    begin(corridor)
    begun = act(corridor, IDLE)[0].deciding
    corridor.set_parameter("goal_x", 5.0)
    assert np.array_equal(begin(corridor).observations, begun.observations)


def test_a_ranges_own_name_sets_both_its_ends():
    corridor = areas()
    corridor.set_parameter("agent_spawn_x", -3.5)
    assert begin(corridor).observations[0][:, 0] == pytest.approx(-0.35)
    corridor.set_parameter("agent_spawn_x_max", -1.0)
    assert len(set(begin(corridor).observations[0][:, 0])) == 3


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
    drawn = np.concatenate([begin(corridor).observations[0][:, 4] for _ in range(4)])
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


def test_the_only_behavior_is_the_corridors_and_describes_what_its_agents_observe():
    vector, picture = Sensor("VectorSensor_size18", (18,), (1,)), Sensor("CameraSensor", (4, 8, 3), (2, 2, 1))
    for camera, sensors in ((None, (vector,)), ((8, 4), (picture, vector))):
        corridor = Areas(CorridorConfig(num_opponents=2), 0, range(3), camera)
        assert corridor.behaviors == {BEHAVIOR: Behavior(BEHAVIOR, sensors, continuous_actions=2)}
        for agents in (begin(corridor), act(corridor, IDLE)[0]):
            assert [values.shape for values in agents.observations] == [(3, *sensor.shape) for sensor in sensors]


def test_with_a_camera_each_agent_has_its_own_areas_picture_too_the_ended_ones_as_it_was_at_the_end():
    ending, going_on = (
        Areas(CorridorConfig(max_episode_steps=steps), 0, range(3), camera=(40, 20)) for steps in (2, 1000)
    )
    for corridor in (ending, going_on):
        begin(corridor)
        act(corridor, IDLE)
    ending.state.episode_steps[:] = [1, 0, 1]
    agents, _ = act(ending, IDLE)
    last, _ = act(going_on, IDLE)
    assert agents.ended.ids.tolist() == [0, 2]
    assert agents.ended.observations[0].dtype == np.uint8
    assert np.array_equal(agents.ended.observations[0], last.observations[0][[0, 2]])
    begun = [top_view(ending.parameters.columns, ending.state, area, 40, 20) for area in range(3)]
    assert np.array_equal(agents.deciding.observations[0], begun)
    assert len({picture.tobytes() for picture in agents.observations[0]}) == 5


def test_a_camera_changes_nothing_else():
    with_camera, without = (
        Areas(CorridorConfig(max_episode_steps=2), 0, range(3), camera) for camera in ((8, 4), None)
    )
    assert np.array_equal(begin(with_camera).observations[1], begin(without).observations[0])
    for _ in range(5):
        (seen, statistics), (expected, of_episodes) = act(with_camera, IDLE), act(without, IDLE)
        assert np.array_equal(seen.observations[1], expected.observations[0])
        assert np.array_equal(seen.rewards, expected.rewards)
        assert np.array_equal(seen.done, expected.done)
        assert statistics.keys() == of_episodes.keys()
