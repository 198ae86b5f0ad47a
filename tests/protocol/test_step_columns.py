"""Columns of actions mean what protobuf means: they write its bytes, and read nothing that it would read otherwise."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

sys.path.insert(0, str(Path(__file__).parent))
from messages_of_agents import UNUSUAL, VECTOR, mutated

from corridor_server.protocol import columnar
from corridor_server.protocol.agents import ActionBatch, Behavior
from corridor_server.protocol.messages import STEP, UnityMessageProto
from corridor_server.protocol.trainer_messages import command, step
from corridor_server.protocol.wire_bytes import HEADER_OK, length_delimited

BEHAVIOR = "Corridor?team=0"
CORRIDOR = {BEHAVIOR: Behavior(BEHAVIOR, (VECTOR,), 2)}
SEVERAL = CORRIDOR | {
    "Soccer?team=1": Behavior("Soccer?team=1", (VECTOR,), 0, (3, 3, 3)),
    "Hybrid?team=0": Behavior("Hybrid?team=0", (VECTOR,), 3, (4, 2)),
}
FLOATS = st.floats(width=32)
SEEDS = st.integers(0, 2**32 - 1)


def batch(continuous: np.ndarray, discrete: np.ndarray | None = None) -> ActionBatch:
    return ActionBatch(continuous, np.empty((len(continuous), 0), np.int32) if discrete is None else discrete)


@pytest.mark.parametrize("change", UNUSUAL)
def test_any_other_message_is_left_to_the_parser(change):
    actions = columnar.write_step({BEHAVIOR: batch(np.ones((2, 2), np.float32))}, b"")
    assert columnar.read_step(actions, CORRIDOR) is not None
    assert columnar.read_step(UNUSUAL[change](actions), CORRIDOR) is None


@settings(deadline=None)  # the machine may be busy
@given(
    continuous=arrays.arrays(np.float32, st.tuples(st.integers(1, 12), st.integers(0, 4)), elements=FLOATS),
    branches=st.lists(st.integers(1, 200), max_size=3),
    seed=SEEDS,
    side_channel=st.binary(max_size=300),
    deprecated=st.booleans(),
)
def test_steps_of_columns_and_of_protobuf_are_the_same_bytes_and_read_alike(
    continuous, branches, seed, side_channel, deprecated
):
    count, size = continuous.shape
    discrete = np.random.default_rng(seed).integers(0, [*branches], (count, len(branches))).astype(np.int32)
    theirs = command(0, side_channel)
    for numbers, choices in zip(continuous.tolist(), discrete.tolist(), strict=True):
        action = theirs.unity_input.rl_input.agent_actions[BEHAVIOR].value.add()
        action.continuous_actions.extend(numbers)
        action.discrete_actions.extend(choices)
        if deprecated:
            action.vector_actions_deprecated.extend([*numbers, *choices])
    data = theirs.SerializeToString()
    if deprecated:
        assert columnar.write_step({BEHAVIOR: batch(continuous, discrete)}, side_channel) == data
    read = columnar.read_step(data, {BEHAVIOR: Behavior(BEHAVIOR, (VECTOR,), size, tuple(branches))})
    if discrete.size and discrete.max() > 127:
        return  # rows differ in length
    assert read is not None
    assert list(read[0]) == [BEHAVIOR]
    assert read[0][BEHAVIOR].continuous.tobytes() == continuous.tobytes()
    assert np.array_equal(read[0][BEHAVIOR].discrete, discrete)
    assert read[0][BEHAVIOR].discrete.dtype == np.int32
    assert read[1] == side_channel


def test_a_step_for_several_behaviors_has_each_ones_actions():
    data = columnar.write_step({"A": batch(np.ones((2, 1), np.float32)), "B": batch(np.zeros((1, 3), np.float32))}, b"")
    lists = UnityMessageProto.FromString(data).unity_input.rl_input.agent_actions
    assert {name: [list(each.continuous_actions) for each in lists[name].value] for name in lists} == {
        "A": [[1.0], [1.0]],
        "B": [[0.0, 0.0, 0.0]],
    }


def random_actions(rng: np.random.Generator, behavior: Behavior, count: int) -> ActionBatch:
    continuous = rng.normal(size=(count, behavior.continuous_actions)).astype(np.float32)
    sizes = behavior.discrete_branches
    return ActionBatch(continuous, rng.integers(0, [*sizes], (count, len(sizes))).astype(np.int32))


@settings(deadline=None)  # the machine may be busy
@given(
    seed=SEEDS,
    names=st.lists(st.sampled_from(list(SEVERAL)), unique=True, min_size=1),
    side_channel=st.binary(max_size=300),
    by_protobuf=st.booleans(),
)
def test_a_step_for_several_behaviors_is_read_whoever_writes_it_in_whichever_order(
    seed, names, side_channel, by_protobuf
):
    rng = np.random.default_rng(seed)
    sent = {name: random_actions(rng, SEVERAL[name], int(rng.integers(1, 12))) for name in names}
    numbers = {name: actions.continuous.tolist() for name, actions in sent.items()}
    choices = {name: actions.discrete.tolist() for name, actions in sent.items()}
    theirs = step(numbers, side_channel, discrete=choices)
    ours = columnar.write_step(sent, side_channel)
    meant = UnityMessageProto.FromString(ours)
    for name in names:
        for action in meant.unity_input.rl_input.agent_actions[name].value:
            del action.vector_actions_deprecated[:]
    assert meant == theirs
    read = columnar.read_step(theirs.SerializeToString() if by_protobuf else ours, SEVERAL)
    assert read is not None, "left to the parser"
    assert read[0].keys() == sent.keys()
    for name, actions in sent.items():
        assert read[0][name].continuous.tobytes() == actions.continuous.tobytes()
        assert np.array_equal(read[0][name].discrete, actions.discrete)
    assert read[1] == side_channel


def step_of(*entries: tuple[str, bytes]) -> bytes:
    """A STEP with these behaviors' rows, in this order."""
    actions = b"".join(
        length_delimited(1, length_delimited(1, name.encode()) + length_delimited(2, rows)) for name, rows in entries
    )
    return HEADER_OK + length_delimited(3, length_delimited(1, actions))


def test_a_step_with_a_behavior_twice_or_one_that_there_is_not_is_left_to_the_parser():
    corridor, soccer, _ = SEVERAL
    two_numbers = length_delimited(1, b"\x32\x08" + np.ones(2, np.float32).tobytes())
    three_choices = length_delimited(1, b"\x3a\x03\x00\x01\x02")
    both = step_of((corridor, two_numbers), (soccer, three_choices))
    read = columnar.read_step(both, SEVERAL)
    assert read is not None
    assert read[0][corridor].continuous.tolist() == [[1.0, 1.0]]
    assert read[0][soccer].discrete.tolist() == [[0, 1, 2]]
    assert columnar.read_step(both, CORRIDOR) is None, "one that there is not"
    for twice in (two_numbers, b""):
        data = step_of((corridor, two_numbers), (soccer, three_choices), (corridor, twice))
        assert columnar.read_step(data, SEVERAL) is None
    assert columnar.read_step(step_of((corridor, three_choices), (soccer, two_numbers)), SEVERAL) is None
    assert columnar.read_step(step_of(), SEVERAL) is None, "one without actions"


def test_other_commands_behaviors_sizes_and_unpacked_floats_are_left_to_the_parser():
    actions = step({BEHAVIOR: [[0.5, 0.5]]})
    assert columnar.read_step(actions.SerializeToString(), CORRIDOR) is not None
    for behavior in (Behavior(BEHAVIOR, (VECTOR,), 3), Behavior("Other?team=0", (VECTOR,), 2)):
        assert columnar.read_step(actions.SerializeToString(), {behavior.name: behavior}) is None
    assert columnar.read_step(command(1).SerializeToString(), CORRIDOR) is None
    actions.unity_input.rl_input.command = 1
    assert columnar.read_step(actions.SerializeToString(), CORRIDOR) is None
    one = np.float32(1).tobytes()
    unpacked = b"\x35" + one + b"\x35" + one  # continuous_actions, a tag for each value
    entry = length_delimited(1, BEHAVIOR.encode()) + length_delimited(2, length_delimited(1, unpacked))
    data = HEADER_OK + length_delimited(3, length_delimited(1, length_delimited(1, entry)))
    parsed_actions = UnityMessageProto.FromString(data).unity_input.rl_input.agent_actions[BEHAVIOR].value
    assert list(parsed_actions[0].continuous_actions) == [1.0, 1.0]
    assert columnar.read_step(data, CORRIDOR) is None


def outcome(data: bytes) -> str:
    """What became of a STEP for some of several behaviors; fails where columns and protobuf disagree."""
    read = columnar.read_step(data, SEVERAL)
    if read is None:
        return "left to the parser"
    try:
        message = UnityMessageProto.FromString(data)
    except DecodeError:
        pytest.fail(f"columns read what is no message: {data!r}")
    rl_input = message.unity_input.rl_input
    assert (message.header.status, rl_input.command, rl_input.side_channel) == (200, STEP, read[1]), data
    assert read[0].keys() == {*rl_input.agent_actions}, data
    for name, actions in read[0].items():
        rows = rl_input.agent_actions[name].value
        numbers = np.array([row.continuous_actions for row in rows], np.float32).reshape(actions.continuous.shape)
        assert np.array_equal(numbers, actions.continuous, equal_nan=True), data
        assert [list(row.discrete_actions) for row in rows] == actions.discrete.tolist(), data
    return "read"


def test_a_mutated_step_is_left_alone_or_means_what_protobuf_says():
    rng = np.random.default_rng(0)
    outcomes: Counter[str] = Counter()
    for number in range(5000):
        if number % 50 == 0:
            names = [str(name) for name in rng.choice(list(SEVERAL), int(rng.integers(1, 4)), replace=False)]
            sent = {name: random_actions(rng, SEVERAL[name], int(rng.integers(1, 6))) for name in names}
            data = columnar.write_step(sent, b"abc" if rng.random() < 0.5 else b"")
            assert outcome(data) == "read"
        outcomes[outcome(mutated(rng, data))] += 1
    assert min(outcomes.values()) > 300, outcomes
