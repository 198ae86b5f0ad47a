"""Messages of a player that can't be used: each is one sentence, with the agent and the field, and none is left out."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from mlagents_envs.exception import UnityException
from raw_player import write_player

from corridor_server.shared.patience import MESSAGES_WITHOUT_DECISION
from trainer.errors import TrainerError
from trainer.players.failures import explain
from trainer.players.opening import open_environment
from trainer.players.statistics_channel import Statistics
from trainer.players.trained import TrainedSlots

HELLO, FIRST, LATER = (-2,), (0,), (3,)
OUTPUT = "output = message.unity_output.rl_output\n"
AGENTS = f"{OUTPUT}agents = output.agentInfos['Raw?team=0'].value\n"
BRAIN = "brain = message.unity_output.rl_initialization_output.brain_parameters[0]\n"
STATISTIC = f"{OUTPUT}output.side_channel = channels.message(channels.STATISTICS, %r)"
MISTYPED = "agents[1].Clear()\nagents[1].MergeFromString(%r)"
WITHOUT_HEADER = "data = message.unity_output.SerializeToString()\nmessage.ClearField('header')\n"


@contextmanager
def playing(folder, port: int, **options: object) -> Iterator[TrainedSlots]:
    player, _ = write_player(folder, agents=2, **options)
    statistics = Statistics()
    environment = open_environment(
        str(player), seed=0, num_areas=1, port=port, timeout_wait=60, side_channels=[statistics]
    )
    try:
        yield TrainedSlots(environment, statistics)
    finally:
        environment.kill()


def played(folder, port: int, **options: object) -> list[dict]:
    with playing(folder, port, **options) as env:
        env.reset()
        steps = [env.step(np.zeros((2, *env.action_space.shape), env.action_space.dtype)) for _ in range(6)]
    return [info for _, _, _, infos in steps for info in infos if "terminal_observation" in info]


@pytest.mark.parametrize(
    ("spoiled", "spoil", "says"),
    [
        (HELLO, "message.ClearField('unity_output')", "has communication_version '', but three numbers such as 1.5.0"),
        (HELLO, "message.unity_output.rl_initialization_output.communication_version = 'abc'", "'abc', but three"),
        (LATER, "data = b'hello world'", "sent 11 bytes that are not a message"),
        (LATER, "data = b''", "sent 0 bytes without a header's status; 200 was expected"),
        (LATER, "data = message.SerializeToString() + b'\\x10\\x05'", "sent unity_output as another type"),
        (LATER, "data = b'\\x0a\\x02\\x0a\\x00'", "sent header.status as another type"),
        (LATER, AGENTS + MISTYPED % b"\x38\x01", r'agentInfos\["Raw\?team=0"\].value\[1\].reward as another type'),
        (LATER, AGENTS + MISTYPED % b"\x52\x01a", r"value\[1\].id as another type"),
        (LATER, AGENTS + MISTYPED % b"\x42\x01a", r"value\[1\].done as another type"),
        (LATER, OUTPUT + "output.agentInfos['Other?team=0'].value.add(id=7)", "agent 7 of .*'Other.* not announced"),
        (LATER, AGENTS + "agents[1].id = 0", "agent 0 2 times in one message"),
        (LATER, AGENTS + "agents[1].observations[0].compression_type = 1", "agent 1 .* compression 1; only pictures"),
        (LATER, AGENTS + "agents[1].observations[0].compression_type = 9", "agent 1 .* compression 9; only pictures"),
        (LATER, AGENTS + "del agents[1]", "agents 0 asked for a decision, and of the others 1 neither asked nor ended"),
        (FIRST, AGENTS + "agents[0].observations[0].observation_type = 7", r"observations\[0\] of agent 0 of type 7"),
        (FIRST, BRAIN + "brain.brain_name = ''", "announced behavior '' with no name"),
        (FIRST, BRAIN + "brain.action_spec.num_continuous_actions = 2**31 - 1", "2147483647 continuous actions, but 0"),
        (FIRST, BRAIN + "brain.action_spec.num_continuous_actions = -2", "with -2 continuous actions"),
        (FIRST, BRAIN + "brain.action_spec.num_discrete_actions = 2", "2 discrete actions, but 0 sizes"),
        (
            FIRST,
            BRAIN + "brain.action_spec.num_discrete_actions = 1\nbrain.action_spec.discrete_branch_sizes.append(0)",
            r"branches of \[0\] choices, but 1 or more",
        ),
        (FIRST, "message.ClearField('unity_output')", "announced no behavior in its first message"),
        (
            LATER,
            "brain = message.unity_output.rl_initialization_output.brain_parameters.add(brain_name='Raw?team=0')\n"
            "brain.action_spec.num_continuous_actions = 3",
            "'Raw.team=0' with other actions than before",
        ),
        (
            LATER,
            "brain = message.unity_output.rl_initialization_output.brain_parameters.add(brain_name='Late?team=0')\n"
            f"brain.action_spec.num_continuous_actions = 1\n{AGENTS}\n"
            "output.agentInfos['Late?team=0'].value.add().CopyFrom(agents[0])",
            r"Agents of behavior Late\?team=0 have come beside those of Raw\?team=0",
        ),
        (LATER, STATISTIC % b"\x01\0\0\0\xff\0\0\0\0\0\0\0\0", "side channel a1d8f7b7.* a string that is not UTF-8"),
        (LATER, STATISTIC % b"\x01\0\0\0a\0\0\0\0\x63\0\0\0", "Statistic 'a' has aggregation 99; 0 to 3"),
        (LATER, STATISTIC % b"\xff\xff\xff\x7f", "announces 2147483647 items, but 0 bytes are left"),
        (LATER, OUTPUT + "output.side_channel = b'cut'", "ends after 3 of a message header's 20 bytes"),
    ],
)  # fmt: skip
def test_it_is_one_sentence(tmp_path, free_port, spoiled, spoil, says):
    with pytest.raises((UnityException, TrainerError)) as error:
        played(tmp_path, free_port, spoil=spoil, spoiled=spoiled)
    sentence = explain(error.value) if isinstance(error.value, UnityException) else str(error.value)
    assert "\n" not in sentence
    with pytest.raises(TrainerError, match=says):
        raise TrainerError(sentence)


def test_masked_choices_end_training(tmp_path, free_port):
    spoil = BRAIN.replace("[0]", "[:1]") + (
        "for each in brain:\n    each.action_spec.num_continuous_actions = 0\n"
        "    each.action_spec.num_discrete_actions = 1\n    each.action_spec.discrete_branch_sizes.append(3)\n"
        f"{AGENTS}agents[1].action_mask.extend([False, False, True])"
    )
    with pytest.raises(TrainerError, match="Agent 1 masks choice 2 of discrete branch 0"):
        played(tmp_path, free_port, spoil=spoil, spoiled=FIRST)


def test_nobody_ever_decides(tmp_path, free_port):
    spoil = "message.unity_output.rl_output.ClearField('agentInfos')"
    with pytest.raises(UnityException, match=f"No agent asked for a decision in {MESSAGES_WITHOUT_DECISION} messages"):
        played(tmp_path, free_port, spoil=spoil, spoiled=tuple(range(3, 2000)))


def test_a_success_that_is_no_number_is_unknown(tmp_path, free_port):
    spoil = OUTPUT + "output.side_channel = channels.write_statistics({'Corridor/Success': [float('nan')] * 2})"
    ends = played(tmp_path, free_port, spoil=spoil, spoiled=(5,))
    assert len(ends) == 2
    assert not any("is_success" in info for info in ends)
