"""The codec: round trips for anything, refusal of everything else, and one whole conversation that must not change."""

import base64
import dataclasses
import re
import sys
import tracemalloc
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from mlagents_envs.rpc_utils import behavior_spec_from_proto, steps_from_proto

from corridor_server.protocol import side_channels, wire
from corridor_server.protocol.agents import ActionBatch, Agents, Behavior, Sensor
from corridor_server.protocol.messages import RESET, STEP, UnityMessageProto
from corridor_server.protocol.trainer_messages import command, step
from corridor_server.protocol.wire_bytes import HEADER_OK, length_delimited
from trainer.conformance.channels import environment_parameter

sys.path.insert(0, str(Path(__file__).parents[1] / "golden"))
from record import RECORD, converse, replies

FLOATS = st.floats(-(2.0**99), 2.0**99, width=32)
IDS = st.integers(0, 2**31 - 1)


BEHAVIOR = Behavior("Corridor?team=0", (Sensor.of("VectorSensor_size13", (13,)),), 2)
CHOOSER = Behavior("Chooser?team=1", (Sensor.of("Buffer", (4, 2)), Sensor("Goal", (3,), (1,), 1)), 0, (3, 200))
HYBRID = Behavior("Hybrid?team=0", (Sensor.of("VectorSensor_size1", (1,)),), 1, (2,))
BOTH = {BEHAVIOR.name: BEHAVIOR, CHOOSER.name: CHOOSER}


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


def agents(behavior: Behavior, count: int) -> Agents:
    """Agents that ask, each with numbers of its own and, where there are choices, one choice forbidden."""
    ids, none = np.arange(count, dtype=np.int32), np.zeros(count, np.bool_)
    seen = tuple(
        np.arange(1, 1 + count * int(np.prod(sensor.shape)), dtype=np.float32).reshape(count, *sensor.shape)
        for sensor in behavior.sensors
    )
    masks = tuple(np.arange(size) == np.full((count, 1), size - 1) for size in behavior.discrete_branches)
    return Agents.ungrouped(ids, ids.astype(np.float32), none, none, seen, masks)


@given(batches())
def test_mlagents_envs_reads_the_batch_that_was_written(batch):
    """By the parser as the first message, and by columns as every later one."""
    introduction = UnityMessageProto.FromString(wire.output([(BEHAVIOR, batch)], b"", introduced=())).unity_output
    later = UnityMessageProto.FromString(wire.output([(BEHAVIOR, batch)], b"", introduced={BEHAVIOR.name})).unity_output
    assert later.rl_output == introduction.rl_output
    infos = later.rl_output.agentInfos[BEHAVIOR.name].value
    spec = behavior_spec_from_proto(introduction.rl_initialization_output.brain_parameters[0], infos[0])
    assert spec.action_spec.continuous_size == BEHAVIOR.continuous_actions
    assert [(each.name, each.shape) for each in spec.observation_specs] == [each[:2] for each in BEHAVIOR.sensors]
    decision, terminal = steps_from_proto(infos, spec)
    for read, written in ((decision, batch.deciding), (terminal, batch.ended)):
        assert np.array_equal(read.agent_id, written.ids)
        assert np.array_equal(read.reward, written.rewards)
        assert np.array_equal(read.obs[0], written.observations[0])
    assert np.array_equal(terminal.interrupted, batch.ended.interrupted)


@pytest.mark.parametrize("hybrid_actions", [True, False])
def test_only_a_trainer_without_hybrid_actions_gets_the_deprecated_fields(hybrid_actions):
    brain = introduction_of(BEHAVIOR, hybrid_actions)
    assert brain.action_spec.num_continuous_actions == 2
    assert list(brain.vector_action_size_deprecated) == ([] if hybrid_actions else [2])
    assert brain.vector_action_space_type_deprecated == (0 if hybrid_actions else wire.CONTINUOUS)


@pytest.mark.parametrize("hybrid_actions", [True, False])
def test_the_deprecated_fields_of_a_discrete_behavior_are_its_branches(hybrid_actions):
    brain = introduction_of(CHOOSER, hybrid_actions)
    assert brain.action_spec.num_continuous_actions == 0
    assert brain.action_spec.num_discrete_actions == 2
    assert list(brain.action_spec.discrete_branch_sizes) == [3, 200]
    assert list(brain.vector_action_size_deprecated) == ([] if hybrid_actions else [3, 200])
    assert brain.vector_action_space_type_deprecated == wire.DISCRETE


def test_of_a_hybrid_behavior_the_deprecated_fields_have_the_continuous_actions():
    brain = introduction_of(HYBRID, hybrid_actions=False)
    assert (brain.action_spec.num_continuous_actions, [*brain.action_spec.discrete_branch_sizes]) == (1, [2])
    assert list(brain.vector_action_size_deprecated) == [1]
    assert brain.vector_action_space_type_deprecated == wire.CONTINUOUS


@pytest.mark.parametrize("behavior", [BEHAVIOR, CHOOSER])
def test_mlagents_envs_takes_the_same_from_the_deprecated_fields_alone(behavior):
    brain = introduction_of(behavior, hybrid_actions=False)
    brain.ClearField("action_spec")
    read = behavior_spec_from_proto(brain, UnityMessageProto().unity_output.rl_output.agentInfos["none"].value.add())
    assert read.action_spec.continuous_size == behavior.continuous_actions
    assert read.action_spec.discrete_branches == behavior.discrete_branches


def introduction_of(behavior: Behavior, hybrid_actions: bool) -> Any:
    """The behavior's brain parameters, to a trainer with or without hybrid actions."""
    data = wire.output([(behavior, agents(behavior, 1))], b"", (), None, hybrid_actions)
    [brain] = UnityMessageProto.FromString(data).unity_output.rl_initialization_output.brain_parameters
    assert (brain.brain_name, brain.is_training) == (behavior.name, True)
    return brain


def test_a_message_of_two_behaviors_is_the_same_by_the_parser_and_by_columns():
    parts = [(BEHAVIOR, agents(BEHAVIOR, 3)), (CHOOSER, agents(CHOOSER, 2))]
    first = UnityMessageProto.FromString(wire.output(parts, b"beside", introduced=())).unity_output
    later = UnityMessageProto.FromString(wire.output(parts, b"beside", introduced=BOTH)).unity_output
    assert later.rl_output == first.rl_output
    assert not later.HasField("rl_initialization_output")
    brains = first.rl_initialization_output.brain_parameters
    assert [brain.brain_name for brain in brains] == [*BOTH]
    for brain, (behavior, written) in zip(brains, parts, strict=True):
        infos = later.rl_output.agentInfos[behavior.name].value
        read, ended = steps_from_proto(infos, behavior_spec_from_proto(brain, infos[0]))
        assert len(ended) == 0
        assert read.agent_id.tolist() == written.ids.tolist()
        for seen, values in zip(read.obs, written.observations, strict=True):
            assert np.array_equal(seen, values)
        for mask, forbidden in zip(read.action_mask or (), written.masks, strict=True):
            assert np.array_equal(mask, forbidden)


def test_a_behavior_that_comes_later_is_introduced_alone_in_its_first_message():
    parts = [(BEHAVIOR, agents(BEHAVIOR, 1)), (CHOOSER, agents(CHOOSER, 1))]
    message = UnityMessageProto.FromString(wire.output(parts, b"", introduced={BEHAVIOR.name})).unity_output
    assert [each.brain_name for each in message.rl_initialization_output.brain_parameters] == [CHOOSER.name]
    assert {*message.rl_output.agentInfos} == {*BOTH}


def test_a_behavior_without_agents_is_in_no_message():
    message = UnityMessageProto.FromString(wire.output([(CHOOSER, agents(CHOOSER, 1))], b"", introduced=BOTH))
    assert [*message.unity_output.rl_output.agentInfos] == [CHOOSER.name]


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
    read = wire.command(message.SerializeToString(), {BEHAVIOR.name: BEHAVIOR}, {BEHAVIOR.name: len(actions)})
    assert read.number == STEP
    assert list(read.actions) == [BEHAVIOR.name]
    assert np.array_equal(read.actions[BEHAVIOR.name].continuous, actions)
    assert read.actions[BEHAVIOR.name].discrete.shape == (len(actions), 0)


def test_nobodys_actions_are_read_before_anybody_asked_and_none_of_another_command():
    actions = step({BEHAVIOR.name: [[0.5, 0.5]]}, b"beside").SerializeToString()
    assert wire.command(actions, {}, None) == wire.Command(STEP, b"beside", None)
    assert wire.command(command(RESET, b"x").SerializeToString(), BOTH, {BEHAVIOR.name: 1}) == wire.Command(RESET, b"x")


@pytest.mark.parametrize("deprecated", [True, False])
@pytest.mark.parametrize("choice", [2, 199])
def test_the_actions_of_two_behaviors_are_read_as_they_were_sent(deprecated, choice):
    """By columns; and by the parser what is old, or has a choice that takes two bytes."""
    actions, choices = {BEHAVIOR.name: [[0.5, -3.0], [0.0, 1.0]]}, {CHOOSER.name: [[2, choice]]}
    message = step(actions, b"beside", deprecated, choices)
    read = wire.command(message.SerializeToString(), BOTH, {BEHAVIOR.name: 2, CHOOSER.name: 1})
    assert (read.number, read.side_channel) == (STEP, b"beside")
    assert shown(read.actions) == {
        BEHAVIOR.name: ([[0.5, -3.0], [0.0, 1.0]], [[], []]),
        CHOOSER.name: ([[]], [[2, choice]]),
    }


@pytest.mark.parametrize("deprecated", [True, False])
def test_a_hybrid_action_has_its_numbers_and_its_choices(deprecated):
    message = step({HYBRID.name: [[0.25]]}, b"", deprecated, {HYBRID.name: [[1]]})
    read = wire.command(message.SerializeToString(), {HYBRID.name: HYBRID}, {HYBRID.name: 1})
    assert shown(read.actions) == {HYBRID.name: ([[0.25]], [[1]])}


def shown(actions: Mapping[str, ActionBatch]) -> dict[str, tuple[list[list[float]], list[list[int]]]]:
    """Each behavior's numbers and choices."""
    return {name: (batch.continuous.tolist(), batch.discrete.tolist()) for name, batch in actions.items()}


ONE, CHOICE = {BEHAVIOR.name: [[0, 0]]}, {CHOOSER.name: [[0, 0]]}


@pytest.mark.parametrize("deprecated", [True, False])  # by the parser, and by columns
@pytest.mark.parametrize(
    ("actions", "choices", "asked", "says"),
    [
        (ONE, {}, (1, 2), "sent 0 actions for behavior Chooser?team=1, but 2 agents asked for one."),
        ({}, CHOICE, (1, 1), "sent 0 actions for behavior Corridor?team=0, but 1 agents asked for one."),
        ({}, {}, (1, 0), "sent 0 actions for behavior Corridor?team=0, but 1 agents asked for one."),
        (ONE, CHOICE, (1, 0), "sent 1 actions for behavior Chooser?team=1, but 0 agents asked for one."),
        (
            {BEHAVIOR.name: [[0, 0]] * 2},
            CHOICE,
            (1, 1),
            "sent 2 actions for behavior Corridor?team=0, but 1 agents asked for one.",
        ),
        (ONE, {CHOOSER.name: [[1, 0], [3, 0]]}, (1, 2), "Action 1 chooses 3 in branch 0, but 0 to 2 were expected."),
        (ONE, {CHOOSER.name: [[0, 200]]}, (1, 1), "Action 0 chooses 200 in branch 1, but 0 to 199 were expected."),
        (ONE, {CHOOSER.name: [[-1, 0]]}, (1, 1), "Action 0 chooses -1 in branch 0, but 0 to 2 were expected."),
        (ONE, {CHOOSER.name: [[0]]}, (1, 1), "Action 0 has 1 discrete choices, but 2 were expected."),
        ({BEHAVIOR.name: [[0]]}, CHOICE, (1, 1), "Action 0 has 1 continuous values, but 2 were expected."),
        (
            {BEHAVIOR.name: [[0, 0], [float("nan"), 1]]},
            CHOICE,
            (2, 1),
            "Action 1 is [nan, 1.0], but finite numbers in [-1, 1] were expected",
        ),
    ],
)
def test_actions_of_two_behaviors_that_cant_be_used_say_what_was_expected(deprecated, actions, choices, asked, says):
    data = step(actions, b"", deprecated, choices).SerializeToString()
    with pytest.raises(wire.WireError) as error:
        wire.command(data, BOTH, dict(zip(BOTH, asked, strict=True)))
    assert says in str(error.value)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e20])
def test_a_choice_that_is_no_whole_number_of_an_old_trainer_is_refused(number):
    """The deprecated field has choices as floats."""
    message = step({CHOOSER.name: [[number, 0.0]]}, deprecated=True)
    with pytest.raises(wire.WireError, match="Action 0 chooses .* in branch 0, but 0 to 2 were expected"):
        wire.command(message.SerializeToString(), {CHOOSER.name: CHOOSER}, {CHOOSER.name: 1})


@pytest.mark.parametrize("deprecated", [True, False])
def test_the_actions_of_a_behavior_that_there_is_not_are_no_agents_concern(deprecated):
    message = step({BEHAVIOR.name: [[0.5, 0.5]], "Other?team=0": [[1.0]]}, b"", deprecated)
    read = wire.command(message.SerializeToString(), BOTH, {BEHAVIOR.name: 1})
    assert shown(read.actions) == {BEHAVIOR.name: ([[0.5, 0.5]], [[]])}


def test_of_a_behavior_that_comes_twice_the_last_actions_count_as_protobuf_has_it():
    once, again = (step({BEHAVIOR.name: [row]}) for row in ([0.5, 0.5], [0.25, 0.25]))
    entries = b"".join(each.unity_input.rl_input.SerializeToString() for each in (once, again))
    message = HEADER_OK + length_delimited(3, length_delimited(1, entries))
    assert UnityMessageProto.FromString(message) == again
    read = wire.command(message, BOTH, {BEHAVIOR.name: 1})
    assert shown(read.actions) == {BEHAVIOR.name: ([[0.25, 0.25]], [[]])}


@given(batches(), st.binary(max_size=30))
def test_side_channel_bytes_travel_beside_the_agents(batch, buffer):
    data = wire.output([(BEHAVIOR, batch)], buffer, introduced={BEHAVIOR.name})
    assert UnityMessageProto.FromString(data).unity_output.rl_output.side_channel == buffer


@given(st.binary(max_size=300))
@settings(max_examples=300)
def test_any_bytes_are_a_message_or_refused(data):
    read(data)


def read(data: bytes) -> str:
    """All that the player reads of a reply; returns what came of it."""
    try:
        read_command = wire.command(data, {BEHAVIOR.name: BEHAVIOR}, {BEHAVIOR.name: 2})
        for channel, payload in side_channels.split(read_command.side_channel):
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


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rewards": np.zeros(3, np.float32)}, "3 rewards came for 2 agents of Corridor?team=0."),
        ({"group_ids": np.zeros(1, np.int32)}, "1 group_ids came for 2 agents of"),
        ({"observations": ()}, "0 observations came for agents of Corridor?team=0, which has 1 sensors."),
        (
            {"observations": (np.zeros((2, 12), np.float32),)},
            "An observation VectorSensor_size13 of shape (2, 12) came for agents of Corridor?team=0, but (2, 13) was",
        ),
    ],
)
@pytest.mark.parametrize("introduced", [(), ("Corridor?team=0",)])
def test_a_simulations_rows_that_dont_fit_are_one_sentence(change, says, introduced):
    flags = np.zeros(2, np.bool_)
    right = Agents.ungrouped(
        np.arange(2, dtype=np.int32), np.zeros(2, np.float32), flags, flags, (np.zeros((2, 13), np.float32),)
    )
    with pytest.raises(wire.WireError, match=re.escape(says)):
        wire.output([(BEHAVIOR, dataclasses.replace(right, **change))], b"", introduced)
