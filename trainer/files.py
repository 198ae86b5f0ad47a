"""Files that are written whole or not at all: whoever reads one, and whenever, finds the old one or the new one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: Path, *, temporary: str | None = None, durable: bool = True) -> Iterator[BinaryIO]:
    """Opens a file that takes its place only once the block has ended well.

    Args:
        path: The file.
        temporary: Name beside it for the time being; if not given, one that no other process takes.
        durable: Wait until the disk has it, so that a power failure leaves it whole, too.

    Raises:
        OSError: It can't be written; nothing is left of the attempt.
    """
    unfinished = path.with_name(f".{path.name}~{os.getpid()}" if temporary is None else temporary)
    try:
        with unfinished.open("wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        unfinished.replace(path)
    except BaseException as error:
        unfinished.unlink(missing_ok=True)  # on a full disk, its room is needed
        if isinstance(error, OSError) and error.filename is None:  # a write that failed does not say of which file
            error.filename = str(path)
        raise


def write_whole(path: Path, content: str | bytes | bytearray) -> None:
    """Writes a file whole or not at all; text as UTF-8, with its line ends as they are.

    Raises:
        OSError: It can't be written.
    """
    with whole_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)
