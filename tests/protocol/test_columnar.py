"""Columns of agents mean what protobuf means: they write its bytes, and read nothing that it would read otherwise."""

import dataclasses
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from messages_of_agents import KINDS, ROWS, UNUSUAL, VECTOR, message_of, mutated, parsed, random_agents, same

from corridor_server.protocol import columnar
from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.messages import UnityMessageProto
from corridor_server.protocol.wire_bytes import HEADER_OK, length_delimited

BEHAVIOR = "Corridor?team=0"
SEEDS = st.integers(0, 2**32 - 1)


def two_agents() -> Agents:
    zeros = np.zeros(2, np.bool_)
    return Agents.ungrouped(
        np.array([0, 1], np.int32), np.zeros(2, np.float32), zeros, zeros, (np.ones((2, 13), np.float32),)
    )


@pytest.mark.parametrize("behavior", KINDS)
@settings(deadline=None)  # the machine may be busy
@given(seed=SEEDS, count=st.integers(0, 40), side_channel=st.binary(max_size=300))
def test_columns_write_the_bytes_that_protobuf_writes(behavior, seed, count, side_channel):
    agents = random_agents(np.random.default_rng(seed), behavior, count)
    written = columnar.write_output([(behavior, ROWS[behavior], agents)], side_channel)
    assert written == message_of({behavior: agents}, side_channel)


@pytest.mark.parametrize("behavior", KINDS)
@settings(deadline=None)  # the machine may be busy
@given(seed=SEEDS, count=st.integers(0, 40), side_channel=st.binary(max_size=300))
def test_columns_read_whatever_protobuf_writes_of_vectors_and_buffers(behavior, seed, count, side_channel):
    agents = random_agents(np.random.default_rng(seed), behavior, count)
    read = columnar.read_output(message_of({behavior: agents}, side_channel), ROWS)
    assert read is not None, "left to the parser"
    assert same(read[0][behavior], agents)
    assert read[1] == side_channel


@settings(deadline=None)  # the machine may be busy
@given(seed=SEEDS, names=st.lists(st.sampled_from(list(KINDS)), unique=True))
def test_several_behaviors_come_in_one_message(seed, names):
    rng = np.random.default_rng(seed)
    batches = {name: random_agents(rng, name, int(rng.integers(0, 20))) for name in names}
    read = columnar.read_output(message_of(batches, b"beside"), ROWS)
    assert read is not None
    assert read[0].keys() == batches.keys()
    assert all(same(read[0][name], batches[name]) for name in names)
    assert read[1] == b"beside"


@settings(deadline=None)  # the machine may be busy
@given(seed=SEEDS, names=st.lists(st.sampled_from(list(KINDS)), unique=True))
def test_several_behaviors_are_written_as_protobuf_writes_them_in_whichever_order_they_are_given(seed, names):
    rng = np.random.default_rng(seed)
    batches = {name: random_agents(rng, name, int(rng.integers(0, 20))) for name in names}
    written = columnar.write_output([(name, ROWS[name], batches[name]) for name in names], b"beside")
    if names == sorted(names):  # protobuf's own order, where it is asked for the same bytes every time
        assert written == message_of(batches, b"beside")
    read, (meant, side_channel) = columnar.read_output(written, ROWS), parsed(written)
    assert read is not None
    assert list(read[0]) == names, "in the order in which they are to be read"
    assert meant.keys() == batches.keys()
    assert all(same(meant[name], batches[name]) for name in names)
    assert all(same(read[0][name], batches[name]) for name in names)
    assert read[1] == side_channel == b"beside"


@pytest.mark.parametrize("count", [1, 9, 300, 3000])
def test_long_runs_and_their_ends_are_read(count):
    """More rows than a reader looks ahead, ids of several lengths, and an agent in the middle that ended."""
    agents = random_agents(np.random.default_rng(0), BEHAVIOR, count)
    agents.ids[:], agents.rewards[:] = np.arange(count), 1.0
    agents.done[count // 2] = True
    read = columnar.read_output(message_of({BEHAVIOR: agents}), ROWS)
    assert read is not None
    assert same(read[0][BEHAVIOR], agents)


@pytest.mark.parametrize("behavior", ["Corridor?team=0", "Soccer?team=1"])
@pytest.mark.parametrize("seed", range(10))
def test_messages_in_lockstep_are_as_right_as_the_first_whatever_changes_between_them(behavior, seed):
    """The same agents again and again, then others, other fields, an end, and the same as before."""
    rng = np.random.default_rng(seed)
    count, rows = 20, AgentRows(*KINDS[behavior])
    agents = random_agents(rng, behavior, count)
    agents = dataclasses.replace(
        agents, masks=(), done=np.zeros(count, np.bool_), interrupted=np.zeros(count, np.bool_)
    )
    for number in range(60):
        for values in (agents.rewards, agents.group_rewards, *agents.observations):
            values[values.view(np.int32) != 0] = rng.normal()
        sent = agents
        if number % 5 == 4:
            column = ("ids", "rewards", "group_ids", "group_rewards", "done", "masks")[rng.integers(6)]
            other = random_agents(rng, behavior, count)
            sent = dataclasses.replace(agents, **{column: getattr(other, column)})
        if number % 20 == 19:
            agents = dataclasses.replace(sent, masks=(), done=agents.done)
        data = columnar.write_output([(behavior, rows, sent)], b"")
        assert data == message_of({behavior: sent})
        read = columnar.read_output(data, {behavior: rows})
        assert read is not None
        assert same(read[0][behavior], sent)
        for values in (read[0][behavior].ids, read[0][behavior].rewards, *read[0][behavior].observations):
            values[:] = 7  # what was read is the reader's own


def test_numbers_written_at_more_length_than_needed_are_read_as_protobuf_reads_them():
    """Some encoders write an id as five bytes whatever it is, and fields that are 0."""
    observation = message_of({BEHAVIOR: two_agents()}).partition(b"\x6a")[2]
    observation = b"\x6a" + observation[: observation[0] + 1]
    for extra in (b"\x50\x85\x80\x80\x80\x00", b"\x50\x00", b"\x3d\x00\x00\x00\x00"):
        rows = length_delimited(1, extra + observation)
        entry = length_delimited(1, BEHAVIOR.encode()) + length_delimited(2, rows)
        data = HEADER_OK + length_delimited(2, length_delimited(1, length_delimited(2, entry)))
        read = columnar.read_output(data, ROWS)
        assert read is not None
        assert same(read[0][BEHAVIOR], parsed(data)[0][BEHAVIOR])


def test_rows_of_one_length_with_other_fields_are_told_apart():
    """An id of five bytes is as long as one of a byte with a mask."""
    behavior, count = "Old", 40
    rng = np.random.default_rng(0)
    observations = (rng.normal(size=(count, 2)).astype(np.float32),)
    ids = np.where(np.arange(count) % 20 < 10, 2**31 - 1, 90).astype(np.int32)
    alone = Agents.ungrouped(ids, np.ones(count, np.float32), *np.zeros((2, count), np.bool_), observations)
    message = UnityMessageProto.FromString(message_of({behavior: alone}))
    for info in message.unity_output.rl_output.agentInfos[behavior].value:
        if info.id == 90:
            info.action_mask.extend([False, True])
    data = message.SerializeToString()
    for _ in range(2):  # what was read before is no guide
        read = columnar.read_output(data, ROWS)
        assert read is not None
        assert same(read[0][behavior], parsed(data)[0][behavior])


@pytest.mark.parametrize("change", UNUSUAL)
def test_any_other_message_is_left_to_the_parser(change):
    output = columnar.write_output([(BEHAVIOR, ROWS[BEHAVIOR], two_agents())], b"")
    assert columnar.read_output(output, ROWS) is not None
    assert columnar.read_output(UNUSUAL[change](output), ROWS) is None


def test_other_behaviors_introductions_and_ids_below_0_are_left_to_the_parser():
    data = message_of({BEHAVIOR: two_agents()})
    assert columnar.read_output(data, {"Other": ROWS[BEHAVIOR]}) is None
    message = UnityMessageProto.FromString(data)
    message.unity_output.rl_initialization_output.brain_parameters.add(brain_name="Late")
    assert columnar.read_output(message.SerializeToString(), ROWS) is None
    message = UnityMessageProto.FromString(data)
    message.unity_output.rl_output.agentInfos[BEHAVIOR].value[1].id = -1
    assert columnar.read_output(message.SerializeToString(), ROWS) is None
    twice = length_delimited(2, length_delimited(1, BEHAVIOR.encode()) + length_delimited(2, b"")) * 2
    assert columnar.read_output(HEADER_OK + length_delimited(2, length_delimited(1, twice)), ROWS) is None


def outcome(data: bytes) -> str:
    """What became of a message; fails where columns and protobuf disagree."""
    read = columnar.read_output(data, ROWS)
    if read is None:
        return "left to the parser"
    try:
        found, side_channel = parsed(data)
    except DecodeError:
        pytest.fail(f"columns read what is no message: {data!r}")
    assert read[0].keys() == found.keys(), data
    assert all(same(read[0][name], found[name]) for name in found), data
    assert read[1] == side_channel, data
    return "read"


def campaign(seed: int, count: int) -> Counter[str]:
    rng = np.random.default_rng(seed)
    outcomes: Counter[str] = Counter()
    for number in range(count):
        if number % 50 == 0:
            names = rng.choice(list(KINDS), int(rng.integers(1, 3)), replace=False)
            agents = {str(name): random_agents(rng, str(name), int(rng.integers(1, 12))) for name in names}
            data = message_of(agents, b"abc" if rng.random() < 0.5 else b"")
            assert outcome(data) == "read"
        outcomes[outcome(mutated(rng, data))] += 1
    return outcomes


def test_a_mutated_message_is_left_alone_or_means_what_protobuf_says():
    outcomes = campaign(0, 3000)
    assert min(outcomes.values()) > 300, outcomes


@pytest.mark.slow
def test_fifty_thousand_mutated_messages_mean_what_protobuf_says_and_crash_nothing():
    outcomes = campaign(1, 50_000)
    assert min(outcomes.values()) > 5_000, outcomes


def test_rows_longer_than_a_two_byte_length_are_read():
    long = VECTOR._replace(name="Long", shape=(6000,))
    agents = Agents.ungrouped(
        np.arange(3, dtype=np.int32),
        np.ones(3, np.float32),
        *np.zeros((2, 3), np.bool_),
        (np.ones((3, 6000), np.float32),),
    )
    rows = AgentRows((long,))
    read = columnar.read_output(columnar.write_output([("Long", rows, agents)], b""), {"Long": rows})
    assert read is not None
    assert same(read[0]["Long"], agents)
