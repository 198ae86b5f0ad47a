"""Options that declare their type and range in one place, and are held to them when they are made.

A field says everything about itself; the string below it is the help that the command line shows::

    @dataclass(frozen=True)
    class WaitOptions(Options):
        timeout_wait: Count = 60
        \"\"\"Seconds to wait for a player.\"\"\"
"""

import difflib
import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Self, Union, cast, get_args, get_origin, get_type_hints

from corridor_server.shared.given import Range, shown
from trainer.errors import SettingError, TrainerError

Count = Annotated[int, Range(1), Range(high=10**9, otherwise="at most 1,000,000,000 was expected")]
Steps = Annotated[int, Range(1), Range(high=10**15, otherwise="at most 1,000,000,000,000,000 was expected")]
Port = Annotated[int, Range(1), Range(high=65535, otherwise="ports end at 65535")]
Seed = Annotated[int, Range(0), Range(high=2**31 - 1, otherwise=f"the protocol carries seeds below {2**31}")]
Positive = Annotated[float, Range(0, 10**9)]
Share = Annotated[float, Range(0, 1)]
Ratio = Annotated[float, Range(0, 1000)]
Units = Annotated[int, Range(1, 4096)]  # two layers of 65,536 each would take 17 GB, once per network and moment
Seconds = Annotated[
    float,
    Range(math.ulp(0.0), otherwise="seconds above 0 were expected"),
    Range(high=10**9, otherwise="at most 1,000,000,000 seconds were expected"),
]

NAME_BYTES = 200  # file systems have 255, of which some are for what is written beside it first


def is_name(text: str) -> bool:
    """Whether a text can be one file's or folder's name, wherever it is put: no path, not too long."""
    return bool(re.fullmatch(r"[\w.+-]*\w[\w.+-]*", text)) and len(text.encode()) <= NAME_BYTES


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
                raise SettingError(f"{self._given(name, value)}, but {refusal}.", name) from refusal

    def _given(self, name: str, value: Any) -> str:
        return f"--{name.replace('_', '-')} is {_typed(value)}"


class Settings(Options):
    """Base of what a file of settings says: each is a section of it, with the section's own names.

    Attributes:
        SECTION: What a refusal calls it.
        NOT_HERE: Names that ML-Agents has and we don't, and what to do instead; null and false ask for nothing.
        NO_EFFECT: Names that change nothing of what is learned, with their types: they are taken, and left out.
    """

    SECTION: ClassVar[str] = "the settings"
    NOT_HERE: ClassVar[Mapping[str, str]] = {}
    NO_EFFECT: ClassVar[Mapping[str, Any]] = {}

    def as_dict(self) -> dict[str, Any]:
        """Plain names and values, as ``from_mapping`` reads them and a YAML file holds them, without what is None."""
        values = {each.name: getattr(self, each.name) for each in fields(cast(Any, self))}
        return {
            name: value.as_dict() if isinstance(value, Settings) else value
            for name, value in values.items()
            if value is not None
        }

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """The settings that names and values say; what they don't say is as its default has it.

        A number may be a text, as PyYAML reads 3e-4.

        Raises:
            SettingError: They are none, a name is unknown, or a value is of another type or out of its range.
        """
        hints, made = get_type_hints(cls, include_extras=True), {}
        known = {each.name: each for each in fields(cast(Any, cls))}
        for name, value in names_and_values(values, cls.SECTION).items():
            try:
                if name in known:
                    made[name] = _structured(hints[name], value)
                elif name in cls.NO_EFFECT:
                    _held(cls.NO_EFFECT[name], _structured(cls.NO_EFFECT[name], value))
                elif name not in cls.NOT_HERE:
                    raise SettingError(f"{_unknown(name, cls, hints, known)}.")
                elif value is not None and value is not False:
                    raise SettingError(f"{cls.SECTION} has {name}, which is not supported: {cls.NOT_HERE[name]}.")
            except SettingError as error:
                raise error.within(name) from error
            except _NotHeldError as refusal:
                raise SettingError(f"The setting {name} is {shown(value)}, but {refusal}.", name) from refusal
        for name, field in known.items():
            if name not in made and field.default is MISSING and field.default_factory is MISSING:
                raise SettingError(f"{cls.SECTION} has no {name}, which it needs.")
        return cast(Self, cast(Any, cls)(**made))

    def _given(self, name: str, value: Any) -> str:
        return f"The setting {name} is {shown(value)}"


def names_and_values(values: object, section: str) -> Mapping[Any, Any]:
    """A section's names and values.

    Raises:
        SettingError: It holds something else.
    """
    if not isinstance(values, Mapping):
        raise SettingError(f"{_as_text(section)} is {shown(values)}, but lines 'name: value' were expected.")
    return values


def _as_text(name: str) -> str:
    """A name as it stands in a sentence; somebody may have put a line's end into it."""
    return name if name.isprintable() and name else shown(name)


def nearest(name: object, known: Iterable[str]) -> str:
    """What a refusal of an unknown name says of those that there are."""
    names = [_as_text(each) for each in known]
    close = difflib.get_close_matches(str(name)[:100], names, 1)
    return f"the nearest name is {close[0]}" if close else f"known ones are {', '.join(names) or 'none'}"


def _unknown(name: object, section: type[Settings], hints: Mapping[str, Any], known: Iterable[str]) -> str:
    for other, hint in hints.items():
        if any(name in get_type_hints(inner) for inner in _settings_in(hint)):
            return f"{section.SECTION} has no {name}, which stands under {other}"
    return f"{section.SECTION} has no {shown(name)}; {nearest(name, known)}"


def _settings_in(hint: Any) -> list[type[Settings]]:
    """The sections that a type allows."""
    return [each for each in (get_args(hint) or (hint,)) if isinstance(each, type) and issubclass(each, Settings)]


def _structured(hint: Any, value: Any) -> Any:
    """A file's value as its type would have it, if it can be; it is not held to it yet."""
    sections = _settings_in(hint)
    if sections:
        return value if isinstance(value, tuple(sections)) else sections[0].from_mapping(value)
    kind = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if get_origin(kind) in (Union, UnionType):
        return value if value is None else _structured(get_args(kind)[0], value)
    number = Range().parse(value) if kind in (int, float) and isinstance(value, str) else None
    return value if number is None else number


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
            return _held(kinds[0], value, ranges)
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
