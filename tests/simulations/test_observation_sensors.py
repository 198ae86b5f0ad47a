"""Which sensors an observation space becomes, and what stands in them."""

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector.utils import concatenate, create_empty_array

from corridor_server.protocol.agents import Sensor
from corridor_server.simulations import observation_sensors
from corridor_server.simulations.finite_numbers import check_finite
from corridor_server.simulations.observation_sensors import ObservationSensors
from corridor_server.simulations.simulation import SimulationError


def batched(space, *observations):
    return concatenate(space, observations, create_empty_array(space, len(observations)))


def read(space, *observations):
    return ObservationSensors(space, "It").read(
        batched(space, *observations), np.arange(len(observations), dtype=np.int32)
    )


def refusal(space):
    with pytest.raises(SimulationError) as caught:
        ObservationSensors(space, "Env-v0")
    return str(caught.value)


@pytest.mark.parametrize(
    ("shape", "sensor"),
    [
        ((), Sensor.of("observation", (1,))),
        ((4,), Sensor.of("observation", (4,))),
        ((5, 2), Sensor.of("observation", (5, 2))),
        ((8, 9, 4), Sensor.of("observation", (8, 9, 4))),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int8, np.uint8, np.int64, np.bool_])
def test_a_box_is_one_sensor_with_its_numbers_whatever_their_type(shape, sensor, dtype):
    space = spaces.Box(0, 1, shape, dtype)
    assert ObservationSensors(space, "It").sensors == (sensor,)
    observations = [space.sample() for _ in range(3)]
    [values] = read(space, *observations)
    assert values.dtype == np.float32
    assert np.array_equal(values, np.array(observations, np.float32).reshape(3, *sensor.shape))


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 9])
def test_a_picture_of_bytes_stays_bytes_with_any_number_of_channels(channels):
    space = spaces.Box(0, 255, (6, 7, channels), np.uint8)
    pictures = [space.sample(), space.sample()]
    [values] = read(space, *pictures)
    assert values.dtype == np.uint8
    assert np.array_equal(values, pictures)


def test_bytes_that_are_not_0_to_255_are_numbers_as_they_are():
    """MiniGrid's (7, 7, 3) holds kinds and colours, which are no shades."""
    space = spaces.Box(0, 10, (7, 7, 3), np.uint8)
    [values] = read(space, np.full((7, 7, 3), 10, np.uint8))
    assert values.dtype == np.float32
    assert (values == 10).all()


def test_a_grey_picture_of_rank_2_is_a_buffer():
    assert ObservationSensors(spaces.Box(0, 255, (6, 7), np.uint8), "It").sensors[0].shape == (6, 7)


@pytest.mark.parametrize("start", [0, 3, -2])
def test_a_discrete_observation_is_one_hot_from_its_start(start):
    space = spaces.Discrete(4, start=start)
    [values] = read(space, start, start + 3)
    assert values.tolist() == [[1, 0, 0, 0], [0, 0, 0, 1]]


def test_several_discrete_observations_are_one_hot_side_by_side():
    space = spaces.MultiDiscrete([2, 3], start=[5, -1])
    assert read(space, np.array([6, -1]))[0].tolist() == [[0, 1, 1, 0, 0]]
    grid = spaces.MultiDiscrete([[2, 2], [2, 2]])
    assert read(grid, np.array([[0, 1], [1, 0]]))[0].tolist() == [[1, 0, 0, 1, 0, 1, 1, 0]]


@pytest.mark.parametrize(
    ("space", "given", "said"),
    [
        (spaces.Discrete(3, start=1), 0, "observation = 0, but 1 to 3 were expected"),
        (spaces.Discrete(3, start=1), 4, "observation = 4, but 1 to 3 were expected"),
        (spaces.MultiDiscrete([2, 3]), np.array([2, 0]), "observation = 2, but 0 to 1 were expected"),
        (spaces.Dict({"a": spaces.Discrete(2)}), {"a": -1}, "a = -1, but 0 to 1 were expected"),
    ],
)
def test_a_choice_that_is_none_of_the_space_is_refused_and_never_anothers(space, given, said):
    with pytest.raises(SimulationError, match=said):
        read(space, given)


def test_flags_are_numbers():
    assert read(spaces.MultiBinary(3), np.array([1, 0, 1]))[0].tolist() == [[1, 0, 1]]
    assert read(spaces.MultiBinary((2, 2)), np.array([[1, 0], [0, 1]]))[0].tolist() == [[1, 0, 0, 1]]


def test_each_part_of_a_dict_or_tuple_is_a_sensor_named_after_its_way():
    space = spaces.Dict(
        {
            "eye": spaces.Box(0, 255, (2, 2, 3), np.uint8),
            "body": spaces.Tuple([spaces.Box(-1, 1, (2,)), spaces.Dict({"mode": spaces.Discrete(2)})]),
        }
    )
    found = ObservationSensors(space, "It")
    shapes = {sensor.name: sensor.shape for sensor in found.sensors}
    assert shapes == {"body/0": (2,), "body/1/mode": (2,), "eye": (2, 2, 3)}
    seen = {
        "eye": np.full((2, 2, 3), 9, np.uint8),
        "body": (np.array([0.5, -0.5], np.float32), {"mode": 1}),
    }
    values = dict(zip(shapes, found.read(batched(space, seen), np.zeros(1, np.int32)), strict=True))
    assert values["body/0"].tolist() == [[0.5, -0.5]]
    assert values["body/1/mode"].tolist() == [[0, 1]]
    assert (values["eye"] == 9).all()


def test_a_dicts_action_mask_is_no_sensor_but_says_what_is_allowed():
    space = spaces.Dict({"action_mask": spaces.MultiBinary(3), "seen": spaces.Box(0, 1, (2,))})
    found = ObservationSensors(space, "It")
    assert [sensor.name for sensor in found.sensors] == ["seen"]
    batch = batched(space, {"action_mask": np.array([0, 1, 1], np.int8), "seen": np.zeros(2, np.float32)})
    assert found.mask(batch).tolist() == [[0, 1, 1]]
    assert ObservationSensors(spaces.Discrete(2), "It").mask(np.array([1])) is None


@pytest.mark.parametrize("kind", [tuple, dict])
def test_a_mask_may_be_one_for_each_branch(kind):
    branches = [spaces.MultiBinary(2), spaces.MultiBinary(3)]
    given = [np.array([0, 1], np.int8), np.array([1, 1, 0], np.int8)]
    named = {"a": branches[0], "b": branches[1]}
    of_branches = spaces.Tuple(branches) if kind is tuple else spaces.Dict(named)
    told = tuple(given) if kind is tuple else dict(zip(named, given, strict=True))
    space = spaces.Dict({"action_mask": of_branches, "seen": spaces.Box(0, 1, (2,))})
    found = ObservationSensors(space, "It")
    assert [sensor.name for sensor in found.sensors] == ["seen"]
    batch = batched(space, {"action_mask": told, "seen": np.zeros(2, np.float32)})
    assert found.mask(batch).tolist() == [[0, 1, 1, 1, 0]]


def test_what_is_read_is_a_copy_as_environments_go_on_writing():
    space = spaces.Box(0, 255, (1, 1, 3), np.uint8)
    for each in (space, spaces.Box(0, 1, (3,))):
        batch = batched(each, np.zeros(each.shape, each.dtype))
        [values] = ObservationSensors(each, "It").read(batch, np.arange(2, dtype=np.int32))
        batch[:] = 1
        assert (values == 0).all()


@pytest.mark.parametrize(
    "given",
    [
        [np.array([1, 2], np.float32), np.array([3, 4], np.float32)],
        [np.array([1.0, 2.0]), np.array([3, 4])],
        [[1, 2], (3.0, 4.0)],
    ],
)
def test_a_batch_has_its_spaces_type_whatever_numbers_came(given):
    batch = observation_sensors.batched(spaces.Box(0, 9, (2,)), given)
    assert (batch.tolist(), batch.dtype) == ([[1, 2], [3, 4]], np.float32)


def test_a_batch_is_no_view_of_what_came():
    one = np.zeros(2, np.float32)
    batch = observation_sensors.batched(spaces.Box(0, 9, (2,)), [one])
    one[:] = 1
    assert not batch.any()


def test_numbers_that_would_lose_their_fractions_are_refused():
    with pytest.raises(ValueError, match="observation of float64 came, but uint8 was expected"):
        observation_sensors.batched(spaces.Box(0, 255, (2,), np.uint8), [np.array([0.5, 1.5])])


def test_one_of_another_shape_is_named_though_there_are_as_many_numbers():
    two = spaces.Box(0, 9, (2,))
    with pytest.raises(ValueError, match=r"observation of shape \(1,\) came, but \(2,\) was expected"):
        observation_sensors.batched(two, [np.zeros(1, np.float32), np.zeros(3, np.float32)])


@pytest.mark.parametrize(
    ("space", "part", "why"),
    [
        (spaces.Text(5), "observation as Text", "only Box, Discrete"),
        (spaces.Sequence(spaces.Discrete(2)), "observation as Sequence", "only Box, Discrete"),
        (spaces.Graph(spaces.Box(0, 1, (2,)), None), "observation as Graph", "only Box, Discrete"),
        (spaces.OneOf([spaces.Discrete(2)]), "observation as OneOf", "only Box, Discrete"),
        (spaces.Dict({"said": spaces.Tuple([spaces.Text(5)])}), "said/0 as Text", "only Box, Discrete"),
        (spaces.Dict({"deep": spaces.Box(0, 1, (2, 2, 2, 2))}), "deep as Box", "4 dimensions, and an observation at"),
        (spaces.Box(0, 1, (0,)), "observation as Box", "it is 0 numbers, and 1 to"),
        (spaces.Discrete(2**31), "observation as Discrete", "it is 2147483648 numbers, and 1 to"),
        (spaces.MultiDiscrete([2**22, 2]), "observation as MultiDiscrete", "it is 4194306 numbers, and 1 to"),
    ],
)
def test_a_part_that_cant_be_carried_is_named_with_the_reason_and_a_way_out(space, part, why):
    said = refusal(space)
    assert said.startswith(f"Env-v0 observes {part}, which can't be carried: ")
    assert why in said
    assert said.endswith("change or leave it out with a wrapper.")


@pytest.mark.parametrize("space", [spaces.Dict({}), spaces.Tuple([]), spaces.Dict({"action_mask": spaces.Discrete(2)})])
def test_an_agent_that_observes_nothing_is_refused(space):
    assert refusal(space) == "Env-v0 observes nothing, but at least one vector or picture was expected."


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_nan_and_infinity_are_named_with_agent_and_place(bad):
    values = np.zeros((2, 2, 3), np.float32)
    check_finite(values, "x", np.array([4, 7], np.int32))
    values[1, 0, 2] = bad
    with pytest.raises(SimulationError) as caught:
        check_finite(values, "x", np.array([4, 7], np.int32))
    assert str(caught.value) == f"The environment gave agent 7 x[0, 2] = {bad}, but finite numbers were expected."
