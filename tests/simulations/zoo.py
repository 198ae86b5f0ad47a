"""Serving environments that others wrote, and stepping the same ones in process beside them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from conftest import BIN
from gymnasium import spaces
from mlagents_envs.base_env import ActionTuple, DecisionSteps, TerminalSteps

from trainer.players.opening import open_environment

SEED = 11
QUARTERS = np.linspace(-1, 1, 9, dtype=np.float32)  # which any bounds scale without rounding


@contextmanager
def served(port: int, folder: Path, *options: str, num_areas: int = 1, seed: int = SEED) -> Iterator[Any]:
    """Our server with these options, as a trainer sees it, before its first reset."""
    environment = open_environment(
        str(BIN / "corridor-server"),
        seed=seed,
        num_areas=num_areas,
        port=port,
        timeout_wait=60,
        log_folder=folder,
        env_args=list(options),
    )
    try:
        yield environment
    finally:
        if environment.is_open:
            environment.close()


def random_actions(rng: np.random.Generator, spec: Any, steps: DecisionSteps) -> ActionTuple:
    """Of what the masks allow."""
    size, branches = spec.action_spec.continuous_size, spec.action_spec.discrete_branches
    discrete = np.zeros((len(steps), len(branches)), np.int32)
    for row, branch in np.ndindex(discrete.shape):
        allowed = np.ones(branches[branch], np.bool_)
        if steps.action_mask is not None:
            allowed = ~steps.action_mask[branch][row]
        discrete[row, branch] = rng.choice(np.flatnonzero(allowed))
    return ActionTuple(rng.choice(QUARTERS, (len(steps), size)), discrete)


def as_action(space: spaces.Space[Any], numbers: Sequence[float], choices: Sequence[int]) -> Any:
    """The space's own action for what was sent."""
    action, left_numbers, left_choices = _taken(space, list(map(float, numbers)), list(map(int, choices)))
    assert not left_numbers
    assert not left_choices
    return action


def _taken(space: Any, numbers: list[float], choices: list[int]) -> tuple[Any, list[float], list[int]]:
    if isinstance(space, spaces.Tuple):
        parts = []
        for each in space.spaces:
            part, numbers, choices = _taken(each, numbers, choices)
            parts.append(part)
        return tuple(parts), numbers, choices
    if isinstance(space, spaces.Discrete):
        return int(space.start) + choices[0], numbers, choices[1:]
    size = int(np.prod(space.shape))
    unit = np.array(numbers[:size], np.float64).reshape(space.shape)
    scaled = (space.low + (unit + 1) / 2 * (space.high - space.low.astype(np.float64))).astype(space.dtype)
    return scaled, numbers[size:], choices


def as_numbers(space: spaces.Space[Any], observation: Any) -> np.ndarray:
    """An observation as Gymnasium flattens it, in the protocol's floats; a picture's bytes from 0 to 1."""
    if isinstance(space, spaces.Dict) and "action_mask" in space.spaces:
        rest = {key: part for key, part in space.spaces.items() if key != "action_mask"}
        return as_numbers(spaces.Dict(rest), {key: observation[key] for key in rest})
    flat = np.asarray(spaces.flatten(space, observation))
    if isinstance(space, spaces.Box) and space.dtype == np.uint8:
        return flat.astype(np.float32) / np.float32(255)
    return flat.astype(np.float32)


def seen(steps: DecisionSteps | TerminalSteps, row: int) -> np.ndarray:
    """An agent's observation over all sensors, in one row."""
    return np.concatenate([values[row].ravel() for values in steps.obs])


def asking_and_ended(environment: Any) -> tuple[Mapping[int, Any], Mapping[int, Any]]:
    """Of every behavior, by agent id: (observation, reward with the group's, mask or interrupted)."""
    asking, ended = {}, {}
    for name in environment.behavior_specs:
        decision, terminal = environment.get_steps(name)
        for row, agent in enumerate(decision.agent_id.tolist()):
            mask = None if decision.action_mask is None else np.concatenate([m[row] for m in decision.action_mask])
            reward = float(decision.reward[row]) + float(decision.group_reward[row])
            asking[agent] = (seen(decision, row), reward, mask)
        for row, agent in enumerate(terminal.agent_id.tolist()):
            reward = float(terminal.reward[row]) + float(terminal.group_reward[row])
            ended[agent] = (seen(terminal, row), reward, bool(terminal.interrupted[row]))
    return asking, ended
