"""Copies of a Gymnasium environment as training areas, an agent each."""

import difflib
import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from corridor_server.protocol.samplers import Value
from corridor_server.protocol.side_channels import OF_ANY_LENGTH
from corridor_server.shared.given import shown
from corridor_server.simulations.action_choices import ActionChoices
from corridor_server.simulations.declared_parameters import DeclaredParameters
from corridor_server.simulations.environment_memory import Memory
from corridor_server.simulations.finite_numbers import check_finite, float32
from corridor_server.simulations.gymnasium_copies import (
    Copies,
    CopiesHere,
    CopiesInProcesses,
    Settable,
    Settings,
    Wrap,
)
from corridor_server.simulations.observation_sensors import (
    ACTION_MASK,
    WHOLE,
    ObservationSensors,
    batched,
)
from corridor_server.simulations.running_episodes import PlaysAgain, RunningEpisodes
from corridor_server.simulations.simulation import (
    Moment,
    NotRestored,
    SimulationError,
    Statistics,
    blaming,
    try_to_close,
)

CAMERA = "CameraSensor"


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

    @property
    def declared(self) -> tuple[str, ...]:
        """All that a trainer may set: arguments that are numbers, and ``parameters``."""
        numbers = [key for key, value in self.arguments.items() if isinstance(value, int | float)]
        return (*numbers, *self.parameters)

    def check(self) -> Mapping[str, Behavior]:
        """Makes it once, in this process; returns its behavior by its full name.

        Raises:
            SimulationError: It can't be made, or its spaces can't be carried.
        """
        simulation = GymnasiumSimulation(replace(self, mode="sync"), 0, 1)
        simulation.close()
        return simulation.behaviors

    def make(self, count: int) -> Copies:
        """Copies of it, which are reset by whoever steps them.

        Raises:
            SimulationError: It can't be made.
        """
        name = _registered(self.name)
        arguments = dict(self.arguments)
        if self.camera is not None:
            arguments["render_mode"] = "rgb_array"
        spec = gymnasium.spec(name)
        wrappers = [_wrapper(each) for each in self.wrappers]
        if self.declared:
            wrappers.insert(0, partial(Settable, spec=spec, arguments=arguments, attributes=self.parameters))
        if self.camera is not None:
            wrappers.append(partial(_Camera, size=self.camera))
        with blaming(f"{self.name} can't be made"):
            if self.mode == "async":
                return CopiesInProcesses(name, arguments, count, wrappers)
            return CopiesHere(partial(gymnasium.make, name, disable_env_checker=True, **arguments), count, wrappers)


class GymnasiumSimulation(PlaysAgain):
    """Copies of an environment.

    Args:
        environment: Which.
        seed: Copy i is reset with ``seed + i``; a negative one counts as 2^32 more.
        num_areas: How many.

    Raises:
        SimulationError: It can't be made, or its spaces can't be carried.
    """

    def __init__(self, environment: GymnasiumEnvironment, seed: int, num_areas: int) -> None:
        self._name, self._environment = environment.name, environment
        self._seeds = [(seed + area) % 2**32 for area in range(num_areas)]
        self._parameters = DeclaredParameters(environment.declared, range(num_areas))
        self._set = False  # whether a parameter was
        self._copies, self._episodes = self._made(num_areas)
        self._sensors = ObservationSensors(self._copies.observation_space, self._name)
        self._choices = ActionChoices(self._copies.action_space, self._name)
        behavior = f"{self._name.rpartition(':')[2]}?team=0"
        self._behavior = Behavior(behavior, self._sensors.sensors, self._choices.continuous, self._choices.branches)
        self._ids = np.arange(num_areas, dtype=np.int32)  # the copies' rows, too
        self._last: Agents | None = None  # of the last moment
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
            self._begun_by_end[:] = self.restored = False

    def reset(self) -> Moment:
        """Begins an episode in every copy, but where one has just begun by itself."""
        which = ~self._begun_by_end & (not self.restored)
        if self._last is None:
            observations, masks = self._begin(which)
            self._last = Agents.that_ask(self._ids, observations, np.zeros(len(self._ids)), masks)
        else:
            self._last = self._last.deciding
            if which.any():
                self._last = _replaced(self._last.rows(self._ids), which, *self._begin(which))
        self._begun_by_end[:] = False
        return {self._behavior.name: self._last}

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Steps every copy, and resets those whose episode ended."""
        self.restored = False
        if self._episodes is not None:
            self._episodes.act({self._behavior.name: self._ids}, actions)
        batch = self._choices.read(actions[self._behavior.name])
        with blaming(f"{self._name} failed in a step"):
            told = self._copies.step(batch)
            ended = told.terminated | told.truncated
            observations, masks = self._read(told.observations, told.masks, self._ids, ended)
        rewards = float32(told.rewards)
        check_finite(rewards, "a reward", self._ids, told.rewards)
        agents = Agents.that_ask(self._ids, observations, rewards, masks)
        self._begun_by_end = ended
        if ended.any():
            agents = self._with_ended(agents, ended, told.truncated & ~told.terminated)
        self._last = agents
        return {self._behavior.name: agents}, {}

    def snapshot(self) -> NDArray[np.void] | None:
        """The running episodes, to be played again; None where copies have processes, or it can't be done."""
        if self._episodes is None:
            return None
        if self._last is None:
            return np.empty(0, OF_ANY_LENGTH)
        extra = {"masked": self._masked, "parameters": self._parameters.state()}
        return self._episodes.snapshot({self._behavior.name: self._last.deciding}, extra)

    def close(self) -> None:
        """Closes every copy."""
        try_to_close(self._name, self._copies.close)

    def _play_again(self, rows: NDArray[np.void]) -> None:
        if self._last is not None:
            self._renew()
        here, episodes = self._copies.here, self._episodes
        if here is None or episodes is None:
            raise NotRestored("its copies have processes of their own")
        count = len(self._ids)
        told: list[tuple[Any, Any, Mapping[str, Any]]] = [(None, 0.0, {})] * count

        def begin(row: int, seed: int | None, settings: Settings | None) -> None:
            observation, info = here.begin(row, seed, settings)
            told[row] = observation, 0.0, info

        acted, saved = episodes.take_up(rows, begin)
        for row in range(count):
            for done in acted.values():
                mine = done.of([row], episodes.began_at(row))
                if len(mine.ids):
                    told[row] = here.play(row, self._choices.read(mine.actions), len(mine.ids))
        self._masked = saved["masked"]
        batch = batched(self._copies.observation_space, [observation for observation, _, _ in told])
        said = [info.get(ACTION_MASK) for _, _, info in told]
        observations, masks = self._read(batch, said, self._ids, np.zeros(count, np.bool_))
        last = Agents.that_ask(self._ids, observations, [reward for _, reward, _ in told], masks)
        episodes.check({self._behavior.name: last}, saved)
        self._parameters.restore(saved["parameters"])
        self._last, self._seeds = last, [None] * count

    def _renew(self) -> None:
        """Makes the copies anew."""
        self.close()
        self._copies, self._episodes = self._made(len(self._ids))
        self._last, self._masked = None, False

    def _made(self, count: int) -> tuple[Copies, RunningEpisodes | None]:
        made, of = self._environment.make(count), self._environment
        if made.here is None:
            return made, None
        identity = (of.name, sorted(of.arguments.items()), of.wrappers, of.parameters, of.camera)
        return made, RunningEpisodes(identity, [Memory(partial(tuple, [env])) for env in made.here.envs])

    def _with_ended(self, last: Agents, ended: NDArray[np.bool_], interrupted: NDArray[np.bool_]) -> Agents:
        """Puts those that ended before all, which are in their next episode where they did."""
        rows = ended.nonzero()[0]
        count = len(rows)
        agents = last.rows(np.concatenate([rows, self._ids]))
        agents.done[:count] = True
        agents.interrupted[:count] = interrupted[rows]
        return _replaced(agents, count + rows, *self._begin(ended))

    def _begin(self, which: NDArray[np.bool_]) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[np.bool_], ...]]:
        """Resets these copies; returns what they observe, and their masks."""
        with blaming(f"{self._name} failed in a reset"):
            settings = None
            if self._set:
                settings = [self._parameters.draw(row) if which[row] else None for row in range(len(which))]
            if self._episodes is not None:
                for row in which.nonzero()[0].tolist():
                    self._episodes.begin(row, self._seeds[row], None if settings is None else settings[row])
            told = self._copies.reset(which, self._seeds, settings)
            ids = self._ids[which]
            begun = self._read(told.observations, told.masks, ids, np.zeros(len(ids), np.bool_))
        self._seeds = [None] * len(which)  # a later episode goes on with its random numbers
        return begun

    def _read(
        self, batch: Any, said: Sequence[Any], ids: NDArray[np.int32], ended: NDArray[np.bool_]
    ) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[np.bool_], ...]]:
        """Observations and masks of the agents of these ids, some of which may have ended."""
        observations = self._sensors.read(batch, ids)
        if not self._choices.branches:
            return observations, ()
        allowed = self._sensors.mask(batch)
        self._masked |= any(mask is not None for mask in said)
        if allowed is None and self._masked:
            allowed = self._choices.allowed(said)
        return observations, () if allowed is None else self._choices.forbidden(allowed, ids, ended)


def _replaced(
    agents: Agents, rows: NDArray[Any], observations: tuple[NDArray[Any], ...], masks: tuple[NDArray[np.bool_], ...]
) -> Agents:
    """The agents, written over in these rows, where an episode begins."""
    if len(agents.masks) < len(masks):  # it gives its first ones
        agents = replace(agents, masks=tuple(np.zeros((len(agents), each.shape[1]), np.bool_) for each in masks))
    agents.rewards[rows] = 0
    for values, begun in zip((*agents.observations, *agents.masks), (*observations, *masks), strict=True):
        values[rows] = begun
    return agents


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


def _wrapper(name: str) -> Wrap:
    module, _, attribute = name.rpartition(":")
    with blaming(f"--wrapper is {shown(name)}, but MODULE:NAME of a wrapper was expected"):
        found: Wrap = getattr(importlib.import_module(module), attribute)
    return found
