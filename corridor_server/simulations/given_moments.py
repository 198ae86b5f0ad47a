"""What a simulation of somebody's own gives, which may be anything: refused in a sentence, or as it travels."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.shared.given import shown
from corridor_server.simulations.finite_numbers import check_finite, float32
from corridor_server.simulations.simulation import MOST_CHOICES, MOST_NUMBERS, Moment, SimulationError, Statistics

_MOST_ID = 2**31 - 1
_NUMBERS = "fiub"  # kinds of types that are numbers


def check_behavior(name: object, behavior: object) -> None:
    """Refuses what no trainer can be told of.

    Args:
        name: Under which ``behaviors`` has it.
        behavior: It.

    Raises:
        SimulationError: It can't be carried.
    """
    if not isinstance(behavior, Behavior):
        raise SimulationError(f"behaviors has {shown(behavior)} as {shown(name)}, but a Behavior was expected.")
    if behavior.name != name or not _is_name(name):
        raise SimulationError(
            f"behaviors has the Behavior {shown(behavior.name)} as {shown(name)}, but its own name was expected, such "
            "as 'Hallway?team=0'."
        )
    sensors, branches = behavior.sensors, behavior.discrete_branches
    if not isinstance(sensors, tuple) or not sensors or not all(isinstance(each, Sensor) for each in sensors):
        raise SimulationError(
            f"Behavior {name} has sensors = {shown(sensors)}, but a tuple of at least one Sensor was expected."
        )
    for sensor in sensors:
        if not _is_name(sensor.name):
            raise SimulationError(f"A sensor of {name} is called {shown(sensor.name)}, but a name was expected.")
        if not _are_whole(sensor.shape) or not 1 <= math.prod(sensor.shape) <= MOST_NUMBERS:
            raise SimulationError(
                f"Sensor {sensor.name} of {name} has shape = {shown(sensor.shape)}, but a tuple of whole numbers was "
                f"expected, and at most {MOST_NUMBERS} numbers in all."
            )
        if not _are_whole(sensor.dimension_properties) or not _are_whole((sensor.kind,)):
            raise SimulationError(
                f"Sensor {sensor.name} of {name} has dimension_properties = {shown(sensor.dimension_properties)} and "
                f"kind = {shown(sensor.kind)}, but a tuple of whole numbers and one were expected; make it with "
                "Sensor.of."
            )
    if not _are_whole(branches) or 0 in branches:
        raise SimulationError(
            f"Behavior {name} has discrete_branches = {shown(branches)}, but a tuple of each branch's number of "
            "choices was expected, such as (2,)."
        )
    size = behavior.continuous_actions
    if not _are_whole((size,)) or not 1 <= size + sum(branches) <= MOST_CHOICES:
        raise SimulationError(
            f"Behavior {name} has continuous_actions = {shown(size)} and discrete_branches = {shown(branches)}, but "
            f"whole numbers were expected, and 1 to {MOST_CHOICES} numbers and choices in all."
        )


def read_moment(given: object, behaviors: Mapping[str, Behavior], when: str) -> Moment:
    """The moment, with every number in the type that it travels in.

    Args:
        given: By a simulation.
        behaviors: That were declared.
        when: ``reset`` or ``step``.

    Raises:
        SimulationError: Something of it can't be sent, or means nothing to a trainer.
    """
    if not isinstance(given, Mapping):
        raise SimulationError(
            f"The simulation's {when} gave {_kind(given)}, but a moment was expected: a dict of Agents by their "
            "behavior's name."
        )
    moment: dict[str, Agents] = {}
    owners: dict[int, str] = {}
    for name, agents in given.items():
        if name not in behaviors:
            raise SimulationError(
                f"The simulation's {when} gave agents of {shown(name)}, but its behaviors are "
                f"{', '.join(behaviors) or 'none'}; declare it there."
            )
        if not isinstance(agents, Agents):
            raise SimulationError(f"The simulation's {when} gave {_kind(agents)} for {name}, but Agents were expected.")
        if not isinstance(agents.ids, np.ndarray) or len(agents.ids):
            moment[name] = _agents(behaviors[name], agents)
    if len(moment) > 1:
        for name, agents in moment.items():
            _check_owners(name, agents, owners)
    asking = sum(len(agents.deciding) for agents in moment.values())
    if when == "reset" and (not asking or asking < sum(map(len, moment.values()))):
        raise SimulationError(
            f"The simulation's reset gave {asking} agents that ask and "
            f"{sum(map(len, moment.values())) - asking} that ended, but at least one that asks and none that ended "
            "were expected."
        )
    if not moment:
        raise SimulationError(
            f"The simulation's {when} gave a moment without agents, but one in which somebody asks or ended was "
            "expected; go on until there is one."
        )
    return moment


def read_told(given: object, behaviors: Mapping[str, Behavior]) -> tuple[Moment, Statistics]:
    """What a step told: the moment, as ``read_moment`` has it, and the statistics, as arrays of finite numbers.

    Raises:
        SimulationError: Something of it can't be sent, or means nothing to a trainer.
    """
    if not isinstance(given, tuple) or len(given) != 2:
        raise SimulationError(
            f"The simulation's step gave {_kind(given)}, but a tuple of its moment and its statistics was expected, "
            "such as (moment, {})."
        )
    return read_moment(given[0], behaviors, "step"), _statistics(given[1])


def _agents(behavior: Behavior, given: Agents) -> Agents:
    name = behavior.name
    ids = given.ids
    if not isinstance(ids, np.ndarray) or ids.ndim != 1:
        raise SimulationError(f"The simulation gave ids of {name} as {_kind(ids)}, but an array of (n,) was expected.")
    one_each = (len(ids),)
    ids = _whole(_array(ids, f"ids of {name}", one_each, "iu", "whole numbers were"), f"an id of {name}")
    done = _array(given.done, f"done of {name}", one_each, "b", "bool was")
    for ended, what in ((False, "asks"), (True, "ended")):
        mine = np.sort(ids[done == ended])
        for twice in mine[1:][mine[1:] == mine[:-1]][:1]:
            raise SimulationError(
                f"The simulation gave agent {twice} of {name} twice as one that {what}, but once in a moment was "
                "expected; give each agent an id of its own."
            )
    groups = _array(given.group_ids, f"group_ids of {name}", one_each, "iu", "whole numbers were")
    return Agents(
        ids,
        _floats(given.rewards, "a reward", "rewards", one_each, ids, name),
        done,
        _array(given.interrupted, f"interrupted of {name}", one_each, "b", "bool was"),
        _observations(behavior, given, ids),
        _whole(groups, f"a group id of {name}"),
        _floats(given.group_rewards, "a group reward", "group_rewards", one_each, ids, name),
        _masks(behavior, given, ids, done),
    )


def _observations(behavior: Behavior, given: Agents, ids: NDArray[np.int32]) -> tuple[NDArray[Any], ...]:
    name, sensors = behavior.name, behavior.sensors
    if not isinstance(given.observations, tuple) or len(given.observations) != len(sensors):
        raise SimulationError(
            f"The simulation gave observations of {name} as {_kind(given.observations)}, but a tuple of an array for "
            f"each of its {len(sensors)} sensors was expected, such as (values,)."
        )
    read: list[NDArray[Any]] = []
    for sensor, values in zip(sensors, given.observations, strict=True):
        what, shape = f"observation {sensor.name}", (len(ids), *sensor.shape)
        if sensor.is_picture and getattr(values, "dtype", None) == np.uint8:
            read.append(_array(values, f"{what} of {name}", shape, "u", "numbers were"))
        else:
            read.append(_floats(values, what, what, shape, ids, name))
    return tuple(read)


def _masks(
    behavior: Behavior, given: Agents, ids: NDArray[np.int32], done: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], ...]:
    name, branches = behavior.name, behavior.discrete_branches
    if not isinstance(given.masks, tuple) or len(given.masks) not in (0, len(branches)):
        raise SimulationError(
            f"The simulation gave masks of {name} as {_kind(given.masks)}, but a tuple of an array for each of its "
            f"{len(branches)} branches was expected, or () where nothing is forbidden."
        )
    for branch, (choices, mask) in enumerate(zip(branches, given.masks, strict=False)):
        what, expected = f"masks[{branch}] of {name}", "bool, True for a choice that is forbidden, was"
        _array(mask, what, (len(ids), choices), "b", expected)
        for row in np.flatnonzero(mask.all(axis=1) & ~done)[:1]:
            raise SimulationError(
                f"The simulation gave agent {ids[row]} of {name} a mask that forbids all choices of branch {branch}, "
                "but at least one that is allowed was expected: True is for a choice that is forbidden."
            )
    return given.masks


def _statistics(given: object) -> Statistics:
    if not isinstance(given, Mapping):
        raise SimulationError(
            f"The simulation's step gave {_kind(given)} as its statistics, but a dict of arrays by name was expected; "
            "{} has none."
        )
    statistics: dict[str, NDArray[np.float64]] = {}
    for name, values in given.items():
        numbers = np.asarray(values)
        of_all = {len(each) for each in statistics.values()}
        if not _is_name(name) or numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in _NUMBERS):
            raise SimulationError(
                f"The simulation's step gave the statistic {shown(name)} = {shown(values)}, but a name and an array of "
                "a number for each episode that ended were expected."
            )
        if of_all and len(numbers) not in of_all:
            raise SimulationError(
                f"The simulation's step gave {len(numbers)} numbers of the statistic {name}, but {of_all.pop()} of "
                f"{next(iter(statistics))}; one for each episode that ended was expected of all."
            )
        statistics[name] = numbers.astype(np.float64)
        if not np.isfinite(float32(statistics[name])).all():
            raise SimulationError(
                f"The simulation's step gave the statistic {name} = {shown(numbers.tolist())}, but finite numbers that "
                "float32 can hold were expected."
            )
    return statistics


def _floats(
    given: object, one: str, every: str, shape: tuple[int, ...], ids: NDArray[np.int32], name: str
) -> NDArray[np.float32]:
    values = _array(given, f"{every} of {name}", shape, _NUMBERS, "numbers were")
    numbers = values if values.dtype == np.float32 else float32(values)
    check_finite(numbers, one, ids, values, name)
    return numbers


def _whole(values: NDArray[Any], what: str) -> NDArray[np.int32]:
    for number in values[(values < 0) | (values > _MOST_ID)][:1]:
        raise SimulationError(f"The simulation gave {what} = {number}, but 0 to {_MOST_ID} was expected.")
    return values.astype(np.int32)


def _array(values: object, what: str, shape: tuple[int, ...], kinds: str, expected: str) -> NDArray[Any]:
    if not isinstance(values, np.ndarray):
        raise SimulationError(f"The simulation gave {what} as {_kind(values)}, but a NumPy array was expected.")
    if values.shape != shape:
        raise SimulationError(
            f"The simulation gave {what} of shape {values.shape}, but {shape} was expected: a row for each of "
            f"{shape[0]} agents."
        )
    if values.dtype.kind not in kinds:
        raise SimulationError(f"The simulation gave {what} of {values.dtype}, but {expected} expected.")
    return values


def _check_owners(name: str, agents: Agents, owners: dict[int, str]) -> None:
    """Refuses an id that agents of two behaviors have."""
    mine = set(agents.ids.tolist())
    for shared in sorted(mine & owners.keys())[:1]:
        raise SimulationError(
            f"The simulation has an agent {shared} of {owners[shared]} and one of {name}, but ids that are unique over "
            "all behaviors were expected; number each behavior's after those of the one before."
        )
    owners |= dict.fromkeys(mine, name)


def _is_name(given: object) -> bool:
    return isinstance(given, str) and bool(given) and given.isprintable()


def _are_whole(given: object) -> bool:
    """Whether it is a tuple of whole numbers from 0."""
    return isinstance(given, tuple) and all(
        isinstance(each, int | np.integer) and not isinstance(each, bool) and 0 <= each <= _MOST_ID for each in given
    )


def _kind(given: object) -> str:
    """What it is, in a word or two."""
    if given is None:
        return "None"
    size = f" of {len(given)}" if isinstance(given, tuple | list) else ""
    return f"a {type(given).__name__}{size}"
