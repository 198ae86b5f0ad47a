"""Columns mean what protobuf means: it reads what they write, and they read nothing that it would read otherwise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from corridor_server.protocol import columnar
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.messages import AgentInfoProto, UnityMessageProto
from corridor_server.protocol.trainer_messages import command, step

BEHAVIOR, NAME = "Corridor?team=0", "VectorSensor_size13"
FLOATS = st.floats(width=32)
IDS = st.one_of(st.integers(0, 300), st.integers(0, 2**31 - 1))


@st.composite
def agent_rows(draw: st.DrawFn) -> Agents:
    count = draw(st.integers(0, 12))
    return Agents.ungrouped(
        draw(arrays.arrays(np.int32, count, elements=IDS)),
        draw(arrays.arrays(np.float32, count, elements=FLOATS)),
        draw(arrays.arrays(np.bool_, count)),
        draw(arrays.arrays(np.bool_, count)),
        (draw(arrays.arrays(np.float32, (count, 13), elements=FLOATS)),),
    )


def parsed(data: bytes) -> Agents:
    """What protobuf makes of a message."""
    infos = UnityMessageProto.FromString(data).unity_output.rl_output.agentInfos[BEHAVIOR].value
    rows = [list(info.observations[0].float_data.data) for info in infos]
    return Agents.ungrouped(
        np.array([info.id for info in infos], np.int32),
        np.array([info.reward for info in infos], np.float32),
        np.array([info.done for info in infos], np.bool_),
        np.array([info.max_step_reached for info in infos], np.bool_),
        (np.array(rows, np.float32).reshape(len(infos), 13),),
    )


def same(one: Agents, other: Agents) -> bool:
    columns = ("ids", "rewards", "done", "interrupted")
    return all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=name == "rewards") for name in columns
    ) and np.array_equal(one.observations[0], other.observations[0], equal_nan=True)


@given(agent_rows(), st.binary(max_size=300))
def test_what_columns_write_protobuf_reads(rows, side_channel):
    data = columnar.write_output(BEHAVIOR, NAME, rows, side_channel)
    message = UnityMessageProto.FromString(data)
    assert message.header.status == 200
    assert message.unity_output.rl_output.side_channel == side_channel
    assert same(parsed(data), rows)
    for info in message.unity_output.rl_output.agentInfos[BEHAVIOR].value:
        expected = AgentInfoProto(
            id=info.id, reward=info.reward, done=info.done, max_step_reached=info.max_step_reached
        )
        observation = expected.observations.add(name=NAME, shape=[13], dimension_properties=[1])
        observation.float_data.data.extend(info.observations[0].float_data.data)
        assert info.SerializeToString() == expected.SerializeToString(), "nothing else is in it"


@given(agent_rows(), st.binary(max_size=300))
def test_what_columns_write_columns_read(rows, side_channel):
    data = columnar.write_output(BEHAVIOR, NAME, rows, side_channel)
    read = columnar.read_output(data, BEHAVIOR, NAME, 13)
    assert read is not None
    assert same(read[0], rows)
    assert read[1] == side_channel


@given(
    arrays.arrays(np.float32, st.tuples(st.integers(0, 12), st.integers(1, 4)), elements=FLOATS),
    st.binary(max_size=300),
    st.booleans(),
)
def test_steps_of_columns_and_of_protobuf_are_read_alike(actions, side_channel, deprecated_too):
    size = actions.shape[1]
    written = columnar.write_step(BEHAVIOR, actions, side_channel)
    message = UnityMessageProto.FromString(written)
    rl_input = message.unity_input.rl_input
    rows = [list(each.continuous_actions) for each in rl_input.agent_actions[BEHAVIOR].value]
    assert np.array_equal(np.array(rows, np.float32).reshape(-1, size), actions, equal_nan=True)
    assert rl_input.side_channel == side_channel
    assert rl_input.command == 0
    theirs = step({BEHAVIOR: actions.tolist()}, side_channel)
    if deprecated_too:
        for each in theirs.unity_input.rl_input.agent_actions[BEHAVIOR].value:
            each.vector_actions_deprecated.extend(each.continuous_actions)
    for data in (written, theirs.SerializeToString()):
        read = columnar.read_step(data, BEHAVIOR, size)
        if len(actions) == 0:
            continue
        assert read is not None
        assert np.array_equal(read[0], actions, equal_nan=True)
        assert read[1] == side_channel


UNUSUAL = {
    "an unknown field after the message": lambda data: data + b"\xf8\x01\x07",
    "an unknown field before it": lambda data: b"\xf8\x01\x07" + data,
    "another status": lambda data: data.replace(b"\x08\xc8\x01", b"\x08\x90\x03", 1),
    "a second header": lambda data: data + columnar.HEADER_OK,
    "a byte cut off": lambda data: data[:-1],
    "nothing": lambda data: b"",
}


@pytest.mark.parametrize("change", UNUSUAL)
def test_any_other_message_is_left_to_the_parser(change):
    rows = Agents.ungrouped(
        np.array([1, 2], np.int32),
        np.zeros(2, np.float32),
        np.zeros(2, bool),
        np.zeros(2, bool),
        (np.ones((2, 13), np.float32),),
    )
    output = columnar.write_output(BEHAVIOR, NAME, rows, b"")
    actions = columnar.write_step(BEHAVIOR, np.ones((2, 2), np.float32), b"")
    assert columnar.read_output(output, BEHAVIOR, NAME, 13) is not None
    assert columnar.read_step(actions, BEHAVIOR, 2) is not None
    assert columnar.read_output(UNUSUAL[change](output), BEHAVIOR, NAME, 13) is None
    assert columnar.read_step(UNUSUAL[change](actions), BEHAVIOR, 2) is None


def test_other_commands_behaviors_sizes_and_unpacked_floats_are_left_to_the_parser():
    actions = step({BEHAVIOR: [[0.5, 0.5]]})
    assert columnar.read_step(actions.SerializeToString(), BEHAVIOR, 2) is not None
    assert columnar.read_step(actions.SerializeToString(), BEHAVIOR, 3) is None
    assert columnar.read_step(actions.SerializeToString(), "Other?team=0", 2) is None
    assert columnar.read_step(command(1).SerializeToString(), BEHAVIOR, 2) is None
    actions.unity_input.rl_input.command = 1
    assert columnar.read_step(actions.SerializeToString(), BEHAVIOR, 2) is None
    one = np.float32(1).tobytes()
    unpacked = b"\x35" + one + b"\x35" + one  # continuous_actions, a tag for each value
    entry = columnar._field(b"\x0a", BEHAVIOR.encode()) + columnar._field(b"\x12", columnar._field(b"\x0a", unpacked))
    data = columnar.HEADER_OK + columnar._field(b"\x1a", columnar._field(b"\x0a", columnar._field(b"\x0a", entry)))
    parsed_actions = UnityMessageProto.FromString(data).unity_input.rl_input.agent_actions[BEHAVIOR].value
    assert list(parsed_actions[0].continuous_actions) == [1.0, 1.0]
    assert columnar.read_step(data, BEHAVIOR, 2) is None


@settings(max_examples=400)
@given(st.data())
def test_a_mutated_message_is_refused_or_means_what_protobuf_says(data):
    rows = data.draw(agent_rows().filter(lambda drawn: len(drawn.ids) > 0))
    message = bytearray(columnar.write_output(BEHAVIOR, NAME, rows, b"abc"))
    for _ in range(data.draw(st.integers(1, 3))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    read = columnar.read_output(bytes(message), BEHAVIOR, NAME, 13)
    if read is not None:
        assert same(read[0], parsed(bytes(message)))
        assert read[1] == UnityMessageProto.FromString(bytes(message)).unity_output.rl_output.side_channel
