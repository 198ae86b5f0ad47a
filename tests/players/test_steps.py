"""What the trainer makes of a player's agents is what ``mlagents_envs`` makes of them; what it refuses, it names."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mlagents_envs.base_env import ActionSpec, BehaviorSpec
from mlagents_envs.exception import UnityObservationException
from mlagents_envs.rpc_utils import behavior_spec_from_proto, steps_from_proto

sys.path.insert(0, str(Path(__file__).parents[1] / "protocol"))
from messages_of_agents import KINDS, message_of, random_agents

from corridor_server.protocol.agents import Agents
from corridor_server.protocol.columnar import read_output
from corridor_server.protocol.messages import MODULES, UnityMessageProto
from trainer.players import steps as mlagents_steps
from trainer.players.failures import BadNumbers


def spec_of(behavior: str, continuous: int = 2) -> BehaviorSpec:
    """As ``mlagents_envs`` learns it from a player's introduction."""
    brain = MODULES["brain_parameters_pb2"].BrainParametersProto(brain_name=behavior)
    brain.action_spec.num_continuous_actions = continuous
    brain.action_spec.num_discrete_actions = len(KINDS[behavior][1])
    brain.action_spec.discrete_branch_sizes.extend(KINDS[behavior][1])
    message = UnityMessageProto.FromString(message_of({behavior: random_agents(np.random.default_rng(0), behavior, 1)}))
    return behavior_spec_from_proto(brain, message.unity_output.rl_output.agentInfos[behavior].value[0])


def finite_agents(seed: int, behavior: str) -> Agents:
    """Agents that may be sent: each at most once in a part."""
    rng = np.random.default_rng(seed)
    agents = random_agents(rng, behavior, int(rng.integers(0, 30)))
    agents.ids[:] = rng.permutation(len(agents)) * 77
    agents.rewards[~np.isfinite(agents.rewards)] = 1.0
    agents.group_rewards[~np.isfinite(agents.group_rewards)] = 1.0
    return agents


def equal(one: Any, other: Any) -> bool:
    """Whether all that two steps hold is equal, down to what it is made of."""
    if isinstance(one, list):
        return len(one) == len(other) and all(equal(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and np.array_equal(one, other)
    return bool(one == other)


@pytest.mark.parametrize("behavior", KINDS)
@pytest.mark.parametrize("seed", range(40))
def test_steps_are_those_of_mlagents_envs(behavior, seed):
    data, spec = message_of({behavior: finite_agents(seed, behavior)}), spec_of(behavior)
    rows = mlagents_steps.rows_of({behavior: spec})
    assert rows is not None
    read = read_output(data, rows)
    assert read is not None, "left to the parser"
    ours = mlagents_steps.steps(read[0][behavior], spec)
    theirs = steps_from_proto(
        UnityMessageProto.FromString(data).unity_output.rl_output.agentInfos[behavior].value, spec
    )
    for our, their in zip(ours, theirs, strict=True):
        for name, value in vars(their).items():
            assert equal(getattr(our, name), value), name


def test_pictures_are_left_to_the_parser():
    spec = spec_of("Old")
    picture = spec.observation_specs[0]._replace(shape=(3, 8, 8))
    assert mlagents_steps.rows_of({"A": spec, "B": BehaviorSpec([picture], ActionSpec(2, ()))}) is None
    assert mlagents_steps.rows_of({"A": BehaviorSpec([], ActionSpec(2, ()))}) is None


@pytest.mark.parametrize(
    ("behavior", "change", "says"),
    [
        (
            "Soccer?team=1",
            lambda agents: agents.observations[1][4].fill(np.nan),
            r"observations\[1\]\[0\] = nan of agent 4",
        ),
        (
            "Collector?team=0",
            lambda agents: agents.observations[0][4, 2].fill(-np.inf),
            r"observation\[10\] = -inf of agent 4",
        ),
        ("Soccer?team=1", lambda agents: agents.rewards[4:5].fill(np.inf), "reward = inf of agent 4"),
        ("Soccer?team=1", lambda agents: agents.group_rewards[4:5].fill(np.nan), "group reward = nan of agent 4"),
    ],
)
def test_a_number_that_is_none_is_named_alike_by_columns_and_by_the_parser(behavior, change, says):
    agents = finite_agents(0, behavior)
    agents.ids[:] = np.arange(len(agents))
    change(agents)
    message = UnityMessageProto.FromString(message_of({behavior: agents})).unity_output.rl_output
    with pytest.raises(BadNumbers, match=says):
        mlagents_steps.steps(agents, spec_of(behavior))
    with pytest.raises(BadNumbers, match=says):
        raise mlagents_steps.bad_number(message)


def test_an_agent_that_comes_twice_is_named():
    behavior, spec = "Corridor?team=0", spec_of("Corridor?team=0")
    agents = finite_agents(1, behavior)
    agents.ids[:], agents.done[:] = np.arange(len(agents)), False
    agents.done[:2] = True
    agents.ids[1] = 5  # ends, and begins anew: as Unity does it with a decision period of 1
    mlagents_steps.steps(agents, spec)
    agents.ids[3] = 5
    with pytest.raises(UnityObservationException, match="agent 5 2 times in one message where it asks for a decision"):
        mlagents_steps.steps(agents, spec)
    agents.ids[:2] = 9
    agents.ids[3] = 3
    with pytest.raises(UnityObservationException, match="agent 9 2 times in one message where it ends"):
        mlagents_steps.steps(agents, spec)


def _lose_a_number(info: Any) -> None:
    info.observations[1].float_data.data.pop()


def _add_a_mask(info: Any) -> None:
    info.action_mask.extend([False] * (10 - len(info.action_mask)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda info: info.observations.pop(), "2 observations, but 3 were expected"),
        (lambda info: info.observations.add(), "4 observations, but 3 were expected"),
        (_lose_a_number, r"2 numbers in observations\[1\], but 3 were expected"),
        (
            lambda info: info.observations[1].shape.append(1),
            r"observations\[1\] of shape \(3, 1\), but \(3,\) was expected",
        ),
        (_add_a_mask, "10 values in action_mask, but 9 were expected"),
    ],
)
def test_a_count_that_does_not_fit_is_named_with_its_agent_and_field(change, says):
    behavior = "Soccer?team=1"
    agents = finite_agents(0, behavior)
    agents.ids[:] = np.arange(len(agents))
    rl_output = UnityMessageProto.FromString(message_of({behavior: agents})).unity_output.rl_output
    specs = {behavior: spec_of(behavior)}
    mlagents_steps.check_counts(rl_output, specs)
    change(rl_output.agentInfos[behavior].value[4])
    with pytest.raises(UnityObservationException, match=f"agent 4 of behavior Soccer.team=1 with {says}"):
        mlagents_steps.check_counts(rl_output, specs)
