"""Players with one fault each: ours, or the stand-in for Unity's runtime, with what they say or hear changed."""

import sys
from dataclasses import dataclass
from pathlib import Path

from trainer import conformance

# A fault is in what the player says or hears: two functions of a UnityMessageProto, whoever wrote the player.
PLAYER = """#!{python}
import os, runpy, sys
from collections import Counter
from grpc import _channel
from corridor_server.protocol.messages import UnityMessageProto

def said(message): pass
def heard(message): pass
def agents(message):
    return [info for each in message.unity_output.rl_output.agentInfos.values() for info in each.value]
{fault}
unary_unary = _channel.Channel.unary_unary
def faulty(self, *arguments, **options):
    call = unary_unary(self, *arguments, **options)
    def exchange(data, **options):
        message = UnityMessageProto.FromString(data)
        said(message)
        reply = UnityMessageProto.FromString(call(message.SerializeToString(), **options))
        heard(reply)
        return reply.SerializeToString()
    return exchange
_channel.Channel.unary_unary = faulty
build = {build!r}
if build:
    sys.path.insert(0, os.path.dirname(build))
    runpy.run_path(build, run_name="__main__")
else:
    from corridor_server.main import main
    sys.exit(main())
"""
UNITY = str(Path(__file__).parents[1] / "unity" / "Build.x86_64")


@dataclass(frozen=True)
class Fault:
    """One fault of a player.

    Attributes:
        topic: The topic of the sentence that must fail, alone among those of its topic and level.
        sentence: That sentence.
        code: Defines ``said``, ``heard`` or both.
        strict: Whether the sentence is strict.
        spec: The scene of the stand-in for Unity's runtime that has the fault; our own player if empty.
    """

    topic: type[conformance.Conformance]
    sentence: str
    code: str
    strict: bool = False
    spec: str = ""


FAULTS = {
    "new ids for every episode": Fault(
        conformance.Episodes,
        "an_agent_has_the_same_id_in_its_next_episode",
        """
episodes = Counter()
def said(message):
    for info in agents(message):
        own = info.id
        info.id += 1000 * episodes[own]
        episodes[own] += info.done
""",
    ),
    "swapped action order": Fault(
        conformance.CorridorContract,
        "each_action_reaches_the_agent_that_asked_in_that_place",
        """
def heard(message):
    for actions in message.unity_input.rl_input.agent_actions.values():
        rows = list(actions.value)[::-1]
        del actions.value[:]
        actions.value.extend(rows)
""",
    ),
    "reward not reset": Fault(
        conformance.Episodes,
        "a_request_in_the_message_of_the_last_end_has_reward_0",
        """
def said(message):
    last = {info.id: info.reward for info in agents(message) if info.done}
    for info in agents(message):
        if not info.done:
            info.reward += last.get(info.id, 0.0)
""",
        strict=True,
    ),
    "missing terminal message": Fault(
        conformance.CorridorContract,
        "an_episode_ends_when_its_rewards_add_up_to_minus_1",
        """
def said(message):
    for each in message.unity_output.rl_output.agentInfos.values():
        running = [info for info in each.value if not info.done]
        del each.value[:]
        each.value.extend(running)
""",
    ),
    "terminal reward lost": Fault(
        conformance.CorridorContract,
        "a_failed_episode_pays_the_penalty_with_its_last_reward",
        """
def said(message):
    for info in agents(message):
        if info.done:
            info.reward = 0.0
""",
    ),
    "brain parameters late": Fault(
        conformance.Handshake,
        "every_behavior_is_introduced_in_the_message_that_has_its_first_agents",
        """
late = []
def said(message):
    started = message.unity_output.rl_initialization_output
    due = late.copy()
    late[:] = [type(each).FromString(each.SerializeToString()) for each in started.brain_parameters]
    del started.brain_parameters[:]
    started.brain_parameters.extend(due)
""",
        spec="no_replicator",
    ),
    "wrong shape": Fault(
        conformance.Observations,
        "observations_have_as_many_values_as_their_shape_says",
        """
def said(message):
    for info in agents(message):
        info.observations[0].shape[0] += 1
""",
    ),
    "ignoring QUIT": Fault(
        conformance.Shutdown,
        "quit_ends_the_player_with_code_0",
        """
def heard(message):
    if message.unity_input.rl_input.command == 2:
        message.unity_input.rl_input.command = 1  # QUIT, taken for a RESET
""",
    ),
    "ignoring num_areas": Fault(
        conformance.Handshake,
        "the_number_of_areas_is_the_trainers",
        """
def heard(message):
    if message.unity_input.HasField("rl_initialization_input"):
        message.unity_input.rl_initialization_input.num_areas = 1
""",
        strict=True,
    ),
    "stale observation after reset": Fault(
        conformance.CorridorContract,
        "a_reset_in_mid_episode_shows_a_new_start",
        """
reset, seen = False, {}
def heard(message):
    global reset
    reset = message.unity_input.rl_input.command == 1
def said(message):
    for info in agents(message):
        now = info.observations[0].float_data.data
        if reset and info.id in seen:
            now[:] = seen[info.id]
        seen[info.id] = list(now)
""",
    ),
    "an agent that vanishes": Fault(
        conformance.Episodes,
        "an_agent_that_asked_asks_again_or_ends",
        """
messages = 0
def said(message):
    global messages
    messages += 1
    for each in message.unity_output.rl_output.agentInfos.values():
        rows = [info for info in each.value if messages < 100 or info.id]
        del each.value[:]
        each.value.extend(rows)
""",
        spec="discrete_masks",
    ),
    "a mask without its last branch": Fault(
        conformance.Actions,
        "a_mask_has_a_mark_for_each_choice_of_all_branches",
        """
def said(message):
    for info in agents(message):
        del info.action_mask[-3:]
""",
        spec="discrete_masks",
    ),
    "hybrid actions undeclared": Fault(
        conformance.Handshake,
        "what_the_player_sends_beyond_the_base_it_declares",
        """
def said(message):
    message.unity_output.rl_initialization_output.capabilities.hybridActions = False
""",
        spec="hybrid",
    ),
    "a behavior never introduced": Fault(
        conformance.Handshake,
        "every_behavior_is_introduced_in_the_message_that_has_its_first_agents",
        """
def said(message):
    started = message.unity_output.rl_initialization_output
    early = [each for each in started.brain_parameters if not each.brain_name.startswith("Late")]
    del started.brain_parameters[:]
    started.brain_parameters.extend(early)
""",
        spec="late_behavior",
    ),
}
# Answers everything, and never has an agent.
WITHOUT_AGENTS = """
def heard(message):
    if message.unity_input.HasField("rl_input"):
        message.unity_input.rl_input.command = 1
def said(message):
    message.unity_output.rl_output.agentInfos.clear()
    del message.unity_output.rl_initialization_output.brain_parameters[:]
"""


def write_player(folder: Path, fault: str, spec: str = "") -> Path:
    path = folder / "player"
    path.write_text(PLAYER.format(python=sys.executable, fault=fault, build=UNITY if spec else ""))
    path.chmod(0o755)
    return path
