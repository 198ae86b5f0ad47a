"""Copies of a Gymnasium environment as training areas, an agent each."""

import difflib
import importlib
import multiprocessing
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from corridor_server.protocol.samplers import Value
from corridor_server.shared.given import shown
from corridor_server.simulations.action_choices import ActionChoices
from corridor_server.simulations.declared_parameters import DeclaredParameters, ParameterTaker
from corridor_server.simulations.observation_sensors import ACTION_MASK, WHOLE, ObservationSensors, check_finite
from corridor_server.simulations.simulation import (
    Moment,
    Simulation,
    SimulationError,
    Statistics,
    blaming,
    try_to_close,
)

CAMERA = "CameraSensor"
_CLOSING_SECONDS = 1.0  # for processes that are still at work


@dataclass(frozen=True)
class GymnasiumEnvironment:
    """A registered environment, and what is done to it.

    Attributes:
        name: Its id, such as ``CartPole-v1``; ``module:id`` imports a module first.
        arguments: Of ``gymnasium.make``.
        wrappers: ``module:name`` of wrappers to put around it, the inmost first.
        parameters: Attributes of the unwrapped environment that a trainer may set, beside numbers of ``arguments``.
        camera: Width and height of a picture of each copy, in pixels; None sends none.
        mode: ``sync``, or ``async`` with a process per copy.
    """

    name: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    wrappers: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    camera: tuple[int, int] | None = None
    mode: str = "sync"

    def check(self) -> None:
        """Makes it once, in this process.

        Raises:
            SimulationError: It can't be made, or its spaces can't be carried.
        """
        GymnasiumSimulation(replace(self, mode="sync"), 0, 1).close()

    def make(self, count: int) -> SyncVectorEnv | AsyncVectorEnv:
        """Copies of it, which are reset by whoever steps them.

        Raises:
            SimulationError: It can't be made.
        """
        name = _registered(self.name)
        arguments = dict(self.arguments)
        if self.camera is not None:
            arguments["render_mode"] = "rgb_array"
        spec = gymnasium.spec(name)
        settable: Callable[[Any], Any] = partial(_Settable, spec=spec, arguments=arguments, attributes=self.parameters)
        wrappers = [settable, *map(_wrapper, self.wrappers)]
        # Copies are reset by whoever steps them, and what they give is read at once.
        vector_arguments: dict[str, Any] = {"autoreset_mode": AutoresetMode.DISABLED, "copy": False}
        if self.mode == "async":
            wrappers.append(_leave_interrupts)
            vector_arguments["context"] = _context()
        if self.camera is not None:
            wrappers.append(partial(_Camera, size=self.camera))
        wrappers.append(_Told)
        with blaming(f"{self.name} can't be made"):
            made: Any = gymnasium.make_vec(
                name,
                num_envs=count,
                vectorization_mode=self.mode,
                vector_kwargs=vector_arguments,
                wrappers=wrappers,
                disable_env_checker=True,
                **arguments,
            )
            return cast(SyncVectorEnv | AsyncVectorEnv, made)


class GymnasiumSimulation(Simulation):
    """Copies of an environment.

    Args:
        environment: Which.
        seed: Copy i is reset with ``seed + i``; a negative one counts as 2^32 more.
        num_areas: How many.

    Raises:
        SimulationError: It can't be made, or its spaces can't be carried.
    """

    def __init__(self, environment: GymnasiumEnvironment, seed: int, num_areas: int) -> None:
        self._name = environment.name
        self._seeds: list[int | None] | None = [(seed + area) % 2**32 for area in range(num_areas)]
        numbers = [key for key, value in environment.arguments.items() if isinstance(value, int | float)]
        self._parameters = DeclaredParameters((*numbers, *environment.parameters), range(num_areas))
        self._set = False  # whether a parameter was
        self._envs = environment.make(num_areas)
        self._sensors = ObservationSensors(self._envs.single_observation_space, self._name)
        self._choices = ActionChoices(self._envs.single_action_space, self._name)
        behavior = f"{self._name.rpartition(':')[2]}?team=0"
        self._behavior = Behavior(behavior, self._sensors.sensors, self._choices.continuous, self._choices.branches)
        self._ids = np.arange(num_areas, dtype=np.int32)
        self._last: Agents | None = None  # who ask
        self._masked = False  # whether it ever gave a mask in its info
        # Copies whose running episode began by itself at the last one's end, and has not moved yet.
        self._begun_by_end = np.zeros(num_areas, np.bool_)

    @property
    def behaviors(self) -> Mapping[str, Behavior]:
        """The one of all copies."""
        return {self._behavior.name: self._behavior}

    def set_parameter(self, name: str, value: Value) -> None:
        """Sets an argument or an attribute, from the next episode on."""
        if self._parameters.set(name, value):
            self._set = True
            self._begun_by_end[:] = False

    def reset(self) -> Moment:
        """Begins an episode in every copy, but where one has just begun by itself."""
        if self._last is None or not self._begun_by_end.all():
            observations, masks = self._begin(~self._begun_by_end, () if self._last is None else self._last.masks)
            self._last = Agents.that_ask(self._ids, observations, np.zeros(len(self._ids)), masks)
        self._begun_by_end[:] = False
        return {self._behavior.name: self._last}

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Steps every copy, and resets those whose episode ended."""
        batch = self._choices.read(actions[self._behavior.name])
        with blaming(f"{self._name} failed in a step"):
            batched, rewards, terminated, truncated, info = self._envs.step(batch)
            observations, masks = self._read(batched, info)
        ended = terminated | truncated
        with np.errstate(over="ignore"):
            got = rewards.astype(np.float32)
        check_finite(got, "a reward", self._ids)
        agents = Agents.that_ask(self._ids, observations, got, masks)
        self._begun_by_end = ended
        if ended.any():
            agents = self._with_ended(agents, ended, truncated & ~terminated)
        self._last = agents.deciding
        return {self._behavior.name: agents}, {}

    def close(self) -> None:
        """Closes every copy."""
        if not try_to_close(self._name, partial(self._envs.close, timeout=_CLOSING_SECONDS)):
            self._envs.closed = True  # not once more when it is forgotten
            for process in getattr(self._envs, "processes", ()):
                process.kill()

    def _with_ended(self, last: Agents, ended: NDArray[np.bool_], interrupted: NDArray[np.bool_]) -> Agents:
        """Puts those that ended before all, which are in their next episode where they did."""
        observations, masks = self._begin(ended, last.masks)
        seen = tuple(values[ended] for values in last.observations)
        over = Agents.that_ended(self._ids[ended], seen, last.rewards[ended], interrupted[ended])
        return over.then(Agents.that_ask(self._ids, observations, np.where(ended, 0, last.rewards), masks))

    def _begin(
        self, which: NDArray[np.bool_], masks: tuple[NDArray[np.bool_], ...]
    ) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[np.bool_], ...]]:
        """Resets these copies; returns what all observe, and their masks, which were ``masks`` before."""
        with blaming(f"{self._name} failed in a reset"):
            if self._set:
                settings = [self._parameters.draw(row) if which[row] else None for row in range(len(which))]
                self._envs.set_attr("settings_from_trainer", settings)
            seeds: Any = self._seeds
            batched, info = self._envs.reset(seed=seeds, options={"reset_mask": which})
            observations, begun = self._read(batched, info)
        self._seeds = None  # a later episode goes on with its random numbers
        return observations, tuple(
            np.where(which[:, None], new, old) for old, new in zip(masks or begun, begun, strict=True)
        )

    def _read(self, batched: Any, info: Mapping[str, Any]) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[Any], ...]]:
        observations = self._sensors.read(batched)
        for sensor, values in zip(self._sensors.sensors, observations, strict=True):
            if values.dtype == np.float32:
                check_finite(values, sensor.name, self._ids)
        return observations, self._masks(batched, info)

    def _masks(self, batched: Any, info: Mapping[str, Any]) -> tuple[NDArray[np.bool_], ...]:
        if not self._choices.branches:
            return ()
        allowed = self._sensors.mask(batched)
        said = info.get(ACTION_MASK, ())
        self._masked |= len(said) > 0
        if allowed is None and self._masked:
            allowed = np.ones((len(self._ids), sum(self._choices.branches)), np.bool_)  # who says nothing may do all
            for row, given in enumerate(said):
                if given is not None:
                    mask = np.hstack(given[0])  # some have one per branch
                    self._choices.check_mask(mask)
                    allowed[row] = mask
        return () if allowed is None else self._choices.forbidden(allowed)


class _Settable(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Takes up parameters when an episode begins: attributes, and arguments with which it is made anew.

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
        self.settings_from_trainer: Mapping[str, float] | None = None
        make = partial(gymnasium.make, spec, disable_env_checker=True)
        self._taker = ParameterTaker(spec.id, env, make, arguments, attributes, _spaces)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Takes up the settings first."""
        settings, self.settings_from_trainer = self.settings_from_trainer or {}, None
        self.env, seed = self._taker.take_up(self.env, settings, seed)
        return self.env.reset(seed=seed, options=options)


def _spaces(env: gymnasium.Env[Any, Any]) -> dict[str, object]:
    return {"observation": env.observation_space, "action": env.action_space}


class _Told(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Leaves of an info what is read of it: the rest need not be alike in all copies, and no other process has it."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Without options as somebody who has none begins an episode."""
        observation, info = self.env.reset(seed=seed, options=options or None)
        return observation, _only_mask(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """The same of a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if type(reward) is not float:
            reward = float(np.asarray(reward, np.float64).reshape(()))  # some say [1.0]
        return observation, reward, terminated, truncated, _only_mask(info) if info else info


def _only_mask(info: Mapping[str, Any]) -> dict[str, Any]:
    mask = info.get(ACTION_MASK)
    return {} if mask is None else {ACTION_MASK: [mask]}  # in a list, as a batch has no arrays of different shapes


def _context() -> str | None:
    """How copies' processes start: not as forks of the player, which crash with gRPC's threads and keep its socket."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return None
    multiprocessing.set_forkserver_preload(["__main__", __name__])
    return "forkserver"


def _leave_interrupts(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """In a copy's own process, leaves Ctrl-C to the player, which stops the copies in order."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return env


class _Camera(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Adds the rendered picture to what is observed, scaled to a size: each pixel is the mean of those that it covers.

    Args:
        env: Rendered as ``rgb_array``.
        size: Width and height, in pixels.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], size: tuple[int, int]) -> None:
        super().__init__(env)
        self._size = size
        inner = env.observation_space
        self._parts = dict(inner.spaces) if isinstance(inner, spaces.Dict) else None
        picture = spaces.Box(0, 255, (size[1], size[0], 3), np.uint8)
        others = {WHOLE: inner} if self._parts is None else self._parts
        self.observation_space = spaces.Dict({CAMERA: picture, **others})

    def observation(self, observation: Any) -> dict[str, Any]:
        """With the picture."""
        others = {WHOLE: observation} if self._parts is None else observation
        return {CAMERA: _scaled(np.asarray(self.env.render()), self._size), **others}


def _scaled(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[np.uint8]:
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise SimulationError(
            f"--camera: the environment renders {picture.dtype} of shape {picture.shape}, but uint8 of shape (height, "
            "width, 3) was expected."
        )
    scaled = picture.astype(np.float32)
    for axis, wanted in ((0, size[1]), (1, size[0])):
        edges = np.arange(wanted) * scaled.shape[axis] // wanted
        widths = np.maximum(np.diff(np.append(edges, scaled.shape[axis])), 1)
        scaled = np.add.reduceat(scaled, edges, axis=axis) / np.expand_dims(widths, tuple({0, 1, 2} - {axis}))
    return scaled.round().astype(np.uint8)


def _registered(name: str) -> str:
    """The id's name in Gymnasium's registry, once its module was imported."""
    module, _, registered = name.rpartition(":")
    if module:
        with blaming(f"The module of --gym {shown(name)} can't be imported"):
            imported = importlib.import_module(module)
        register = getattr(imported, "register_envs", None)
        if registered not in gymnasium.registry and callable(register):
            register()  # some packages don't register by being imported
    try:
        gymnasium.spec(registered)
    except gymnasium.error.DeprecatedEnv as error:
        raise SimulationError(f"--gym is {shown(name)}: {error}") from None
    except gymnasium.error.Error:
        near = difflib.get_close_matches(registered[:100], gymnasium.registry, n=3, cutoff=0.5)
        hint = f"the nearest are {', '.join(near)}" if near else "give MODULE:ID for one that a package registers"
        raise SimulationError(f"--gym is {shown(name)}, but no such environment is registered; {hint}.") from None
    return registered


def _wrapper(name: str) -> Callable[[Any], Any]:
    module, _, attribute = name.rpartition(":")
    with blaming(f"--wrapper is {shown(name)}, but MODULE:NAME of a wrapper was expected"):
        found: Callable[[Any], Any] = getattr(importlib.import_module(module), attribute)
    return found
