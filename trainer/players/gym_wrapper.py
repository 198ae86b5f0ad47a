"""``UnityToGymWrapper`` for Gymnasium: an ML-Agents environment with one agent as a ``gymnasium.Env``.

Name, arguments and checks are those of Unity's own wrapper, which as published needs the unmaintained gym package;
Unity's Gymnasium version (ml-agents pull request 6309) can take this one's place once it is released.
"""

import itertools
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from mlagents_envs.base_env import ActionSpec, ActionTuple, BaseEnv, DecisionSteps, TerminalSteps
from mlagents_envs.logging_util import get_logger
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray

from trainer.corridor import episode_info
from trainer.players.unsupported import refuse_group_rewards, refuse_masks

logger = get_logger(__name__)

Observation = NDArray[Any] | tuple[NDArray[Any], ...]


class UnityGymException(gymnasium.error.Error):
    """The environment, or what is asked of it, does not fit a Gymnasium environment with one agent."""


class UnityToGymWrapper(gymnasium.Env[Observation, Any]):
    """One agent of one behavior as a Gymnasium environment.

    The action space is Box(-1, 1) for continuous actions, Discrete for one discrete branch, and MultiDiscrete (or
    Discrete, flattened) for several. The observation is the first visual observation if there is one, else all vector
    observations in one array; with ``allow_multiple_obs``, a tuple of every visual observation and, last, the vector.

    ``terminated`` and ``truncated`` are never both true: an episode that was interrupted (``max_step_reached``) is
    truncated, every other end is terminated. Each info holds the raw ``DecisionSteps`` or ``TerminalSteps`` as
    ``step``. ``spec`` says that it is nondeterministic: a player takes its seed when it is opened, and no other later.

    Args:
        unity_env: The environment; closing the wrapper closes it.
        uint8_visual: Give visual observations as uint8 from 0 to 255 instead of float from 0 to 1.
        flatten_branched: Make branched discrete actions one Discrete space.
        allow_multiple_obs: Give all observations, as a tuple.
        action_space_seed: Seeds the action space.

    Raises:
        UnityGymException: Several behaviors or agents, no observation, or continuous and discrete actions at once.
    """

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(
        self,
        unity_env: BaseEnv,
        uint8_visual: bool = False,
        flatten_branched: bool = False,
        allow_multiple_obs: bool = False,
        action_space_seed: int | None = None,
    ) -> None:
        self.spec = EnvSpec("UnityToGymWrapper-v0", nondeterministic=True)
        self._closed = False
        self._env = unity_env
        self._env.reset()  # behaviors are only known once the player has sent agents
        self._check_behaviors()
        self.name = next(iter(self._env.behavior_specs))
        self.group_spec = self._env.behavior_specs[self.name]
        shapes = [tuple(spec.shape) for spec in self.group_spec.observation_specs]
        self._visual_shapes = [shape for shape in shapes if len(shape) == 3]
        self.render_mode = "rgb_array" if self._visual_shapes else None
        self._vector_size = sum(shape[0] for shape in shapes if len(shape) == 1)
        if not self._visual_shapes and not self._vector_size:
            raise UnityGymException("The environment provides no visual or vector observation.")
        if uint8_visual and not self._visual_shapes:
            logger.warning("uint8_visual has no effect: the environment has no visual observation.")
        if len(self._visual_shapes) + bool(self._vector_size) > 1 and not allow_multiple_obs:
            logger.warning(
                "The environment has several observations, of which only the first visual one is given; "
                "allow_multiple_obs=True gives all."
            )
        self._uint8_visual = uint8_visual
        self._allow_multiple_obs = allow_multiple_obs
        self._image: NDArray[Any] | None = None
        self._flattened: list[tuple[int, ...]] | None = None
        self._needs_reset = False
        self.action_space = self._make_action_space(self.group_spec.action_spec, flatten_branched)
        if action_space_seed is not None:
            self.action_space.seed(action_space_seed)
        self.observation_space = self._make_observation_space()
        # The reset above already began an episode, which the first reset() gives out.
        self._first_decision: DecisionSteps | None = self._decision()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode. A player takes its seed at launch: ``seed`` reaches only this wrapper's own generator."""
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
            UnityGymException: The episode is over, and reset() has not been called since; or the action is not finite.
        """
        if self._needs_reset:
            raise UnityGymException("The episode is over; call reset() before step().")
        self._first_decision = None
        if self._flattened is not None:
            action = self._flattened[int(action)]
        actions = ActionTuple()
        if self.group_spec.action_spec.is_continuous():
            if not np.isfinite(action).all():
                raise UnityGymException(f"The action is {action!r}, but finite numbers were expected.")
            actions.add_continuous(np.asarray(action, dtype=np.float32).reshape(1, -1))
        else:
            actions.add_discrete(np.asarray(action, dtype=np.int32).reshape(1, -1))
        self._env.set_actions(self.name, actions)
        decision, terminal = self._next_steps()
        ended = np.flatnonzero(terminal.agent_id == self._agent)
        if len(ended):
            self._needs_reset = True
            row = int(ended[0])
            truncated, reward = bool(terminal.interrupted[row]), float(terminal.reward[row])
            return self._observation(terminal, row), reward, not truncated, truncated, {"step": terminal}
        if decision.agent_id[0] != self._agent:
            raise UnityGymException(
                f"Agent {decision.agent_id[0]} asks for a decision while the episode of agent {self._agent} goes on: "
                "the environment has several agents that take turns, but a Gymnasium environment has one."
            )
        return self._observation(decision), float(decision.reward[0]), False, False, {"step": decision}

    def render(self) -> NDArray[Any] | None:
        """The latest first visual observation, as the agent got it; None without one. Draws no new frame."""
        return self._image

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

    def _observation(self, steps: DecisionSteps | TerminalSteps, row: int = 0) -> Observation:
        images = [self._pixels(array[row]) for array in steps.obs if array.ndim == 4]
        vectors = [array[row] for array in steps.obs if array.ndim == 2]
        if images:
            self._image = images[0]
        observations = [*images, np.concatenate(vectors)] if vectors else images
        return tuple(observations) if self._allow_multiple_obs else observations[0]

    def _pixels(self, image: NDArray[np.float32]) -> NDArray[Any]:
        return (255.0 * image).astype(np.uint8) if self._uint8_visual else image

    def _make_observation_space(self) -> spaces.Space[Any]:
        each: list[spaces.Space[Any]] = []
        for shape in self._visual_shapes:
            if self._uint8_visual:
                each.append(spaces.Box(0, 255, shape, np.uint8))
            else:
                each.append(spaces.Box(0.0, 1.0, shape, np.float32))
        if self._vector_size:
            each.append(spaces.Box(-np.inf, np.inf, (self._vector_size,), np.float32))
        return spaces.Tuple(each) if self._allow_multiple_obs else each[0]

    def _make_action_space(self, spec: ActionSpec, flatten_branched: bool) -> spaces.Space[Any]:
        if spec.is_continuous():
            if flatten_branched:
                logger.warning("flatten_branched has no effect: the actions are continuous.")
            return spaces.Box(-1.0, 1.0, (spec.continuous_size,), np.float32)
        if not spec.is_discrete():
            raise UnityGymException(
                f"The behavior has {spec.continuous_size} continuous actions and {spec.discrete_size} discrete "
                "branches; a Gymnasium action space is one or the other."
            )
        branches = tuple(int(size) for size in spec.discrete_branches)
        if len(branches) == 1:
            return spaces.Discrete(branches[0])
        if flatten_branched:
            self._flattened = list(itertools.product(*(range(size) for size in branches)))
            return spaces.Discrete(len(self._flattened))
        return spaces.MultiDiscrete(list(branches))

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
                "ask the player for one area, or use the vector path."
            )


class EpisodeStatistics(gymnasium.Wrapper[Observation, Any, Observation, Any]):
    """Adds what the player reported of an ended episode to its last info, as ``statistics`` and ``is_success``.

    The info's ``step`` goes: Stable-Baselines3's ``DummyVecEnv`` would copy it at every step.

    Args:
        env: The environment of one agent.
        channel: The statistics channel that the player's environment was opened with.
    """

    def __init__(self, env: UnityToGymWrapper, channel: StatsSideChannel) -> None:
        super().__init__(env)
        self._channel = channel

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Steps the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._refuse_unsupported(info.pop("step"))
        received = self._channel.get_and_reset_stats()
        if terminated or truncated:
            info.update(episode_info({name: values[-1][0] for name, values in received.items()}))
        return observation, float(reward), terminated, truncated, info

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Resets the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._refuse_unsupported(info.pop("step"))
        return observation, info

    def _refuse_unsupported(self, steps: DecisionSteps | TerminalSteps) -> None:
        refuse_group_rewards(steps)
        if isinstance(steps, DecisionSteps):
            refuse_masks(steps)
