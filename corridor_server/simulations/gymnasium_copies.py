"""Copies of a Gymnasium environment, in this process or in one each: stepped together, reset one by one."""

import multiprocessing
import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from copy import deepcopy
from functools import partial
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import NDArray

from corridor_server.simulations.declared_parameters import ParameterTaker
from corridor_server.simulations.observation_sensors import ACTION_MASK, batched, check_parts
from corridor_server.simulations.simulation import NotRestored, SimulationError, number_of

_CLOSING_SECONDS = 1.0  # for processes that are still at work

Wrap = Callable[[Any], Any]
Settings = Mapping[str, float]


class Begun(NamedTuple):
    """What copies tell that were reset, a row each.

    Attributes:
        observations: A batch of the observation space's.
        masks: What each one's info has as ``action_mask``; None where it has none.
    """

    observations: Any
    masks: Sequence[Any]


class Stepped(NamedTuple):
    """What all copies tell after a step, a row each.

    Attributes:
        observations: A batch of the observation space's.
        masks: What each one's info has as ``action_mask``; None where it has none.
        rewards: (n,) float64.
        terminated: (n,) bool.
        truncated: (n,) bool.
    """

    observations: Any
    masks: Sequence[Any]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Copies(ABC):
    """Environments of the same spaces. Whatever one of them raises is raised here, too.

    Attributes:
        observation_space: Of one.
        action_space: Of one.
        here: Those that are in this process.
    """

    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    here: "CopiesHere | None" = None

    @abstractmethod
    def step(self, actions: Any) -> Stepped:
        """Steps all of them.

        Args:
            actions: A batch of the action space's.
        """

    @abstractmethod
    def reset(
        self, which: NDArray[np.bool_], seeds: Sequence[int | None], settings: Sequence[Settings | None] | None
    ) -> Begun:
        """Begins an episode in some of them; returns what those tell.

        Args:
            which: Of all; at least one.
            seeds: One per copy.
            settings: Attributes and arguments for the episode, per copy; None leaves all as they are.
        """

    @abstractmethod
    def close(self) -> None:
        """Closes each, once."""


class CopiesHere(Copies):
    """Copies in this process.

    Args:
        make: Makes one.
        count: How many.
        wrappers: To put around each, the inmost first; the first is a ``Settable`` where settings are to come.

    Raises:
        SimulationError: They differ in their spaces.
    """

    def __init__(self, make: Callable[[], Any], count: int, wrappers: Sequence[Wrap]) -> None:
        self._closing = ExitStack()
        self.envs: list[Any] = []
        for _ in range(count):
            env = make()
            for wrap in wrappers:
                env = wrap(env)
            self._closing.callback(env.close)
            self.envs.append(env)
        self.observation_space, self.action_space = self.envs[0].observation_space, self.envs[0].action_space
        for number, env in enumerate(self.envs):
            if (env.observation_space, env.action_space) != (self.observation_space, self.action_space):
                raise SimulationError(
                    f"Copy {number} of the environment has other spaces than copy 0, but a trainer is told of one "
                    "behavior; make the spaces depend on nothing but the environment's arguments."
                )
        # Of a copy, as batches of a space make it a random generator, which would be the environment's.
        self._action_space = deepcopy(self.action_space)
        self._actions = batch_space(self._action_space, count)
        self.here = self

    def step(self, actions: Any) -> Stepped:
        """Steps one after the other."""
        steps = zip(self.envs, iterate(self._actions, actions), strict=True)
        told: Any = zip(*[env.step(action) for env, action in steps], strict=True)
        observations, rewards, terminated, truncated, infos = told
        return Stepped(
            batched(self.observation_space, observations),
            [info.get(ACTION_MASK) for info in infos],
            np.array([reward if type(reward) is float else number_of(reward) for reward in rewards]),
            np.fromiter(terminated, np.bool_),
            np.fromiter(truncated, np.bool_),
        )

    def reset(
        self, which: NDArray[np.bool_], seeds: Sequence[int | None], settings: Sequence[Settings | None] | None
    ) -> Begun:
        """Resets one after the other."""
        observations, masks = [], []
        for row in which.nonzero()[0].tolist():
            observation, info = self.begin(row, seeds[row], None if settings is None else settings[row])
            observations.append(observation)
            masks.append(info.get(ACTION_MASK))
        return Begun(batched(self.observation_space, observations), masks)

    def begin(self, row: int, seed: int | None, settings: Settings | None) -> tuple[Any, Mapping[str, Any]]:
        """Resets one; returns what it tells."""
        env = self.envs[row]
        if settings is not None:
            env.set_wrapper_attr(_SETTINGS, settings)
        began: tuple[Any, Mapping[str, Any]] = env.reset(seed=seed, options=None)
        return began

    def play(self, row: int, actions: Any, count: int) -> tuple[Any, Any, Mapping[str, Any]]:
        """Steps one alone; returns the observation, reward and info of the last step, which did not end the episode.

        Args:
            row: Which.
            actions: A batch of the action space's.
            count: How many; at least one.

        Raises:
            NotRestored: The episode ended.
        """
        observation = reward = info = None
        for action in iterate(batch_space(self._action_space, count), actions):
            observation, reward, terminated, truncated, info = self.envs[row].step(action)
            if terminated or truncated:
                raise NotRestored("played once more, an episode ends that had not")
        return observation, number_of(reward), info or {}

    def close(self) -> None:
        """Closes every one, also where another can't be closed."""
        self._closing.close()


class CopiesInProcesses(Copies):
    """Copies with a process each.

    Args:
        name: Of the environment in Gymnasium's registry.
        arguments: That each is made with.
        count: How many.
        wrappers: To put around each, the inmost first; the first is a ``Settable`` where settings are to come.
    """

    def __init__(self, name: str, arguments: Mapping[str, Any], count: int, wrappers: Sequence[Wrap]) -> None:
        made: Any = gymnasium.make_vec(
            name,
            num_envs=count,
            vectorization_mode="async",
            # Copies are reset by whoever steps them, and what they tell is read at once.
            vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED, "copy": False, "context": _context()},
            wrappers=[_leave_interrupts, *wrappers, _Told],
            disable_env_checker=True,
            **arguments,
        )
        self.vector = cast(AsyncVectorEnv, made)
        self.observation_space, self.action_space = made.single_observation_space, made.single_action_space

    def step(self, actions: Any) -> Stepped:
        """Steps all at the same time."""
        observations, rewards, terminated, truncated, info = self.vector.step(actions)
        return Stepped(observations, self._masks(info), rewards, terminated, truncated)

    def reset(
        self, which: NDArray[np.bool_], seeds: Sequence[int | None], settings: Sequence[Settings | None] | None
    ) -> Begun:
        """Resets these at the same time."""
        if settings is not None:
            self.vector.set_attr(_SETTINGS, list(settings))
        per_copy: Any = list(seeds)
        observations, info = self.vector.reset(seed=per_copy, options={"reset_mask": which})
        masks = self._masks(info)
        return Begun(_rows(observations, which), [masks[row] for row in which.nonzero()[0]])

    def close(self) -> None:
        """Ends the processes, by force where a copy is still at work."""
        try:
            self.vector.close(timeout=_CLOSING_SECONDS)
        finally:
            if not self.vector.closed:
                self.vector.closed = True  # not once more when it is forgotten
                for process in self.vector.processes:
                    process.kill()

    def _masks(self, info: Mapping[str, Any]) -> list[Any]:
        told = info.get(ACTION_MASK)
        return [None] * self.vector.num_envs if told is None else [None if each is None else each[0] for each in told]


_SETTINGS = "settings_from_trainer"  # of Settable


class Settable(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Takes up parameters when an episode begins: attributes, and arguments with which it is made anew.

    Args:
        env: The environment as it was made.
        spec: Makes it anew.
        arguments: That it was made with.
        attributes: Of the unwrapped environment that may be set.

    Attributes:
        settings_from_trainer: Those for the next episode; None leaves all as they are. No other wrapper has this name.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        spec: gymnasium.envs.registration.EnvSpec,
        arguments: Mapping[str, Any],
        attributes: tuple[str, ...],
    ) -> None:
        super().__init__(env)
        self.settings_from_trainer: Settings | None = None
        make = partial(gymnasium.make, spec, disable_env_checker=True)
        self._taker = ParameterTaker(spec.id, env, make, arguments, attributes, _spaces)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Takes up the settings first."""
        settings, self.settings_from_trainer = self.settings_from_trainer or {}, None
        self.env, seed = self._taker.take_up(self.env, settings, seed)
        return self.env.reset(seed=seed, options=options)


class _Told(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Leaves of an info what is read of it: the rest need not be alike in all copies, and no other process has it."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Without options as somebody who has none begins an episode."""
        observation, info = self.env.reset(seed=seed, options=options or None)
        check_parts(self.observation_space, observation)
        return observation, _only_mask(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """The same of a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        check_parts(self.observation_space, observation)
        return observation, number_of(reward), bool(terminated), bool(truncated), _only_mask(info)


def _only_mask(info: Mapping[str, Any]) -> dict[str, Any]:
    mask = info.get(ACTION_MASK)
    return {} if mask is None else {ACTION_MASK: [mask]}  # in a list, as a batch has no arrays of different shapes


def _rows(batch: Any, which: NDArray[np.bool_]) -> Any:
    """These rows of a batch of any space's."""
    if isinstance(batch, dict):
        return {key: _rows(part, which) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(_rows(part, which) for part in batch)
    return batch[which]


def _spaces(env: gymnasium.Env[Any, Any]) -> dict[str, object]:
    return {"observation": env.observation_space, "action": env.action_space}


def _context() -> str | None:
    """How copies' processes start: not as forks of the player, which crash with gRPC's threads and keep its socket."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return None
    multiprocessing.set_forkserver_preload(["__main__", __name__])
    return "forkserver"


def _leave_interrupts(env: Any) -> Any:
    """In a copy's own process, leaves Ctrl-C to the player, which stops the copies in order."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return env
