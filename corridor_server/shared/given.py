"""What comes from outside the program: numbers, and files of names and values, whatever they turn out to be."""

import json
import math
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FILE_LIMIT = 2**20  # bytes; the largest file of settings has a few kB
FLOAT32 = (2 - 2**-23) * 2.0**127  # the largest
MAX_AREAS = 2**16  # of one player of ours


@dataclass(frozen=True)
class Range:
    """The numbers that something may be. A range without ends still holds finite numbers only.

    Attributes:
        low: The smallest.
        high: The largest.
        otherwise: What a refusal says after "--steps is 0, but"; made from low and high if not given.
    """

    low: float = -math.inf
    high: float = math.inf
    otherwise: str | None = None

    def read(self, value: Any, whole: bool = False) -> float | None:
        """The number that a value is, as Python's own int or float; None if it is none, or out of the range.

        Args:
            value: Anything; NumPy's scalars and arrays of no dimension count as what they hold.
            whole: Whether it has to be without a fraction; it is an int then.
        """
        if getattr(value, "ndim", None) == 0:  # NumPy itself takes long to import
            value = value.item()
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        try:
            if not math.isfinite(value) or not self.low <= value <= self.high or (whole and value != int(value)):
                return None
        except OverflowError:  # an int that is too large for a float
            return None
        return int(value) if whole else float(value)

    def parse(self, text: str, whole: bool = False) -> float | None:
        """The same from a text, such as a command line's."""
        for kind in (int, float):
            try:
                return self.read(kind(text), whole)
            except ValueError:
                continue
        return None

    def expected(self, whole: bool = False) -> str:
        """What a refusal says that was expected."""
        return self.otherwise or f"{self.described(whole)} was expected"

    def described(self, whole: bool = False) -> str:
        """Its numbers, in words."""
        kind = "whole number" if whole else "finite number" if self.low == -math.inf else "number"
        begin = "" if self.low == -math.inf else f" from {self.low:.10g}"
        end = f" to {self.high:.10g}" if self.high < math.inf else " up" if begin else ""
        return f"a {kind}{begin}{end}"


class _Short(reprlib.Repr):
    """A file's values may refer to themselves, or have more digits than Python writes."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 3, 80, 80

    def repr_int(self, value: int, level: int) -> str:
        return repr(value) if abs(value) < 10**40 else "an integer of more than 40 digits"


def shown(value: object) -> str:
    """A value as a sentence shows it: like ``repr``, but never long."""
    return _Short().repr(value)


def read_json(data: bytes | str) -> dict[str, Any]:
    """The names and values of a JSON object.

    Raises:
        ValueError: It is none.
    """
    try:
        values = json.loads(data)
    except RecursionError as error:
        raise ValueError("its lists or objects are nested too deep") from error
    if not isinstance(values, dict):
        raise ValueError(f"it is {shown(values)}, but names and values were expected")
    return values


def read_mapping(path: Path) -> dict[Any, Any]:
    """The names and values of a file: YAML, or JSON where PyYAML is not installed. An empty file has none.

    Raises:
        ValueError: The file can't be read, is not YAML, or holds something else; the message is a sentence.
    """
    return mapping_of(read_text(path), path)


def read_text(path: Path) -> str:
    """A file of settings.

    Raises:
        ValueError: The file can't be read, or is too large to be one; the message is a sentence.
    """
    try:
        with path.open("rb") as file:
            data = file.read(FILE_LIMIT + 1)
        text = data.decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} can't be read ({getattr(error, 'strerror', None) or error}).") from error
    if len(data) > FILE_LIMIT:
        raise ValueError(f"{path} has more than {FILE_LIMIT:,} bytes, which no file of settings needs.")
    return text


def mapping_of(text: str, path: Path) -> dict[Any, Any]:
    """The names and values that a file's text says; none if it says nothing.

    Raises:
        ValueError: It is not YAML, or says something else; the message is a sentence.
    """
    values = _parsed(text, path)
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ValueError(f"{path} holds {shown(values)}, but names and values were expected.")
    return values


def _parsed(text: str, path: Path) -> object:
    try:
        import yaml
    except ImportError:  # the player alone has no PyYAML; JSON is the part of YAML that needs none
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"{path} is not JSON ({error}); to read YAML, install PyYAML.") from error
    try:
        return yaml.safe_load(text)
    # PyYAML lets through whatever its conversions raise: of a date 2020-13-45, of a number with 5,000 digits.
    except Exception as error:
        reason = " ".join(str(error).split())[:300]
        raise ValueError(f"{path} is not YAML ({reason}); write lines 'name: value'.") from error
