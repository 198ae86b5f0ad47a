"""Pictures of any number of channels arrive as they are: as PNG files, or as numbers in both orders of their axes."""

import io
import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from mlagents_envs.rpc_utils import behavior_spec_from_proto, process_pixels, steps_from_proto
from PIL import Image

from corridor_server.protocol import columnar, wire
from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.protocol.messages import PNG, UNCOMPRESSED, UnityMessageProto
from corridor_server.protocol.visual_observations import PictureForm, channel_mapping, png_files

CHANNELS = [1, 2, 3, 4, 7]
FORMS = [PictureForm(*both) for both in itertools.product((True, False), (True, False))]
HEIGHT, WIDTH = 3, 5
SIDES = st.integers(1, 9)


def behavior(channels: int) -> Behavior:
    """Agents that see a picture between two vectors."""
    picture = Sensor.of("Camera", (HEIGHT, WIDTH, channels))
    return Behavior("Seer?team=0", (Sensor.of("Before", (2,)), picture, Sensor.of("Last", (1,))), 2)


def agents(pictures: np.ndarray) -> Agents:
    """The first ended."""
    count = len(pictures)
    ids = np.arange(count, dtype=np.int32)
    vectors = np.outer(ids, [1.0, 2.0]).astype(np.float32), ids[:, None].astype(np.float32)
    return Agents.ungrouped(
        ids, ids.astype(np.float32), ids < 1, np.zeros(count, np.bool_), (vectors[0], pictures, vectors[1])
    )


def random_bytes(channels: int) -> np.ndarray:
    return np.random.default_rng(channels).integers(0, 256, (3, HEIGHT, WIDTH, channels), np.uint8)


def message(pictures: np.ndarray, form: PictureForm | None, introduced: bool = False) -> Any:
    """The player's message (UnityMessageProto) with agents that see these."""
    described = behavior(pictures.shape[-1])
    names = {described.name} if introduced else ()
    return UnityMessageProto.FromString(wire.output([(described, agents(pictures))], b"beside", names, form))


def seen(message: Any) -> list[Any]:
    """The picture of each agent, as ObservationProto."""
    return [info.observations[1] for info in message.unity_output.rl_output.agentInfos["Seer?team=0"].value]


@given(arrays.arrays(np.uint8, st.tuples(SIDES, SIDES, st.just(3))))
def test_a_png_holds_the_picture(image):
    with Image.open(io.BytesIO(png_files(image))) as read:
        assert np.array_equal(np.array(read), image)


@pytest.mark.parametrize("channels", CHANNELS)
@given(data=st.data())
def test_mlagents_envs_has_every_byte_of_the_png_files_exactly(channels, data):
    picture = data.draw(arrays.arrays(np.uint8, st.tuples(SIDES, SIDES, st.just(channels))))
    read = process_pixels(png_files(picture), channels, channel_mapping(channels))
    assert read.shape == picture.shape
    assert np.array_equal(read, picture.astype(np.float32) / np.float32(255))


@pytest.mark.parametrize(
    ("channels", "mapping"),
    [
        (1, [0, -1, -1]),
        (2, [0, 1, -1]),
        (3, [0, 1, 2]),
        (4, [0, 1, 2, 3, -1, -1]),
        (7, [0, 1, 2, 3, 4, 5, 6, -1, -1]),
    ],
)
def test_a_file_has_three_channels_and_those_that_only_fill_the_last_one_up_are_black(channels, mapping):
    assert channel_mapping(channels) == mapping
    picture = random_bytes(channels)[0]
    files = png_files(picture).split(b"\x89PNG\r\n\x1a\n")[1:]
    assert len(files) == len(mapping) // 3
    whole = []
    for file in files:
        with Image.open(io.BytesIO(b"\x89PNG\r\n\x1a\n" + file)) as read:
            assert read.mode == "RGB"
            whole.append(np.array(read))
    of_files = np.concatenate(whole, axis=2)
    assert np.array_equal(of_files[:, :, :channels], picture)
    assert not of_files[:, :, channels:].any()


@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("introduced", [True, False])
def test_bytes_travel_as_png_with_their_channels_mapping(channels, introduced):
    pictures = random_bytes(channels)
    for picture, observation in zip(pictures, seen(message(pictures, PictureForm(), introduced)), strict=True):
        assert observation.compression_type == PNG
        assert observation.compressed_data == png_files(picture)
        assert list(observation.compressed_channel_mapping) == channel_mapping(channels)
        assert not observation.float_data.data


def test_without_a_form_pictures_travel_as_png_with_the_channels_last():
    pictures = random_bytes(3)
    assert message(pictures, None) == message(pictures, PictureForm(compressed=True, channels_first=False))


@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("introduced", [True, False])
def test_shape_and_properties_stand_in_the_clients_order_and_the_vectors_beside_are_untouched(
    channels, form, introduced
):
    pictures = random_bytes(channels)
    whole = message(pictures, form, introduced)
    for observation in seen(whole):
        first = form.channels_first
        assert list(observation.shape) == ([channels, HEIGHT, WIDTH] if first else [HEIGHT, WIDTH, channels])
        assert list(observation.dimension_properties) == ([1, 2, 2] if first else [2, 2, 1])
    rl_output = whole.unity_output.rl_output
    assert rl_output.side_channel == b"beside"
    for number, info in enumerate(rl_output.agentInfos["Seer?team=0"].value):
        assert [each.name for each in info.observations] == ["Before", "Camera", "Last"]
        assert list(info.observations[0].float_data.data) == [number, 2 * number]
        assert list(info.observations[2].float_data.data) == [number]


@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("channels_first", [True, False])
@pytest.mark.parametrize("introduced", [True, False])
def test_raw_bytes_travel_as_numbers_from_0_to_1_in_the_clients_order(channels, channels_first, introduced):
    pictures = random_bytes(channels)
    form = PictureForm(compressed=False, channels_first=channels_first)
    numbers = pictures.astype(np.float32) / np.float32(255)
    expected = numbers.transpose(0, 3, 1, 2) if channels_first else numbers
    for picture, observation in zip(expected, seen(message(pictures, form, introduced)), strict=True):
        assert observation.compression_type == UNCOMPRESSED
        assert not observation.compressed_data
        assert np.array_equal(np.array(observation.float_data.data, np.float32), picture.ravel())


@pytest.mark.parametrize("kind", [np.bool_, np.float32])
@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("introduced", [True, False])
def test_pictures_that_are_not_bytes_travel_as_the_numbers_that_they_are_whatever_was_asked_for(
    kind, channels, form, introduced
):
    """Only whole bytes fit into a PNG file."""
    pictures = (random_bytes(channels) > 99) if kind is np.bool_ else random_bytes(channels).astype(np.float32) - 100
    assert pictures.dtype == kind
    expected = pictures.transpose(0, 3, 1, 2) if form.channels_first else pictures
    for picture, observation in zip(expected, seen(message(pictures, form, introduced)), strict=True):
        assert observation.compression_type == UNCOMPRESSED
        assert not observation.compressed_data
        assert np.array_equal(np.array(observation.float_data.data), picture.ravel().astype(np.float64))


@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("compressed", [True, False])
def test_mlagents_envs_reads_the_pictures_that_were_written_either_way(channels, compressed):
    pictures = random_bytes(channels)
    form = PictureForm(compressed=compressed)
    first, later = message(pictures, form), message(pictures, form, introduced=True)
    assert later.unity_output.rl_output == first.unity_output.rl_output
    infos = later.unity_output.rl_output.agentInfos["Seer?team=0"].value
    [brain] = first.unity_output.rl_initialization_output.brain_parameters
    spec = behavior_spec_from_proto(brain, infos[0])
    assert spec.observation_specs[1].shape == (HEIGHT, WIDTH, channels)
    decision, terminal = steps_from_proto(infos, spec)
    expected = pictures.astype(np.float32) / np.float32(255)
    assert np.array_equal(terminal.obs[1], expected[:1])
    assert np.array_equal(decision.obs[1], expected[1:])


def test_raw_pictures_go_by_columns_and_are_read_by_them():
    pictures = random_bytes(3)
    described = behavior(3)
    data = wire.output([(described, agents(pictures))], b"", {described.name}, PictureForm(compressed=False))
    read = columnar.read_output(data, {described.name: AgentRows(described.sensors)})
    assert read is not None
    assert np.array_equal(read[0][described.name].observations[1], pictures.astype(np.float32) / np.float32(255))


def test_a_buffer_and_a_vector_are_described_alike_in_every_form():
    for sensor in (Sensor.of("vector", (4,)), Sensor.of("buffer", (20, 4))):
        assert all(form.sensor(sensor) == sensor for form in FORMS)
