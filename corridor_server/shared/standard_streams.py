"""Standard output and error as something that nobody may be reading any more: what can't be written there is dropped.

A full disk, a pipe whose reader has left (``| head -1``), a terminal that was closed: each costs the output, never what
the process is there for.
"""

import io
import os
import select
import sys
from contextlib import suppress
from typing import Any


def drop_failing_output() -> None:
    """Gives the process standard streams that can't fail; to be called before it opens a file or writes a line."""
    for descriptor in range(3):
        _open_if_closed(descriptor)
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        former = getattr(sys, name)
        if former is None:  # it was closed when the process began
            setattr(sys, name, _text(descriptor, "utf-8", "replace", True, False))
        elif isinstance(former, io.TextIOWrapper) and _is_plain(former, descriptor):
            with suppress(OSError):
                former.flush()
            kept = former.encoding, former.errors or "strict", former.line_buffering, former.write_through
            setattr(sys, name, _text(descriptor, *kept))


class _Dropping(io.FileIO):
    def write(self, data: Any, /) -> int:
        try:
            while (written := super().write(data)) is None:  # its other owners don't want to wait; we do
                select.select([], [self], [])
        except OSError:
            return memoryview(data).nbytes
        return written


def _open_if_closed(descriptor: int) -> None:
    """Else the next file that is opened gets the number, and what is printed goes into it, from children, too."""
    try:
        os.fstat(descriptor)
    except OSError:
        opened = os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one
        os.set_inheritable(opened, True)


def _is_plain(stream: io.TextIOWrapper, descriptor: int) -> bool:
    """Whether it is Python's own over the descriptor: not what a test captures, not Windows' console."""
    raw = getattr(stream.buffer, "raw", stream.buffer)
    return type(raw) is io.FileIO and raw.fileno() == descriptor


def _text(descriptor: int, encoding: str, errors: str, line_buffering: bool, write_through: bool) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        io.BufferedWriter(_Dropping(descriptor, "w", closefd=False)),
        encoding,
        errors,
        line_buffering=line_buffering,
        write_through=write_through,
    )
