"""A player's agents as ``mlagents_envs`` shows them: the same steps as it makes of a message, and what is refused.

An observation, reward or group reward that is NaN or infinite, an agent that comes twice, and a count that doesn't fit
are one sentence each, with the agent and the field.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from mlagents_envs.base_env import BehaviorSpec, DecisionSteps, TerminalSteps
from mlagents_envs.exception import UnityObservationException
from numpy.typing import NDArray

from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents, Sensor
from corridor_server.protocol.messages import PNG, UNCOMPRESSED
from trainer.players.failures import BadNumbers

Steps = tuple[DecisionSteps, TerminalSteps]


def rows_of(specs: Mapping[str, BehaviorSpec]) -> dict[str, AgentRows] | None:
    """How each behavior's agents look in a message; None if one has observations other than vectors and buffers."""
    if not all(_is_plain(spec) for spec in specs.values()):
        return None
    return {
        name: AgentRows(sensors_of(spec), tuple(spec.action_spec.discrete_branches)) for name, spec in specs.items()
    }


def _is_plain(spec: BehaviorSpec) -> bool:
    shapes = [tuple(each.shape) for each in spec.observation_specs]
    return bool(shapes) and all(0 < len(shape) < 3 and math.prod(shape) for shape in shapes)


def sensors_of(spec: BehaviorSpec) -> tuple[Sensor, ...]:
    """What a behavior's agents observe."""
    sensors = []
    for each in spec.observation_specs:
        properties = tuple(int(value) for value in each.dimension_property)
        known = properties if any(properties) else ()  # mlagents_envs fills in zeros for what a player doesn't say
        sensors.append(Sensor(each.name, tuple(each.shape), known, int(each.observation_type.value)))
    return tuple(sensors)


def steps(agents: Agents, spec: BehaviorSpec) -> Steps:
    """What ``steps_from_proto`` makes of these agents.

    Raises:
        BadNumbers: An observation or a reward is NaN or infinite.
        UnityObservationException: An agent comes twice.
    """
    several = len(agents.observations) > 1
    for number, values in enumerate(agents.observations):
        _check_finite(f"observations[{number}]" if several else "observation", values, agents.ids)
    _check_finite("reward", agents.rewards, agents.ids)
    if np.count_nonzero(agents.group_rewards):
        _check_finite("group reward", agents.group_rewards, agents.ids)
    found = _decision(agents.deciding, spec), _terminal(agents.ended)
    check_ids(found)
    return found


def _check_finite(field: str, values: NDArray[np.float32], ids: NDArray[np.int32]) -> None:
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < finite.size:
        row, *component = np.argwhere(~finite)[0].tolist()
        where = f"[{np.ravel_multi_index(tuple(component), values.shape[1:])}]" if component else ""
        raise BadNumbers(f"{field}{where}", float(values[row, *component]), int(ids[row]))


def _decision(agents: Agents, spec: BehaviorSpec) -> DecisionSteps:
    masks = list(agents.masks) if spec.action_spec.discrete_size and len(agents) else None
    groups = agents.group_ids.tolist()
    return DecisionSteps(list(agents.observations), agents.rewards, agents.ids, masks, groups, agents.group_rewards)


def _terminal(agents: Agents) -> TerminalSteps:
    groups = agents.group_ids.tolist()
    return TerminalSteps(
        list(agents.observations), agents.rewards, agents.interrupted, agents.ids, groups, agents.group_rewards
    )


def check_ids(found: Steps) -> None:
    """Refuses an agent that asks for two decisions, or ends twice, in one message.

    Raises:
        UnityObservationException: There is one.
    """
    for part, does in zip(found, ("asks for a decision", "ends"), strict=True):
        ids: NDArray[np.int32] = part.agent_id
        if len(set(ids.tolist())) < len(ids):
            each, counts = np.unique(ids, return_counts=True)
            twice, count = int(each[counts > 1][0]), int(counts[counts > 1][0])
            raise UnityObservationException(
                f"The player sent agent {twice} {count} times in one message where it {does}, but once was expected; "
                "look for agents that share an id."
            )


def check_counts(output: Any, specs: Mapping[str, BehaviorSpec]) -> None:
    """Refuses what ``mlagents_envs`` would choke on, or silently leave out, in an UnityRLOutputProto.

    Raises:
        UnityObservationException: An agent has more or fewer observations, numbers in one, or masks than its behavior,
            or its behavior is none that was announced.
    """
    for name, listed in output.agentInfos.items():
        if name not in specs and listed.value:
            raise UnityObservationException(
                f"The player sent agent {listed.value[0].id} of behavior {name!r}, which it has not announced; "
                f"announced: {', '.join(specs) or 'none'}."
            )
    for name, spec in specs.items():
        infos = output.agentInfos[name].value if name in output.agentInfos else ()
        for info in infos:
            message = _wrong_count(info, spec)
            if message is not None:
                raise UnityObservationException(f"The player sent agent {info.id} of behavior {name} with {message}.")


def _wrong_count(info: Any, spec: BehaviorSpec) -> str | None:
    expected = len(spec.observation_specs)
    if len(info.observations) != expected:
        return f"{len(info.observations)} observations, but {expected} were expected"
    for index, (observation, of_spec) in enumerate(zip(info.observations, spec.observation_specs, strict=True)):
        field = f"observations[{index}]" if expected > 1 else "observation"
        if tuple(observation.shape) != tuple(of_spec.shape):
            return f"{field} of shape {tuple(observation.shape)}, but {tuple(of_spec.shape)} was expected"
        numbers, compression = len(observation.float_data.data), observation.compression_type
        if compression not in (UNCOMPRESSED, PNG) or (compression and len(of_spec.shape) != 3):
            return f"{field} of shape {tuple(of_spec.shape)} in compression {compression}; only pictures may have {PNG}"
        if not compression and numbers != math.prod(of_spec.shape):
            return f"{numbers} numbers in {field}, but {math.prod(of_spec.shape)} were expected"
    choices, masks = sum(spec.action_spec.discrete_branches), len(info.action_mask)
    if choices and masks not in (0, choices):
        return f"{masks} values in action_mask, but {choices} were expected"
    return None


def bad_number(output: Any) -> BadNumbers:
    """Finds what ``mlagents_envs`` refused in an UnityRLOutputProto."""
    for infos in output.agentInfos.values():
        for info in infos.value:
            for index, observation in enumerate(info.observations):
                for component, value in enumerate(observation.float_data.data):
                    if not math.isfinite(value):
                        of_several = f"s[{index}]" if len(info.observations) > 1 else ""
                        return BadNumbers(f"observation{of_several}[{component}]", value, info.id)
            for field, value in (("reward", info.reward), ("group reward", info.group_reward)):
                if not math.isfinite(value):
                    return BadNumbers(field, value, info.id)
    return BadNumbers("a number", math.nan)
