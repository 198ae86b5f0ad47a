"""Options that declare their range beside their type, and are held to it when they are made.

A field says everything about itself in one place; the string below it is the help that the command line shows::

    @dataclass(frozen=True)
    class WaitOptions(Options):
        timeout_wait: Count = 60
        \"\"\"Seconds to wait for a player.\"\"\"
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from trainer.errors import TrainerError


@dataclass(frozen=True)
class Range:
    """The numbers that an option may be, in its type's ``Annotated``. An option may have several, checked in order.

    Attributes:
        low: The smallest.
        high: The largest.
        otherwise: What a refusal says after "--steps is 0, but"; made from low and high if not given.
    """

    low: float = -math.inf
    high: float = math.inf
    otherwise: str | None = None

    def holds(self, value: Any, whole: bool) -> bool:
        """Whether a value is a number in the range, without a fraction if it has to be whole; NaN never is."""
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return number and self.low <= value <= self.high and (not whole or value == int(value))

    def expected(self, whole: bool) -> str:
        """What a refusal says that was expected."""
        if self.otherwise is not None:
            return self.otherwise
        to = "up" if self.high == math.inf else f"to {self.high:g}"
        return f"a {'whole number' if whole else 'number'} from {self.low:g} {to} was expected"


Count = Annotated[int, Range(1)]
Port = Annotated[int, Range(1), Range(high=65535, otherwise="ports end at 65535")]
Seed = Annotated[int, Range(0), Range(high=2**31 - 1, otherwise=f"the protocol carries seeds below {2**31}")]
Seconds = Annotated[float, Range(math.ulp(0.0), otherwise="seconds above 0 were expected")]


class Options:
    """Base of dataclasses whose fields may have a ``Range``.

    Raises:
        TrainerError: A value is out of its range; None never is where the type allows it.
    """

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            value = getattr(self, name)
            if value is None and NoneType in get_args(hint):
                continue
            for whole, allowed in _ranges(hint):
                if not allowed.holds(value, whole):
                    raise TrainerError(f"{self._given(name, value)}, but {allowed.expected(whole)}.")

    def _given(self, name: str, value: Any) -> str:
        shown = f"{value:g}" if isinstance(value, float) else value
        return f"--{name.replace('_', '-')} is {shown}"


def _ranges(hint: Any) -> Iterator[tuple[bool, Range]]:
    """A type's ranges, each with whether the number has to be whole; also those inside ``Count | None``."""
    if get_origin(hint) is Annotated:
        number, *metadata = get_args(hint)
        yield from ((number is int, each) for each in metadata if isinstance(each, Range))
    else:
        for part in get_args(hint):
            yield from _ranges(part)
