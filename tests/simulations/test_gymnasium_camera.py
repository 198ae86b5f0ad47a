"""The picture of a Gymnasium environment as an observation: its size, its colours, and what is beside it."""

import numpy as np
import pytest
from gymnasium import spaces
from simulations.counting import VECTOR, Count, only

from corridor_server.simulations.simulation import SimulationError


def test_the_camera_adds_a_picture_scaled_to_its_size(play_gymnasium):
    class Halves(Count):
        def render(self):
            picture = np.zeros((40, 60, 3), np.uint8)
            picture[:20] = 255, 0, 0
            picture[20:, 30:] = 0, 0, 100
            return picture

    simulation = play_gymnasium(Halves, camera=(2, 2))
    sensors = {sensor.name: at for at, sensor in enumerate(simulation._behavior.sensors)}
    assert sensors.keys() == {"CameraSensor", "observation"}
    picture = only(simulation.reset()).observations[sensors["CameraSensor"]]
    assert picture.dtype == np.uint8
    assert picture[0].tolist() == [[[255, 0, 0], [255, 0, 0]], [[0, 0, 0], [0, 0, 100]]]
    assert only(simulation.reset()).observations[sensors["observation"]].shape == (2, 3)


@pytest.mark.parametrize("size", [(1, 1), (7, 3), (60, 40), (64, 128)])
def test_a_picture_of_one_colour_keeps_it_at_any_size(size, play_gymnasium):
    picture = only(play_gymnasium(camera=size).reset()).observations[0]
    assert picture.shape == (2, size[1], size[0], 3)
    assert (picture == 200).all()


def test_a_pixel_is_the_mean_of_those_that_it_covers(play_gymnasium):
    class Ramp(Count):
        def render(self):
            return np.arange(8, dtype=np.uint8).reshape(2, 4, 1) * np.ones(3, np.uint8) * 10

    assert only(play_gymnasium(Ramp, camera=(2, 1)).reset()).observations[0][0, 0, :, 0].tolist() == [25, 45]


def test_the_camera_is_beside_the_parts_of_a_dict(play_gymnasium):
    class Parts(Count):
        observation_space = spaces.Dict({"a": VECTOR, "action_mask": spaces.MultiBinary(3)})

        def reset(self, **options):
            return {"a": super().reset(**options)[0], "action_mask": np.array([1, 0, 1], np.int8)}, {}

    agents = only(play_gymnasium(Parts, camera=(2, 2)).reset())
    assert [each.shape for each in agents.observations] == [(2, 2, 2, 3), (2, 3)]
    assert agents.masks[0].tolist() == [[False, True, False]] * 2


@pytest.mark.parametrize(
    ("picture", "shape"), [(None, r"object of shape \(\)"), (np.zeros((4, 4), np.uint8), r"uint8 of shape \(4, 4\)")]
)
def test_a_camera_of_an_environment_that_cant_render_is_refused(picture, shape, play_gymnasium):
    class Dark(Count):
        def render(self):
            return picture

    with pytest.raises(SimulationError, match=f"--camera: the environment renders {shape}, but uint8 of shape"):
        play_gymnasium(Dark, camera=(4, 4)).reset()


def test_the_camera_is_beside_what_wrappers_leave_to_observe(play_gymnasium):
    """Around the camera they would flatten its picture, too."""
    agents = only(play_gymnasium(wrappers=("gymnasium.wrappers:FlattenObservation",), camera=(4, 2)).reset())
    assert [each.shape for each in agents.observations] == [(2, 2, 4, 3), (2, 3)]
