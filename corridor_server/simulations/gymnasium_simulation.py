"""Copies of a Gymnasium environment as training areas, an agent each."""

import difflib
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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
from corridor_server.simulations.declared_parameters import DeclaredParameters, like
from corridor_server.simulations.observation_sensors import ACTION_MASK, WHOLE, ObservationSensors, check_finite
from corridor_server.simulations.simulation import Moment, Simulation, SimulationError, Statistics, failed

CAMERA = "CameraSensor"
MODES = ("sync", "async")


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
        """Makes it once.

        Raises:
            SimulationError: It can't be made, or its spaces can't be carried.
        """
        GymnasiumSimulation(self, 0, 1).close()

    def make(self, count: int) -> SyncVectorEnv | AsyncVectorEnv:
        """Copies of it, which are reset by whoever steps them.

        Raises:
            SimulationError: It can't be made.
        """
        name = _registered(self.name)
        arguments = dict(self.arguments)
        if self.camera is not None:
            arguments["render_mode"] = "rgb_array"
        settable: Callable[[Any], Any] = partial(_Settable, name=name, arguments=arguments, attributes=self.parameters)
        wrappers = [settable, *map(_wrapper, self.wrappers)]
        if self.camera is not None:
            wrappers.append(partial(_Camera, size=self.camera))
        try:
            made: Any = gymnasium.make_vec(
                name,
                num_envs=count,
                vectorization_mode=self.mode,
                vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED, "copy": False},  # it is read at once
                wrappers=wrappers,
                disable_env_checker=True,
                **arguments,
            )
            return cast(SyncVectorEnv | AsyncVectorEnv, made)
        except SimulationError:
            raise
        except Exception as error:  # whatever an author's code raises
            raise failed(f"{self.name} can't be made", error) from error


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
        self._masked: bool | None = None  # known from its first reset on
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
            nothing, nobody = np.zeros(len(self._ids), np.float32), np.zeros(len(self._ids), np.bool_)
            self._last = Agents.ungrouped(self._ids, nothing, nobody, nobody, observations, masks)
        self._begun_by_end[:] = False
        return {self._behavior.name: self._last}

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Steps every copy, and resets those whose episode ended."""
        batch = self._choices.read(actions[self._behavior.name])
        try:
            batched, rewards, terminated, truncated, info = self._envs.step(batch)
        except Exception as error:  # whatever an author's code raises
            raise failed(f"{self._name} failed in a step", error) from error
        ended = terminated | truncated
        observations, masks = self._read(batched, info)
        got = rewards.astype(np.float32)
        check_finite(got, "a reward", self._ids)
        nobody = np.zeros(len(self._ids), np.bool_)
        agents = Agents.ungrouped(self._ids, got, nobody, nobody, observations, masks)
        self._begun_by_end = ended
        if ended.any():
            agents = self._with_ended(agents, ended, truncated & ~terminated)
        self._last = agents.deciding
        return {self._behavior.name: agents}, {}

    def close(self) -> None:
        """Closes every copy."""
        self._envs.close()

    def _with_ended(self, last: Agents, ended: NDArray[np.bool_], interrupted: NDArray[np.bool_]) -> Agents:
        """Puts those that ended before all, which are in their next episode where they did."""
        observations, masks = self._begin(ended, last.masks)
        rows = np.flatnonzero(ended)
        done, cut = np.zeros((2, len(rows) + len(ended)), np.bool_)
        done[: len(rows)] = True
        cut[: len(rows)] = interrupted[rows]
        return Agents.ungrouped(
            np.concatenate([self._ids[rows], self._ids]),
            np.concatenate([last.rewards[rows], np.where(ended, np.float32(0), last.rewards)]),
            done,
            cut,
            tuple(np.concatenate([old[rows], new]) for old, new in zip(last.observations, observations, strict=True)),
            tuple(np.concatenate([np.zeros_like(new[rows]), new]) for new in masks),
        )

    def _begin(
        self, which: NDArray[np.bool_], masks: tuple[NDArray[np.bool_], ...]
    ) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[np.bool_], ...]]:
        """Resets these copies; returns what all observe, and their masks, which were ``masks`` before."""
        try:
            if self._set:
                settings = [self._parameters.draw(row) if which[row] else None for row in range(len(which))]
                self._envs.set_attr("settings", settings)
            seeds: Any = self._seeds
            batched, info = self._envs.reset(seed=seeds, options={"reset_mask": which})
        except SimulationError:
            raise
        except Exception as error:  # whatever an author's code raises
            raise failed(f"{self._name} failed in a reset", error) from error
        self._seeds = None  # a later episode goes on with its random numbers
        observations, begun = self._read(batched, info)
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
        allowed = self._sensors.mask(batched)
        if allowed is None and ACTION_MASK in info and self._choices.branches:
            said = info[f"_{ACTION_MASK}"]
            allowed = np.ones((len(said), sum(self._choices.branches)), np.bool_)  # who said nothing may do anything
            for row in np.flatnonzero(said):
                mask = np.hstack(info[ACTION_MASK][row])  # some have one per branch
                self._choices.check_mask(mask)
                allowed[row] = mask
        if self._masked is None:
            self._masked = allowed is not None
        if allowed is None and self._masked:
            allowed = np.ones((len(self._ids), sum(self._choices.branches)), np.bool_)
        if allowed is not None and not self._masked:
            raise SimulationError(f"{self._name} gave its first action_mask after it had begun without one.")
        return () if allowed is None else self._choices.forbidden(allowed)


class _Settable(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Takes up parameters when an episode begins: attributes, and arguments with which it is made anew.

    Attributes:
        settings: Those for the next episode; None leaves all as they are.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], name: str, arguments: Mapping[str, Any], attributes: tuple[str, ...]
    ) -> None:
        super().__init__(env)
        self.settings: Mapping[str, float] | None = None
        self._name, self._arguments, self._attributes = name, dict(arguments), attributes
        for attribute in attributes:
            if not isinstance(getattr(env.unwrapped, attribute, None), int | float):
                raise SimulationError(
                    f"--parameters names {shown(attribute)}, but {name} has no such number; give an attribute of the "
                    "unwrapped environment."
                )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Takes up the settings first."""
        settings, self.settings = self.settings or {}, None
        arguments = {name: value for name, value in settings.items() if name not in self._attributes}
        changed = {name: like(self._arguments[name], value) for name, value in arguments.items()}
        if changed and {**self._arguments, **changed} != self._arguments:
            self._arguments |= changed
            if seed is None:
                seed = int(self.env.unwrapped.np_random.integers(2**31))
            self.env.close()
            self.env = gymnasium.make(self._name, disable_env_checker=True, **self._arguments)
        for name in settings.keys() - arguments.keys():
            unwrapped = self.env.unwrapped
            setattr(unwrapped, name, like(getattr(unwrapped, name), settings[name]))
        return self.env.reset(seed=seed, options=options)


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
        try:
            imported = importlib.import_module(module)
        except Exception as error:  # whatever an author's code raises
            raise failed(f"The module of --gym {shown(name)} can't be imported", error) from error
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
    try:
        found: Callable[[Any], Any] = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # whatever an author's code raises
        raise failed(f"--wrapper is {shown(name)}, but MODULE:NAME of a wrapper was expected", error) from error
    return found
