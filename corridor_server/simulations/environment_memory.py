"""What an author's objects remember from one episode to the next, as far as it can be seen from outside.

That is the state of every random generator, and every number, string and small array, in their attributes and in the
lists and dictionaries there. What compiled code keeps to itself, closures and slots have, is not seen.
"""

import base64
import json
import operator
import random
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Space
from gymnasium.envs.registration import EnvSpec

_MOST_OBJECTS = 1000  # of one environment, nearest first
_MOST_PARTS = 64  # of a list or dictionary: a longer one is data
_MOST_BYTES = 2**16  # of an array
_PLAIN = (bool, int, float, str, type(None), np.generic)
_RANDOM = (np.random.Generator, np.random.RandomState, random.Random)
_OF_CODE = {"builtins", "functools"}  # where functions' and partials' types are
# Whose types, though compiled, keep nothing that an episode depends on.
_HARMLESS = {*_OF_CODE, "_thread", "collections", "datetime", "enum", "numpy", "pygame", "re", "weakref"}
_OF_A_SPACE = ("_np_random", "spaces")  # the rest never changes


class _Place(NamedTuple):
    """Where a value is.

    Attributes:
        name: The way there from the root, such as ``/env/game/last_action``.
        holder: The dictionary, of an object its attributes', or the list; a tuple has only what is changed in place.
        key: In the holder.
    """

    name: str
    holder: Any
    key: Any


class Remembered(NamedTuple):
    """What was remembered at some time.

    Attributes:
        places: Where.
        values: What.
        opaque: Objects of compiled code, by their names, which may remember more.
    """

    places: Sequence[_Place]
    values: Sequence[Any]
    opaque: Mapping[str, object]

    def plain(self, but: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """By names, in JSON's terms.

        Args:
            but: What is as there is left out.
        """
        found = {place.name: plain(value) for place, value in zip(self.places, self.values, strict=True)}
        if but is None:
            return found
        return {
            name: value
            for name, value in found.items()
            if name not in but or json.dumps(value) != json.dumps(but[name])  # 1 is not True, nor 0.0 -0.0
        }


class Memory:
    """What is reached from some objects.

    Args:
        roots: Gives the objects; one that is made anew takes the place of another.
    """

    def __init__(self, roots: Callable[[], tuple[object, ...]]) -> None:
        self._roots = roots
        self._look()

    def now(self) -> Remembered:
        """What there is; in copies."""
        values = self._values()
        for index in self._mutable:
            values[index] = _copied(values[index])
        return Remembered(self._places, values, self._opaque)

    def opaque_of(self, earlier: Remembered) -> str | None:
        """The name of an object of compiled code that is still there; None if there is none."""
        self._values()
        return next((name for name, value in self._opaque.items() if earlier.opaque.get(name) is value), None)

    def randoms(self) -> list[Any]:
        """The states of all random generators, in JSON's terms."""
        values = self._values()
        return [plain(_copied(values[index])) for index in self._mutable if isinstance(values[index], _RANDOM)]

    def put_back(self, values: Mapping[str, Any]) -> None:
        """Takes up values, in JSON's terms, of objects that were made in the same way.

        Raises:
            ValueError: There is no such random generator.
        """
        self._look()
        places = {place.name: place for place in self._places}
        for name, value in values.items():
            if name in places:
                _put(places[name], value)
            elif isinstance(value, dict) and "random" in value:
                raise ValueError(f"there is no random generator at {name}")

    def _values(self) -> list[Any]:
        """As they are now, once places were looked for where objects were replaced, have come or gone."""
        try:
            values = [holder[key] for _, holder, key in self._places]
            is_same = (
                self._have_like_types(values)
                and list(map(len, self._holders)) == self._sizes
                and all(map(operator.is_, self._roots(), self._found))
                and all(map(operator.is_, [holder[key] for holder, key in self._links], self._children))
            )
        except LookupError:
            is_same = False
        if is_same:
            return values
        self._look()
        return [holder[key] for _, holder, key in self._places]

    def _have_like_types(self, values: Sequence[Any]) -> bool:
        """Whether none has become, or was, what is changed in place; None may become a number."""
        types = list(map(type, values))
        return types == self._types or all(
            new is old or (issubclass(new, _PLAIN) and issubclass(old, _PLAIN))
            for new, old in zip(types, self._types, strict=True)
        )

    def _look(self) -> None:
        self._places: list[_Place] = []
        self._holders: list[Any] = []
        self._links: list[tuple[Any, Any]] = []  # holders and keys of what is no value
        self._children: list[Any] = []
        self._opaque: dict[str, object] = {}
        self._found = self._roots()
        waiting: deque[tuple[str, Any]] = deque([("", self._found)])
        seen = {id(self._found)}
        while waiting:
            name, owner = waiting.popleft()
            holder = owner if isinstance(owner, dict | list | tuple) else vars(owner)
            self._holders.append(holder)
            for key, value in _items(owner, holder):
                if _is_value(value):
                    if not (isinstance(holder, tuple) and isinstance(value, _PLAIN)):
                        self._places.append(_Place(f"{name}/{key}", holder, key))
                    continue
                self._links.append((holder, key))
                self._children.append(value)
                if id(value) in seen:
                    continue
                if _is_opaque(value):
                    self._opaque[f"{name}/{key}"] = value
                elif len(seen) < _MOST_OBJECTS and _is_looked_into(value):
                    seen.add(id(value))
                    waiting.append((f"{name}/{key}", value))
        self._sizes = list(map(len, self._holders))
        values = [holder[key] for _, holder, key in self._places]
        self._types = list(map(type, values))
        self._mutable = [index for index, value in enumerate(values) if isinstance(value, (np.ndarray, *_RANDOM))]


class _RandomState(NamedTuple):
    state: Any


def _copied(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, np.random.Generator):
        return _RandomState(value.bit_generator.state)
    if isinstance(value, np.random.RandomState):
        return _RandomState(value.get_state(legacy=False))
    if isinstance(value, random.Random):
        return _RandomState(value.getstate())
    return value


def plain(value: Any) -> Any:
    """A value in JSON's terms, from which ``_put`` makes it again."""
    if isinstance(value, np.generic | np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": data, "dtype": value.dtype.str, "shape": list(value.shape), "is": type(value).__name__}
    if isinstance(value, _RandomState):
        return {"random": plain(value.state)}
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, tuple):
        return [plain(part) for part in value]
    return value


def array_of(value: Mapping[str, Any]) -> np.ndarray[Any, Any]:
    """The array that ``plain`` wrote; it may be written into."""
    flat = np.frombuffer(bytearray(base64.b64decode(value["array"])), np.dtype(value["dtype"]))
    return flat.reshape(value["shape"])


def _put(place: _Place, value: Any) -> None:
    now = place.holder[place.key]
    if isinstance(value, dict) and "random" in value:
        if now is None and "bit_generator" in value["random"]:  # Gymnasium makes them when they are first used
            now = place.holder[place.key] = np.random.default_rng()
        _set_random(now, value["random"], place.name)
    elif isinstance(value, dict):
        array = array_of(value)
        if value["is"] != "ndarray":
            place.holder[place.key] = array[()]
        elif isinstance(now, np.ndarray) and (now.dtype, now.shape) == (array.dtype, array.shape):
            if now.flags.writeable:
                now[...] = array  # others may hold the same one
        else:
            place.holder[place.key] = array
    else:
        place.holder[place.key] = value


def _set_random(generator: Any, state: Any, name: str) -> None:
    if isinstance(generator, np.random.Generator):
        generator.bit_generator.state = _again(state)
    elif isinstance(generator, np.random.RandomState):
        generator.set_state(_again(state))
    elif isinstance(generator, random.Random):
        version, words, rest = state
        generator.setstate((version, tuple(words), rest))
    else:
        raise ValueError(f"there is no random generator at {name}")


def _again(state: Any) -> Any:
    """NumPy's state of a generator, of what ``plain`` made of it."""
    if not isinstance(state, dict):
        return state
    return array_of(state) if "array" in state else {key: _again(part) for key, part in state.items()}


def _items(owner: Any, holder: Any) -> Iterator[tuple[Any, Any]]:
    if not isinstance(holder, dict):
        return iter(enumerate(holder))
    if isinstance(owner, Space):
        return iter([(key, holder[key]) for key in _OF_A_SPACE if key in holder])
    return iter(list(holder.items()))


def _is_value(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.nbytes <= _MOST_BYTES and value.dtype.kind in "biufc"
    return isinstance(value, _PLAIN + _RANDOM)


def _is_looked_into(value: object) -> bool:
    if isinstance(value, dict | list | tuple):
        return len(value) <= _MOST_PARTS
    return hasattr(value, "__dict__") and not isinstance(value, EnvSpec | type) and _module(value) not in _OF_CODE


def _is_opaque(value: object) -> bool:
    return not (isinstance(value, dict | list | tuple) or hasattr(value, "__dict__") or _module(value) in _HARMLESS)


def _module(value: object) -> str:
    return str(getattr(type(value), "__module__", "")).partition(".")[0]
