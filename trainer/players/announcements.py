"""What a player says of itself and of its behaviors, and what is refused of that."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from mlagents_envs.base_env import ActionSpec, BehaviorSpec, ObservationType
from mlagents_envs.exception import UnityCommunicationException, UnityObservationException

from corridor_server.protocol.messages import API_VERSION

CONTINUOUS = 1  # SpaceTypeProto
MAX_ACTIONS = 10_000  # numbers, or choices in all branches: far more than anybody's, and no memory to speak of


def check_hello(output: Any) -> None:
    """Refuses a first message (UnityOutputProto) that does not say which protocol its player speaks.

    Raises:
        UnityCommunicationException: It has no communication version, or none of three numbers.
    """
    version = output.rl_initialization_output.communication_version
    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9}){2}", version):
        raise UnityCommunicationException(
            f"The player's first message has communication_version {version[:40]!r}, but three numbers such as "
            f"{API_VERSION} were expected."
        )


def check_behaviors(output: Any, known: Mapping[str, BehaviorSpec]) -> None:
    """Refuses behaviors that nobody can play, and one that is announced anew as another.

    Args:
        output: The message (UnityOutputProto) that may announce some.
        known: Those of before.

    Raises:
        UnityObservationException: The first of them.
    """
    for brain in output.rl_initialization_output.brain_parameters:
        name = brain.brain_name
        agents = output.rl_output.agentInfos[name].value if name in output.rl_output.agentInfos else ()
        wrong = _wrong(brain, known.get(name)) or _wrong_observation(agents)
        if wrong is not None:
            raise UnityObservationException(f"The player announced behavior {name!r} with {wrong}.")


def _wrong(brain: Any, known: BehaviorSpec | None) -> str | None:
    spec = brain.action_spec
    continuous, discrete, branches = spec.num_continuous_actions, spec.num_discrete_actions, spec.discrete_branch_sizes
    if not continuous and not discrete:  # a player of before action specs says it here
        branches = brain.vector_action_size_deprecated
        if brain.vector_action_space_type_deprecated == CONTINUOUS:
            if len(branches) != 1:
                return f"{len(branches)} sizes of continuous actions, but one was expected"
            continuous, branches = branches[0], []
        discrete = len(branches)
    if not brain.brain_name:
        return "no name, but one was expected"
    if not 0 <= continuous <= MAX_ACTIONS:
        return f"{continuous} continuous actions, but 0 to {MAX_ACTIONS} were expected"
    if discrete != len(branches):
        return f"{discrete} discrete actions, but {len(branches)} sizes of such"
    if branches and (min(branches) < 1 or sum(branches) > MAX_ACTIONS):
        return f"discrete branches of {branches[:5]} choices, but 1 or more were expected, {MAX_ACTIONS} at most in all"
    if known is not None and known.action_spec != ActionSpec(continuous, tuple(branches)):
        return "other actions than before; a behavior keeps its actions"
    return None


def _wrong_observation(agents: Sequence[Any]) -> str | None:
    types = [each.value for each in ObservationType]
    for agent in agents[:1]:  # of whom mlagents_envs takes what all observe
        for index, observation in enumerate(agent.observations):
            if observation.observation_type not in types:
                return (
                    f"observations[{index}] of agent {agent.id} of type {observation.observation_type}, but one of "
                    f"{types} was expected"
                )
    return None
