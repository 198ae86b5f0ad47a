"""The codec: round trips for anything, refusal of everything else, and one whole conversation that must not change."""

import base64
import io
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from mlagents_envs.rpc_utils import behavior_spec_from_proto, steps_from_proto
from PIL import Image

from corridor_server.protocol import side_channels, wire
from corridor_server.protocol.agents import Agents, Behavior
from corridor_server.protocol.messages import STEP, UnityMessageProto
from corridor_server.protocol.trainer_messages import step
from trainer.conformance.channels import environment_parameter

sys.path.insert(0, str(Path(__file__).parents[1] / "golden"))
from record import RECORD, converse, replies

FLOATS = st.floats(-(2.0**99), 2.0**99, width=32)
IDS = st.integers(0, 2**31 - 1)


BEHAVIOR = Behavior("Corridor?team=0", 2, ("VectorSensor_size13",))


@st.composite
def batches(draw: st.DrawFn) -> Agents:
    count = draw(st.integers(1, 12))
    ended = draw(st.integers(0, count))
    interrupted = draw(arrays.arrays(np.bool_, ended))
    return Agents.ungrouped(
        draw(arrays.arrays(np.int32, count, elements=IDS)),
        draw(arrays.arrays(np.float32, count, elements=FLOATS)),
        np.arange(count) < ended,
        np.concatenate([interrupted, np.zeros(count - ended, np.bool_)]),
        (draw(arrays.arrays(np.float32, (count, 13), elements=FLOATS)),),
    )


@given(batches())
def test_mlagents_envs_reads_the_batch_that_was_written(batch):
    """By the parser as the first message, and by columns as every later one."""
    introduction = UnityMessageProto.FromString(wire.output(BEHAVIOR, batch, b"", introduce=True)).unity_output
    later = UnityMessageProto.FromString(wire.output(BEHAVIOR, batch, b"", introduce=False)).unity_output
    assert later.rl_output == introduction.rl_output
    infos = later.rl_output.agentInfos[BEHAVIOR.name].value
    spec = behavior_spec_from_proto(introduction.rl_initialization_output.brain_parameters[0], infos[0])
    assert spec.action_spec.continuous_size == BEHAVIOR.continuous_actions
    assert [observation.name for observation in spec.observation_specs] == [*BEHAVIOR.sensors]
    decision, terminal = steps_from_proto(infos, spec)
    for read, written in ((decision, batch.deciding), (terminal, batch.ended)):
        assert np.array_equal(read.agent_id, written.ids)
        assert np.array_equal(read.reward, written.rewards)
        assert np.array_equal(read.obs[0], written.observations[0])
    assert np.array_equal(terminal.interrupted, batch.ended.interrupted)


@pytest.mark.parametrize("hybrid_actions", [True, False])
def test_only_a_trainer_without_hybrid_actions_gets_the_deprecated_fields(hybrid_actions):
    none = np.zeros(1, np.bool_)
    seen = (np.zeros((1, 13), np.float32),)
    batch = Agents.ungrouped(np.zeros(1, np.int32), np.zeros(1, np.float32), none, none, seen)
    message = UnityMessageProto.FromString(wire.output(BEHAVIOR, batch, b"", True, None, hybrid_actions))
    [brain] = message.unity_output.rl_initialization_output.brain_parameters
    assert brain.action_spec.num_continuous_actions == 2
    assert list(brain.vector_action_size_deprecated) == ([] if hybrid_actions else [2])
    assert brain.vector_action_space_type_deprecated == (0 if hybrid_actions else wire.CONTINUOUS)


def test_the_player_says_what_unitys_says():
    said = UnityMessageProto.FromString(wire.hello("3.0.0")).unity_output.rl_initialization_output
    assert (said.name, said.communication_version, said.package_version) == ("AcademySingleton", "1.5.0", "3.0.0")
    capabilities = said.capabilities
    assert [getattr(capabilities, name) for name in capabilities.DESCRIPTOR.fields_by_name] == [True] * 7


@given(
    arrays.arrays(np.float32, st.tuples(st.integers(1, 8), st.just(2)), elements=st.floats(-10, 10, width=32)),
    st.booleans(),
)
def test_actions_are_read_as_they_were_sent(actions, deprecated):
    message = step({BEHAVIOR.name: actions.tolist()}, deprecated=deprecated)
    read = wire.command(message.SerializeToString(), BEHAVIOR, len(actions))
    assert read.number == STEP
    assert np.array_equal(read.actions, actions)


@given(arrays.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3))))
def test_a_png_holds_the_picture(image):
    with Image.open(io.BytesIO(wire.png(image))) as read:
        assert np.array_equal(np.array(read), image)


@given(batches(), st.binary(max_size=30))
def test_side_channel_bytes_travel_beside_the_agents(batch, buffer):
    data = wire.output(BEHAVIOR, batch, buffer, introduce=False)
    assert UnityMessageProto.FromString(data).unity_output.rl_output.side_channel == buffer


@given(st.binary(max_size=300))
@settings(max_examples=300)
def test_any_bytes_are_a_message_or_refused(data):
    read(data)


def read(data: bytes) -> str:
    """All that the player reads of a reply; returns what came of it."""
    try:
        command = wire.command(data, BEHAVIOR, 2)
        for channel, payload in side_channels.split(command.side_channel):
            if channel == side_channels.ENVIRONMENT_PARAMETERS:
                side_channels.read_environment_parameter(payload)
            elif channel == side_channels.ENGINE_CONFIGURATION:
                side_channels.read_engine_setting(payload)
    except (wire.WireError, side_channels.SideChannelError) as error:
        return type(error).__name__
    return "read"


@pytest.mark.slow
def test_a_hundred_thousand_mutated_messages_neither_crash_nor_grow():
    whole = step(
        {BEHAVIOR.name: [[0.5, -0.5], [1.0, 0.25]]},
        environment_parameter("goal_x", 3.0)
        + side_channels.message(side_channels.ENGINE_CONFIGURATION, b"\2\0\0\0\0\0\0\0"),
    ).SerializeToString()
    assert read(whole) == "read"
    rng = np.random.default_rng(0)
    outcomes: dict[str, int] = {}
    for number in range(100_000):
        if number == 90_000:  # tracing is slow, and growth would show in what is left
            tracemalloc.start()
        data = bytearray(whole)
        for _ in range(rng.integers(1, 4)):
            place = int(rng.integers(len(data)))
            match rng.integers(4):
                case 0:
                    data[place] = int(rng.integers(256))
                case 1:
                    data[place] ^= 1 << int(rng.integers(8))
                case 2:
                    del data[place : place + int(rng.integers(1, 9))]
                case 3:
                    data[place:place] = rng.bytes(int(rng.integers(1, 9)))
            if not data:
                break
        outcome = read(bytes(data))
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert set(outcomes) == {"read", "WireError", "SideChannelError"}
    assert peak < 4 * 2**20


def test_a_recorded_conversation_is_repeated_to_the_byte():
    """After a wanted change: python tests/golden/record.py, and read what changed."""
    recorded = [line.split() for line in RECORD.read_text().splitlines()]
    heard: list[list[str]] = []
    converse(replies(), lambda who, data: heard.append([who, base64.b64encode(data).decode()]))
    for number, (then, now) in enumerate(zip(recorded, heard, strict=True)):
        assert then == now, f"message {number}, from the {then[0]}"
    assert any(info.done for info in _infos(recorded))
    assert {info.max_step_reached for info in _infos(recorded) if info.done} == {False, True}


def _infos(conversation: list[list[str]]) -> list[object]:
    messages = [UnityMessageProto.FromString(base64.b64decode(data)) for who, data in conversation if who == "player"]
    return [info for each in messages for info in each.unity_output.rl_output.agentInfos[BEHAVIOR.name].value]
