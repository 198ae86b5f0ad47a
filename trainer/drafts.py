"""Folders that one command writes to at a time, and what it makes outside of them until it is whole.

Beside a folder ``x`` stand, as long as a command writes to it, ``.x~lock`` and ``.x~new``, and while another folder
takes its place, ``.x~old``: a run id has no tilde.
"""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from trainer.errors import TrainerError
from trainer.signals import deferred
from trainer.terminal import Terminal

WITHIN = ".~new"  # inside a folder that stays: it may be a mount, into which nothing can be renamed


class Draft:
    """A folder for what is to become part of another one, or to take its place.

    Args:
        folder: The other one.
        replace: Whether it takes its place.

    Attributes:
        path: The draft's own.
    """

    def __init__(self, folder: Path, replace: bool) -> None:
        self._folder = folder.resolve()
        self._whole = replace or not self._folder.exists()
        self._instead = replace and self._folder.exists()
        self.path = beside(folder, "new") if self._whole else self._folder / WITHIN

    def publish(self) -> None:
        """Moves every file to its place in the folder; or the draft takes the folder's place, whole or not at all.

        Raises:
            TrainerError: The folder can't be written.
        """
        with written(self._folder):
            if self._whole:
                with deferred():
                    self._take_place()
                self._whole = False
            else:
                self._move_files()

    def _move_files(self) -> None:
        for file in sorted(each for each in self.path.rglob("*") if not each.is_dir()):
            place = self._folder / file.relative_to(self.path)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)

    def _take_place(self) -> None:
        old = beside(self._folder, "old")
        if self._instead:
            self._folder.rename(old)
        try:
            self.path.rename(self._folder)
        finally:
            put_back(self._folder)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def only_writer(folder: Path, *, replace: bool = False, seconds: float = 0.0) -> Iterator[Draft]:
    """Holds a folder, which need not exist, against other writers; a process that dies holds nothing.

    Args:
        folder: The folder.
        replace: Whether the draft shall take its place, instead of becoming part of it.
        seconds: To wait for another writer.

    Yields:
        An empty draft, which is removed at the end with all that was not published.

    Raises:
        TrainerError: Another command is writing to the folder, or it can't be written.
    """
    place, lock = beside(folder, "lock"), FileLock(beside(folder, "lock"), timeout=seconds, fallback_to_soft=False)
    made: list[Path] = []
    try:
        with written(folder):
            _acquire(folder, lock, made)
            put_back(folder)
            _remove_what_was_left(folder)
            draft = Draft(folder, replace)
            draft.path.mkdir()
        try:
            yield draft
        finally:
            shutil.rmtree(draft.path, ignore_errors=True)
    finally:
        if lock.is_locked:
            with suppress(OSError):
                place.unlink()  # before it is released: who waits for it looks whether it is still there
            lock.release()
        for each in made:
            with suppress(OSError):  # something is in it by now
                each.rmdir()


@contextmanager
def written(folder: Path) -> Iterator[None]:
    """Turns a full disk, or a folder that can't be written, into one sentence (``TrainerError``)."""
    try:
        yield
    except OSError as error:
        raise TrainerError(f"{folder} can't be written ({error}); choose another with --results-dir.") from error


def beside(folder: Path, what: str) -> Path:
    """A place beside a folder that no run id can name."""
    whole = folder.resolve()
    return whole.parent / f".{whole.name}~{what}"


def mend(folder: Path) -> None:
    """Puts a folder back that a command was about to replace when it was killed."""
    try:
        old = beside(folder, "old")
    except ValueError:  # a name that no folder can have
        return
    if os.path.exists(old) and not os.path.exists(folder):  # which never raise
        with suppress(TrainerError), only_writer(folder, seconds=1.0):  # or it is being replaced right now
            pass


def put_back(folder: Path) -> None:
    """Undoes a change of place that was cut in the middle."""
    old = beside(folder, "old")
    if old.exists() and not folder.resolve().exists():
        old.rename(folder.resolve())


def _remove_what_was_left(folder: Path) -> None:
    """Removes drafts, of folders and of files (``whole_file``), that a process left which was killed."""
    drafts = [each for each in folder.glob(".*~*") if each.name == WITHIN or re.search(r"~\d+$", each.name)]
    for left in (beside(folder, "old"), beside(folder, "new"), *drafts):
        if left.is_dir():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def _acquire(folder: Path, lock: FileLock, made: list[Path]) -> None:
    while True:
        parent = folder.resolve().parent
        made += [each for each in (parent, *parent.parents) if not each.exists()]
        parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire()
            return
        except Timeout as error:
            raise TrainerError(
                f"Another corridor command is writing to {folder}; wait for its end, or stop it first."
            ) from error
        except FileNotFoundError:  # another command has just removed the parent again that it had made
            continue
        except OSError as error:
            Terminal(stderr=True).print(
                f"Warning: {folder} can't be locked ({error.strerror}); see to it that no other command writes to it.",
                style="yellow",
            )
            return
