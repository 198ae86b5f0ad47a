"""``UnityToGymWrapper`` for Gymnasium: an ML-Agents environment with one agent as a ``gymnasium.Env``.

Name, arguments and checks are those of Unity's own wrapper, which as published needs the unmaintained gym package;
Unity's Gymnasium version (ml-agents pull request 6309) can take this one's place once it is released.
"""

import itertools
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from mlagents_envs.base_env import ActionSpec, ActionTuple, BaseEnv, DecisionSteps, TerminalSteps
from mlagents_envs.logging_util import get_logger
from numpy.typing import NDArray

from trainer.errors import TrainerError
from trainer.players.behavior_spaces import (
    action_arrays,
    action_space,
    all_rewards,
    allowed_choices,
    in_axes,
    picture_axes,
    picture_box,
)
from trainer.players.owned import CLOSED, closed_if_refused, compressed_pictures

logger = get_logger(__name__)

DECISIONS_PER_SECOND = 10  # of a Unity agent with the default settings: every 5 steps of 0.02 s

Observation = NDArray[Any] | tuple[NDArray[Any], ...]


class UnityGymException(gymnasium.error.Error):
    """The environment, or what is asked of it, does not fit a Gymnasium environment with one agent."""


class UnityToGymWrapper(gymnasium.Env[Observation, Any]):
    """One agent of one behavior as a Gymnasium environment.

    The action space is Box(-1, 1) for continuous actions, Discrete for one discrete branch, MultiDiscrete (or Discrete,
    flattened) for several, and Tuple((Box, MultiDiscrete)) for continuous and discrete actions at once. With discrete
    ones, ``action_masks`` says what is allowed, as sb3-contrib's ``MaskablePPO`` asks for it.

    The observation is the first visual observation if there is one, else all vector observations in one array, else the
    first buffer of vectors, (most, size). With ``allow_multiple_obs`` it is a tuple of all: every visual observation,
    every buffer and, last, the vector. Pictures are (height, width, channels), whichever order a player says that it
    has; one that says none has them in that order. Compressed ones (PNG) are from 0 to 1, as all of Unity's cameras
    are; of others, which are floats as the player has them, the space declares no bounds, as the protocol tells none.

    With a picture ``render_mode`` is ``rgb_array``; without one, nothing can be rendered.

    A reward is the agent's own with its group's added.

    ``terminated`` and ``truncated`` are never both true: an episode that was interrupted (``max_step_reached``) is
    truncated, every other end is terminated. Each info holds the raw ``DecisionSteps`` or ``TerminalSteps`` as
    ``step``. ``spec`` says that it is nondeterministic: a player takes its seed when it is opened, and no other later.
    There is one player: ``spec.make()`` gives this environment itself, for Gymnasium's ``check_env``, which closes it.

    Args:
        unity_env: The environment; closing the wrapper closes it, and so does a refusal of it.
        uint8_visual: Give visual observations as uint8 from 0 to 255 instead of float from 0 to 1.
        flatten_branched: Make branched discrete actions one Discrete space.
        allow_multiple_obs: Give all observations, as a tuple.
        action_space_seed: Seeds the action space.

    Raises:
        UnityGymException: Several behaviors or agents, no observation, or no action.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": DECISIONS_PER_SECOND}  # noqa: RUF012 - Gymnasium's own

    def __init__(
        self,
        unity_env: BaseEnv,
        uint8_visual: bool = False,
        flatten_branched: bool = False,
        allow_multiple_obs: bool = False,
        action_space_seed: int | None = None,
    ) -> None:
        self.spec = EnvSpec("UnityToGymWrapper-v0", entry_point=lambda **_: self, nondeterministic=True)
        self._closed = False
        self._env = unity_env
        with closed_if_refused(unity_env):
            self._begin(uint8_visual, flatten_branched, allow_multiple_obs)
        if action_space_seed is not None:
            self.action_space.seed(action_space_seed)

    def _begin(self, uint8_visual: bool, flatten_branched: bool, allow_multiple_obs: bool) -> None:
        self._env.reset()  # behaviors are only known once the player has sent agents
        self._check_behaviors()
        self.name = next(iter(self._env.behavior_specs))
        self.group_spec = self._env.behavior_specs[self.name]
        observed = self.group_spec.observation_specs
        self._pictures = {i: picture_axes(each) for i, each in enumerate(observed) if len(each.shape) == 3}
        self._buffers = [i for i, each in enumerate(observed) if len(each.shape) == 2]
        self._vectors = [i for i, each in enumerate(observed) if len(each.shape) == 1]
        self._compressed = compressed_pictures(self._env, self.name)
        self.render_mode = "rgb_array" if self._pictures else None
        if not self._pictures:
            self.metadata = {"render_modes": []}
        kinds = len(self._pictures) + len(self._buffers) + bool(self._vectors)
        if not kinds:
            raise UnityGymException("The environment provides no observation, but one or more were expected.")
        if uint8_visual and not self._pictures:
            logger.warning("uint8_visual has no effect: the environment has no visual observation.")
        if kinds > 1 and not allow_multiple_obs:
            given = "the first visual one" if self._pictures else "the vector" if self._vectors else "the first buffer"
            logger.warning(
                f"The environment has several observations ({self._named()}), of which only {given} is given; "
                "allow_multiple_obs=True gives all."
            )
        self._uint8_visual = uint8_visual
        self._allow_multiple_obs = allow_multiple_obs
        self._image: NDArray[np.float32] | None = None
        self._flattened: list[tuple[int, ...]] | None = None
        self._needs_reset = False
        self._last_decision: DecisionSteps | None = None  # what the running episode's agent asked with last
        self.action_space = self._make_action_space(self.group_spec.action_spec, flatten_branched)
        self.observation_space = self._make_observation_space()
        # The reset above already began an episode, which the first reset() gives out.
        self._first_decision: DecisionSteps | None = self._decision()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode. A player takes its seed at launch: ``seed`` reaches only this wrapper's own generator.

        Raises:
            UnityGymException: The environment is closed.
        """
        self._check_open()
        super().reset(seed=seed)
        if self._first_decision is None:
            self._env.reset()
            decision = self._decision()
        else:
            decision, self._first_decision = self._first_decision, None
        self._needs_reset = False
        return self._observation(decision), {"step": decision}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Gives the agent an action and runs the player until it asks for the next, or its episode ends.

        Raises:
            UnityGymException: The episode is over, and reset() has not been called since; the action is none that can
                be; or the environment is closed.
        """
        self._check_open()
        if self._needs_reset:
            raise UnityGymException("The episode is over; call reset() before step().")
        self._first_decision = None
        try:
            if self._flattened is not None:
                _, chosen = action_arrays(ActionSpec.create_discrete((len(self._flattened),)), action, 1)
                action = self._flattened[int(chosen[0, 0])]
            numbers, choices = action_arrays(self.group_spec.action_spec, action, 1)
        except TrainerError as error:
            raise UnityGymException(str(error)) from error
        if not np.isfinite(numbers).all():
            raise UnityGymException(f"The action is {action!r}, but finite numbers were expected.")
        self._env.set_actions(self.name, ActionTuple(numbers, choices))
        decision, terminal = self._next_steps()
        ended = np.flatnonzero(terminal.agent_id == self._agent)
        if len(ended):
            self._needs_reset = True
            row = int(ended[0])
            truncated, reward = bool(terminal.interrupted[row]), float(all_rewards(terminal)[row])
            return self._observation(terminal, row), reward, not truncated, truncated, {"step": terminal}
        if decision.agent_id[0] != self._agent:
            raise UnityGymException(
                f"Agent {decision.agent_id[0]} asks for a decision while the episode of agent {self._agent} goes on: "
                "the environment has several agents that take turns, but a Gymnasium environment has one."
            )
        return self._observation(decision), float(all_rewards(decision)[0]), False, False, {"step": decision}

    @property
    def action_masks(self) -> Callable[[], NDArray[np.bool_]]:
        """A method that gives what the agent may choose now, (all branches' choices one after another,) bool.

        True is allowed; with ``flatten_branched``, one flag for each choice of the flattened space. An environment
        without discrete actions has no such attribute, so that who looks for it is told the truth.

        Raises:
            AttributeError: The behavior has no discrete actions.
            UnityGymException: From the method: no episode is running.
        """
        if not self.group_spec.action_spec.discrete_size:
            raise AttributeError("The behavior has no discrete actions, which alone have masks.")
        return self._mask

    def render(self) -> NDArray[np.uint8] | None:
        """The latest first visual observation, (height, width, 3) uint8; None without one. Draws no new frame.

        Values under 0 and over 1 are cut off. Of more channels it is the first three, of fewer the first, as grey.
        """
        if self._image is None:
            return None
        channels = [0, 1, 2] if self._image.shape[-1] >= 3 else [0, 0, 0]
        return _as_bytes(np.clip(self._image[..., channels], 0.0, 1.0))

    def close(self) -> None:
        """Closes the Unity environment; a second time has no effect."""
        if not self._closed:
            self._closed = True
            self._env.close()

    def _decision(self) -> DecisionSteps:
        decision, _ = self._env.get_steps(self.name)
        while not len(decision):
            self._env.step()
            decision, _ = self._env.get_steps(self.name)
        self._check_agents(len(decision))
        self._agent = int(decision.agent_id[0])
        return decision

    def _next_steps(self) -> tuple[DecisionSteps, TerminalSteps]:
        """Runs the player until its agent asks or ends; one that ends before it ever asked is no episode."""
        while True:
            self._env.step()
            self._check_behaviors()  # others may come late
            decision, terminal = self._env.get_steps(self.name)
            self._check_agents(len(decision))
            if len(decision) or self._agent in terminal.agent_id:
                return decision, terminal

    def _mask(self) -> NDArray[np.bool_]:
        if self._last_decision is None:
            raise UnityGymException("No episode is running, so nobody chooses; call reset() before action_masks().")
        mask: NDArray[np.bool_] = allowed_choices(self.group_spec.action_spec, self._last_decision)[0]
        if self._flattened is None:
            return mask
        ends = np.cumsum(self.group_spec.action_spec.discrete_branches)[:-1]
        branches = np.split(mask, ends)
        each = [[branch[choice] for branch, choice in zip(branches, of, strict=True)] for of in self._flattened]
        flags: NDArray[np.bool_] = np.all(each, axis=1)
        return flags

    def _observation(self, steps: DecisionSteps | TerminalSteps, row: int = 0) -> Observation:
        self._last_decision = steps if isinstance(steps, DecisionSteps) else None
        pictures = [in_axes(steps.obs[i], axes)[row] for i, axes in self._pictures.items()]
        if pictures:
            self._image = pictures[0]
        parts: list[NDArray[Any]] = [_as_bytes(each) for each in pictures] if self._uint8_visual else [*pictures]
        if self._allow_multiple_obs or not self._vectors:
            parts += [steps.obs[i][row] for i in self._buffers]
        if self._vectors:
            parts.append(np.concatenate([steps.obs[i][row] for i in self._vectors]))
        return tuple(parts) if self._allow_multiple_obs else parts[0]

    def _make_observation_space(self) -> spaces.Space[Any]:
        shapes = [tuple(each.shape) for each in self.group_spec.observation_specs]
        each: list[spaces.Space[Any]] = []
        for i, axes in self._pictures.items():
            shape = tuple(shapes[i][axis] for axis in axes)
            if self._uint8_visual:
                each.append(spaces.Box(0, 255, shape, np.uint8))
            else:
                each.append(picture_box(shape, i in self._compressed))
        if self._allow_multiple_obs or not self._vectors:
            each += [spaces.Box(-np.inf, np.inf, shapes[i], np.float32) for i in self._buffers]
        if self._vectors:
            each.append(spaces.Box(-np.inf, np.inf, (sum(shapes[i][0] for i in self._vectors),), np.float32))
        return spaces.Tuple(each) if self._allow_multiple_obs else each[0]

    def _make_action_space(self, spec: ActionSpec, flatten_branched: bool) -> spaces.Space[Any]:
        if flatten_branched and not spec.is_discrete():
            logger.warning("flatten_branched has no effect: not all of the actions are discrete.")
        if flatten_branched and spec.is_discrete() and spec.discrete_size > 1:
            self._flattened = list(itertools.product(*(range(int(size)) for size in spec.discrete_branches)))
            return spaces.Discrete(len(self._flattened))
        try:
            return action_space(spec)
        except TrainerError as error:
            raise UnityGymException(str(error)) from error

    def _check_open(self) -> None:
        if self._closed:
            raise UnityGymException(CLOSED)

    def _named(self) -> str:
        return ", ".join(f"{each.name} {tuple(each.shape)}" for each in self.group_spec.observation_specs)

    def _check_behaviors(self) -> None:
        if len(self._env.behavior_specs) != 1:
            raise UnityGymException(
                f"The environment has {len(self._env.behavior_specs)} behaviors, but a Gymnasium environment has "
                "exactly one."
            )

    @staticmethod
    def _check_agents(count: int) -> None:
        if count > 1:
            raise UnityGymException(
                f"The environment has {count} agents, but a Gymnasium environment has one; "
                "ask the player for one area, or take UnityVecEnv."
            )


def _as_bytes(picture: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A picture from 0 to 1 with bytes.

    Raises:
        UnityGymException: It has other values.
    """
    low, high = picture.min(initial=0.0), picture.max(initial=1.0)
    if low < 0.0 or high > 1.0:
        raise UnityGymException(
            f"A picture has values from {low:g} to {high:g}, but for uint8_visual 0 to 1 were expected; leave it out."
        )
    return (255.0 * picture).astype(np.uint8)
