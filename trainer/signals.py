"""Signals that ask a command to stop: its one way to an end within two seconds, and what may be finished before."""

import os
import signal
import sys
import threading
import time
from _thread import start_new_thread
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED = 130  # what a shell reports for a program that Ctrl-C ended
STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
CLEAN_SECONDS = 1.2  # for a clean stop; then it is interrupted
SAVING_SECONDS = 10.0  # for what follows a clean stop: a moment, but on a disk or a machine that is busy
CLOSING_SECONDS = 0.4  # for what is open to be closed; then the process ends as it is
SHOW_CURSOR = b"\x1b[?25h"


class _Stop:
    """How far the one stop of this process has come.

    Attributes:
        asked: Whether a signal has come.
        interrupted: Whether ``KeyboardInterrupt`` was raised for it: what comes next ends the process.
        clean: Whether training has stopped for it, and is being saved.
        waits: Whether it waits for what must not be cut.
        ending: Whether the process is being ended.
        holds: How many things that must not be cut are under way.
        listener: Stops cleanly when told to.
        folders: Temporary ones, which go when the process does.
    """

    def __init__(self) -> None:
        self.asked = self.interrupted = self.clean = self.waits = self.ending = False
        self.holds = 0
        self.listener: StopSignals | None = None
        self.folders: set[Path] = set()

    def receive(self, number: int, frame: FrameType | None) -> None:
        """The handler of every stop signal; like all handlers, it runs in the main thread."""
        if self.ending:
            return
        if not self.asked:
            self.asked = True
            # What fails now fails because of the interrupt; where C code swallows that, the thread insists.
            sys.unraisablehook = threading.excepthook = _say_nothing
            with suppress(RuntimeError):
                start_new_thread(_insist, ())
            if _is_importing(frame):  # half a module is nothing to go on with, and nothing is open yet
                _end_process("Stopped.\n")
        self.waits = self.holds > 0
        if not self.waits:
            self.act()

    def act(self) -> None:
        """Tells the listener, interrupts, or ends the process: whatever was not tried yet."""
        if self.listener is not None and not self.listener.received:
            self.listener.received = True
        elif self.interrupted:
            _end_process("Stopped.\n")
        else:
            self.interrupted = True
            raise KeyboardInterrupt


_stop = _Stop()


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """The life of a process that a stop signal ends, wherever it is: with 130, no traceback, and none of its processes.

    Whoever is at work hears of it as ``KeyboardInterrupt``, or through ``StopSignals``, and closes what it has open.
    """
    for number in STOPPING:
        if number != getattr(signal, "SIGHUP", None) or signal.getsignal(number) != signal.SIG_IGN:  # nohup's
            signal.signal(number, _stop.receive)
    try:
        yield
    except BaseException:
        if _stop.asked:
            _end_process("Stopped.\n")
        raise
    finally:
        for number in STOPPING:  # nothing is left to be stopped; Python itself may take a moment to end
            signal.signal(number, signal.SIG_IGN)
        if _stop.asked:
            _end_process()


class StopSignals:
    """While it is entered, the first stop signal asks for a clean stop; a second one, or a long wait, interrupts.

    Attributes:
        received: Whether one has come.
    """

    def __init__(self) -> None:
        self.received = False

    def __enter__(self) -> "StopSignals":
        _stop.listener = self
        return self

    def __exit__(self, kind: object, *exception: object) -> None:
        _stop.listener = None
        _stop.clean = self.received and kind is None


@contextmanager
def deferred() -> Iterator[None]:
    """Lets a signal wait for what is quickly done and must not be cut: saving, closing a player."""
    if threading.current_thread() is not threading.main_thread():  # which alone is interrupted
        yield
        return
    if signal.getsignal(signal.SIGINT) != _stop.receive:  # somebody else's program, which uses this as a library
        received: list[int] = []
        former = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, former)
            if received:
                signal.raise_signal(signal.SIGINT)
        return
    _stop.holds += 1
    try:
        yield
    finally:
        _stop.holds -= 1
        if _stop.waits and not _stop.holds:
            _stop.waits = False
            _stop.act()


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder for a while, which no end of this process leaves behind."""
    import tempfile  # not before the first signal can be answered

    with deferred():
        folder = Path(tempfile.mkdtemp(prefix="corridor-"))
        _stop.folders.add(folder)
    try:
        yield folder
    finally:
        _remove(folder)
        _stop.folders.discard(folder)


def _remove(folder: Path) -> None:
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


def kill_with_descendants(process_id: int) -> None:
    """Kills a process and all that it started, and waits a moment for their end."""
    import psutil  # not before the first signal can be answered

    with suppress(psutil.Error):
        family = [psutil.Process(process_id)]
        family += family[0].children(recursive=True)
        if process_id == os.getpid():
            del family[0]
        for each in family:
            with suppress(psutil.Error):
                each.kill()
        psutil.wait_procs(family, timeout=0.2)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _insist() -> None:
    time.sleep(CLEAN_SECONDS)
    if _stop.clean:
        time.sleep(SAVING_SECONDS - CLEAN_SECONDS)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(CLOSING_SECONDS)
    _end_process("Stopped.\n")


def _end_process(message: str = "") -> NoReturn:
    _stop.ending = True
    with suppress(Exception):
        kill_with_descendants(os.getpid())
    with suppress(Exception):
        for folder in _stop.folders:
            _remove(folder)
    for stream in (1, 2):
        with suppress(OSError):
            if os.isatty(stream):  # a display that was cut has hidden the cursor
                os.write(stream, SHOW_CURSOR)
    with suppress(OSError):
        os.write(2, message.encode())
    os._exit(INTERRUPTED)


def _say_nothing(_: Any) -> None:
    pass
