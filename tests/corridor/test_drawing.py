"""The top view shows what is where, in the paper's colours."""

import gymnasium
import numpy as np

from corridor_server.corridor.colours import FLOOR, LEARNER, OPPONENT, SWITCH_OFF, SWITCH_ON
from corridor_server.corridor.drawing import top_view


def pixel(picture, x: float, z: float) -> tuple[int, ...]:
    """The colour at a place in metres: the picture is 480 pixels for 21.2 m, x to the right, z upwards."""
    scale = 480 / 21.2
    return tuple(int(part) for part in picture[int(132 - z * scale), int(240 + x * scale)])


def test_agents_targets_and_switch_stand_where_they_are(one_area):
    area = one_area()
    state = area.state((-3.0, 2.0), goal=(9.0, -2.0), opponents=((5.0, -3.0),), opponent_targets=((-9.0, 1.0),))
    picture = top_view(area.p, state, 0)
    assert picture.shape == (264, 480, 3)
    assert pixel(picture, -3.0, 2.0) == LEARNER
    assert pixel(picture, 5.0, -3.0) == OPPONENT
    assert pixel(picture, 0.0, 3.0) == SWITCH_OFF
    for target, colour in (((9.0, -2.0), LEARNER), ((-9.0, 1.0), OPPONENT)):
        mixed = np.array(pixel(picture, *target), int)
        assert np.abs(mixed - colour).sum() < np.abs(np.array(FLOOR) - colour).sum()


def test_the_switch_changes_colour_when_it_is_on(one_area):
    area = one_area()
    assert pixel(top_view(area.p, area.state(switch_on=True), 0), 0.0, 3.0) == SWITCH_ON


def test_any_size_keeps_the_proportions(one_area):
    area = one_area()
    picture = top_view(area.p, area.state((0.0, 0.0)), 0, width=84, height=84)
    assert picture.shape == (84, 84, 3)
    assert tuple(picture[42, 42]) == LEARNER
    assert tuple(picture[2, 42]) == (255, 255, 255)


def test_the_environment_renders_where_it_is_asked_to():
    env = gymnasium.make("corridor_server:Corridor-v0", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (264, 480, 3)
    assert gymnasium.make("corridor_server:Corridor-v0").render_mode is None


def test_the_picture_after_an_end_is_the_ended_episodes():
    env = gymnasium.make("corridor_server:Corridor-v0", render_mode="rgb_array", max_episode_steps=1)
    env.reset(seed=0)
    before = env.render()
    env.step(np.zeros(2, np.float32))
    assert np.abs(env.render().astype(int) - before).mean() < 1.0
