"""Signals that ask a command to stop, and what they must not cut."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

INTERRUPTED = 130  # what a shell reports for a program that Ctrl-C ended
STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def interrupt_on_stop_signals() -> None:
    """Makes SIGTERM and SIGHUP do what Ctrl-C does: end the command cleanly, closing its players."""
    for number in stop_signals():
        signal.signal(number, _interrupt)


def stop_signals() -> list[int]:
    """The signals that ask to stop; without SIGHUP where nohup has it ignored."""
    hangup = getattr(signal, "SIGHUP", None)
    return [number for number in STOPPING if number != hangup or signal.getsignal(number) != signal.SIG_IGN]


class StopSignals:
    """While it is entered, the first stop signal asks for a clean stop; a second one interrupts at once.

    Attributes:
        received: Whether one has come.
    """

    def __init__(self) -> None:
        self.received = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> "StopSignals":
        for number in stop_signals():
            self._former[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.received:
            raise KeyboardInterrupt
        self.received = True


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Keeps an impatient Ctrl-C from cutting what must be finished: saving, and closing the player."""
    former = {number: signal.signal(number, signal.SIG_IGN) for number in STOPPING}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


@contextmanager
def deferred() -> Iterator[None]:
    """Lets a signal wait for what is quickly done: an interrupt in the middle of it would leave it half done."""
    if threading.current_thread() is not threading.main_thread():  # which alone is interrupted
        yield
        return
    received: list[int] = []
    former = {number: signal.signal(number, lambda each, _: received.append(each)) for number in stop_signals()}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
