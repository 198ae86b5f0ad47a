"""Side channels, against mlagents_envs' own writing and reading of them."""

import struct
import uuid

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mlagents_envs.side_channel.engine_configuration_channel import EngineConfigurationChannel
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.side_channel_manager import SideChannelManager
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from only_behavior import act, begin

from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol import side_channels
from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform
from corridor_server.protocol.side_channels import SideChannelError


def sent(channel: object) -> list[tuple[uuid.UUID, bytes]]:
    return list(side_channels.split(bytes(SideChannelManager([channel]).generate_side_channel_messages())))


def test_parameters_and_samplers_arrive_as_mlagents_envs_sends_them():
    channel = EnvironmentParametersChannel()
    channel.set_float_parameter("agent_speed", 2.5)
    channel.set_uniform_sampler_parameters("goal_x", 4.0, 6.0, 7)
    channel.set_gaussian_sampler_parameters("goal_z", 1.0, 0.5, 8)
    channel.set_multirangeuniform_sampler_parameters("spawn_z", [(0.0, 1.0), (2.0, 3.0)], 9)
    messages = sent(channel)
    assert {guid for guid, _ in messages} == {side_channels.ENVIRONMENT_PARAMETERS}
    assert [side_channels.read_environment_parameter(payload) for _, payload in messages] == [
        ("agent_speed", 2.5),
        ("goal_x", Uniform(7, 4.0, 6.0)),
        ("goal_z", Gaussian(8, 1.0, 0.5)),
        ("spawn_z", MultiRangeUniform(9, ((0.0, 1.0), (2.0, 3.0)))),
    ]


def test_engine_settings_are_read():
    channel = EngineConfigurationChannel()
    channel.set_configuration_parameters(80, 60, 1, 20.0, -1, 60)
    assert [side_channels.read_engine_setting(payload) for _, payload in sent(channel)] == [
        "resolution 80 x 60",
        "quality level 1",
        "time scale 20",
        "target frame rate -1",
        "capture frame rate 60",
    ]


def test_statistics_arrive_at_mlagents_envs_one_value_for_each_episode():
    corridor = Areas(CorridorConfig(max_episode_steps=1), 0, range(3))
    begin(corridor)
    _, statistics = act(corridor, np.zeros((3, 2), np.float32))
    channel = StatsSideChannel()
    SideChannelManager([channel]).process_side_channel_message(side_channels.write_statistics(statistics))
    received = channel.get_and_reset_stats()
    assert [value for value, _ in received["Corridor/Episode Length"]] == [1, 1, 1]
    closest = [value for value, _ in received["Corridor/Closest Approach"]]
    assert closest == pytest.approx(list(statistics["Corridor/Closest Approach"]))


FLOATS = st.floats(-1e6, 1e6).map(lambda value: struct.unpack("<f", struct.pack("<f", value))[0])
SEEDS = st.integers(-(2**31), 2**31 - 1)


@given(st.text(st.characters(codec="ascii"), max_size=30), FLOATS)
def test_any_parameter_is_read_as_mlagents_envs_writes_it(name, value):
    channel = EnvironmentParametersChannel()
    channel.set_float_parameter(name, value)
    assert [side_channels.read_environment_parameter(payload) for _, payload in sent(channel)] == [(name, value)]


@given(SEEDS, FLOATS, FLOATS, st.lists(st.tuples(FLOATS, FLOATS), min_size=1, max_size=5))
def test_any_sampler_is_read_as_mlagents_envs_writes_it(seed, low, high, ranges):
    channel = EnvironmentParametersChannel()
    channel.set_uniform_sampler_parameters("a", low, high, seed)
    channel.set_gaussian_sampler_parameters("a", low, high, seed)
    channel.set_multirangeuniform_sampler_parameters("a", ranges, seed)
    assert [side_channels.read_environment_parameter(payload)[1] for _, payload in sent(channel)] == [
        Uniform(seed, low, high),
        Gaussian(seed, low, high),
        MultiRangeUniform(seed, tuple(ranges)),
    ]


@given(st.lists(st.tuples(st.uuids(), st.binary(max_size=40)), max_size=5))
def test_what_is_put_together_is_split_again(messages):
    buffer = b"".join(side_channels.message(guid, payload) for guid, payload in messages)
    assert list(side_channels.split(buffer)) == messages


@given(st.binary(max_size=200))
def test_any_bytes_are_split_or_refused(buffer):
    try:
        parts = list(side_channels.split(buffer))
    except SideChannelError:
        return
    assert sum(20 + len(payload) for _, payload in parts) == len(buffer)


@given(st.binary(max_size=60))
def test_any_payload_is_a_parameter_or_refused(payload):
    try:
        name, _ = side_channels.read_environment_parameter(payload)
    except SideChannelError:
        return
    assert isinstance(name, str)


def test_a_buffer_that_is_cut_names_the_channel():
    buffer = side_channels.message(side_channels.ENVIRONMENT_PARAMETERS, b"12345678")[:-3]
    with pytest.raises(
        SideChannelError, match="534c891e-810f-11ea-a9d0-822485860400 announces 8 bytes, but 5 are left"
    ):
        list(side_channels.split(buffer))


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"", "has 0 bytes; at least 4"),
        (struct.pack("<i", -1), "announces -1 items"),
        (struct.pack("<i1si", 1, b"a", 7), "has type 7"),
        (struct.pack("<i1siii", 1, b"a", 1, 0, 9), "has sampler 9"),
        (struct.pack("<i1siiii", 1, b"a", 1, 0, 2, 2**30), "announces 1073741824 items"),
        (struct.pack("<i1siiiif", 1, b"a", 1, 0, 2, 1, 1.0), "has 1 range ends"),
        (struct.pack("<i1si", 1, b"\xff", 0), "not UTF-8"),
    ],
)
def test_a_broken_parameter_says_what_was_expected(payload, says):
    with pytest.raises(SideChannelError) as error:
        side_channels.read_environment_parameter(payload)
    assert says in str(error.value)
