"""Options that declare their type and range in one place, and are held to them when they are made.

A field says everything about itself; the string below it is the help that the command line shows::

    @dataclass(frozen=True)
    class WaitOptions(Options):
        timeout_wait: Count = 60
        \"\"\"Seconds to wait for a player.\"\"\"
"""

import math
import os
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from corridor_server.shared.given import Range, shown
from trainer.errors import TrainerError

Count = Annotated[int, Range(1), Range(high=10**9, otherwise="at most 1,000,000,000 was expected")]
Steps = Annotated[int, Range(1), Range(high=10**15, otherwise="at most 1,000,000,000,000,000 was expected")]
Port = Annotated[int, Range(1), Range(high=65535, otherwise="ports end at 65535")]
Seed = Annotated[int, Range(0), Range(high=2**31 - 1, otherwise=f"the protocol carries seeds below {2**31}")]
Seconds = Annotated[
    float,
    Range(math.ulp(0.0), otherwise="seconds above 0 were expected"),
    Range(high=10**9, otherwise="at most 1,000,000,000 seconds were expected"),
]


class Options:
    """Base of dataclasses whose fields are held to their types, and to the ``Range`` that a type may have.

    Numbers become Python's own, of the field's type. None is taken where the type allows it.

    Raises:
        TrainerError: A value is of another type, or out of its range.
    """

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            if ClassVar in (hint, get_origin(hint)):
                continue
            value = getattr(self, name)
            try:
                object.__setattr__(self, name, _held(hint, value))
            except _NotHeldError as refusal:
                raise TrainerError(f"{self._given(name, value)}, but {refusal}.") from refusal

    def _given(self, name: str, value: Any) -> str:
        return f"--{name.replace('_', '-')} is {_typed(value)}"


_EXPECTED = {bool: "true or false", str: "a text", Path: "a path"}


class _NotHeldError(Exception):
    """Says what was expected."""


def _held(hint: Any, value: Any, ranges: tuple[Range, ...] = (Range(),)) -> Any:
    """A value as its type has it."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        found = tuple(each for each in arguments[1:] if isinstance(each, Range))
        return _held(arguments[0], value, found or ranges)
    if origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        kinds = [each for each in arguments if each is not NoneType]
        if len(kinds) == 1:
            return _held(kinds[0], value)
        hint = tuple(kinds)
    if hint in (int, float):
        return _number(value, hint is int, ranges)
    if origin is Literal:
        if value not in arguments:
            raise _NotHeldError(f"one of {', '.join(arguments)} was expected")
        return value
    if origin in (list, tuple):
        if not isinstance(value, list | tuple):
            raise _NotHeldError("a list was expected")
        return origin(_held(arguments[0], each) for each in value)
    if hint in (str, Path) and isinstance(value, str | Path):
        _check_text(str(value))
    if origin is None and hint is not Any and not isinstance(value, hint):
        raise _NotHeldError(f"{_EXPECTED.get(hint, 'something else')} was expected")
    return value


def _number(value: Any, whole: bool, ranges: tuple[Range, ...]) -> float:
    for allowed in ranges:
        if allowed.read(value, whole) is None:
            raise _NotHeldError(allowed.expected(whole))
    return int(value) if whole else float(value)


def _check_text(text: str) -> None:
    """Refuses what can't be a file's name or a program's argument."""
    try:
        os.fsencode(text)
    except UnicodeEncodeError as error:
        raise _NotHeldError("a text that this system can write was expected") from error
    if "\0" in text:
        raise _NotHeldError("a text without NUL characters was expected")


def _typed(value: Any) -> str:
    """A value as it is typed on a command line."""
    if isinstance(value, float):
        return f"{value:g}"
    return str(value) if isinstance(value, str | Path) else shown(value)


def env_args_of_another(env: str) -> TrainerError:
    """What is said of arguments for a player that is not started here."""
    return TrainerError(
        f"--env-args is for players that are launched here, but --env {env} is started by somebody else; give these "
        "arguments there."
    )
