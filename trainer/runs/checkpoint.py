"""Checkpoint files: what one is, when a run writes them, and which is the newest good one.

A checkpoint is a safetensors file: named arrays, and under ``__metadata__`` the JSON text ``facts`` (everything that is
no array) and ``sha256``, the digest of the whole file with this digest's own 64 characters as zeros. Nothing in it is
code, and nothing is believed before the digest was compared.

``rollout-<steps>`` is written after every update, and there is one; ``step-<steps>`` are kept. Each gets its name once
it is whole, so that a process killed at any moment leaves only whole ones. Those that are kept have also been handed to
the disk, and survive a power failure.
"""

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trainer.errors import TrainerError
from trainer.files import whole_file

if TYPE_CHECKING:
    from numpy.typing import NDArray

FORMAT = 3
_SWISH_SINCE = 3  # the format in which a behavior's own policy has swish layers; before, it had tanh
KEPT = 5
SUFFIX = ".safetensors"
NO_DIGEST = "0" * 64
# Tensor sizes stand before the numbers, in a header of a few kB.
HEADER_LIMIT = 2**20


class DamagedCheckpoint(Exception):
    """A file that is not what was written; the message says in which way."""


@dataclass(frozen=True)
class Checkpoint:
    """A run at the end of one of its updates.

    Attributes:
        arrays: Tensors by name, ``<part>/<name>``.
        facts: Plain values, as JSON has them; those of the parts under ``parts``.
    """

    arrays: "Mapping[str, NDArray[Any]]"
    facts: Mapping[str, Any]

    def part(self, name: str) -> dict[str, Any]:
        """A part's ``state_dict``: its arrays and its plain values."""
        start = f"{name}/"
        arrays = {each.removeprefix(start): array for each, array in self.arrays.items() if each.startswith(start)}
        return {**arrays, **self.facts.get("parts", {}).get(name, {})}


def to_bytes(checkpoint: Checkpoint) -> bytearray:
    """A checkpoint's file.

    Raises:
        TrainerError: One of its numbers is NaN or infinite.
    """
    import numpy as np  # not for a command that only looks which checkpoints there are
    from safetensors.numpy import save

    for name, array in checkpoint.arrays.items():
        # A sum is the quicker test; one that is not finite may also have overflowed.
        if array.dtype.kind == "f" and not math.isfinite(array.sum()) and not np.isfinite(array).all():
            at = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
            raise TrainerError(
                f"{name}{list(at)} became {array[at]}; the run has diverged: try a smaller learning rate."
            )
    facts = json.dumps({"format": FORMAT, **checkpoint.facts}, allow_nan=False)
    data = bytearray(save(dict(checkpoint.arrays), {"facts": facts, "sha256": NO_DIGEST}))
    start = _digest_place(data)
    data[start : start + 64] = hashlib.sha256(data).hexdigest().encode()
    return data


def from_bytes(data: bytes | bytearray) -> Checkpoint:
    """The inverse of ``to_bytes``.

    Raises:
        DamagedCheckpoint: A byte is not what it was, or one is missing.
        TrainerError: It is whole, but of a later version.
    """
    from safetensors.numpy import load

    at = _digest_place(data)
    blank = data[:at] + NO_DIGEST.encode() + data[at + 64 :]
    if hashlib.sha256(blank).hexdigest().encode() != data[at : at + 64]:
        raise DamagedCheckpoint("its checksum is not that of its content")
    length = int.from_bytes(data[:8], "little")
    facts = json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["facts"])
    if facts["format"] > FORMAT:
        raise TrainerError(
            f"A checkpoint of format {facts['format']} was made by a later version of curious-corridor; this one reads "
            f"format {FORMAT}: update it."
        )
    checkpoint = Checkpoint(load(bytes(data)), facts)
    return _from_format_1(checkpoint) if facts["format"] == 1 else checkpoint


def check_layers(checkpoint: Checkpoint, name: str) -> None:
    """Refuses the PPO policy of a behavior whose weights are for other layers, though they fit.

    Raises:
        TrainerError: They are.
    """
    if checkpoint.facts["format"] < _SWISH_SINCE:
        raise TrainerError(
            f"The checkpoint's policy of {name} has tanh layers, as an earlier version of curious-corridor trains, but "
            "swish layers were expected; train it anew, or use that version."
        )


def _from_format_1(old: Checkpoint) -> Checkpoint:
    """A checkpoint of before parts had their plain values, and the running episodes, to themselves."""
    renamed = {
        "sb3_window/": "progress/",
        "last/": "last_step/",
        "player_state/": "players/state_",
        "player/": "players/",
    }
    arrays = {}
    for name, array in old.arrays.items():
        start = next((start for start in renamed if name.startswith(start)), "")
        arrays[renamed.get(start, "") + name.removeprefix(start)] = array
    facts = {name: old.facts[name] for name in ("format", "config", "counters", "env_steps")}
    parts: dict[str, Any] = {
        "progress": {name: old.facts[name] for name in ("env_steps", "updates", "logged")},
        "random": {"numpy_rest": old.facts["numpy_random"]},
        "players": {"lives": old.facts["lives"]},
    }
    if old.facts["curiosity"] is not None:
        parts["curiosity"] = old.facts["curiosity"]
        arrays["curiosity_episodes/sums"] = arrays.pop("curiosity/episode_sums")
        arrays["curiosity_episodes/observations"] = arrays["last_step/observations"]
    return Checkpoint(arrays, {**facts, "parts": parts})


def _digest_place(data: bytes | bytearray) -> int:
    """Where the digest's characters are; the facts can't hold this text, since quotes in them are escaped."""
    found = re.search(rb'"sha256":"[0-9a-f]{64}"', data[:HEADER_LIMIT])
    if found is None:
        raise DamagedCheckpoint("it has no checksum")
    return found.start() + len(b'"sha256":"')


class CheckpointWriter:
    """Writes a run's checkpoints.

    Args:
        folder: Where they go.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rolling: Path | None = None

    def write(self, steps: int, data: bytes | bytearray) -> None:
        """Replaces the run's newest checkpoint, whole or not at all."""
        self._folder.mkdir(parents=True, exist_ok=True)
        # A new name, not the old one again: ext4 would wait for the disk when a file takes another's place.
        path = self._folder / f"rollout-{steps:010d}{SUFFIX}"
        with whole_file(path, temporary="unfinished.tmp", durable=False) as file:
            file.write(data)
        former = self._folder.glob(f"rollout-*{SUFFIX}") if self._rolling is None else [self._rolling]
        for each in former:
            if each != path:
                each.unlink(missing_ok=True)
        self._rolling = path

    def keep(self, count: int = KEPT) -> None:
        """Makes the newest checkpoint one of ``count`` that are kept, and waits until the disk has it."""
        if self._rolling is None:
            return
        with self._rolling.open("rb") as file:
            os.fsync(file.fileno())
        self._rolling.replace(self._folder / self._rolling.name.replace("rollout", "step"))
        self._rolling = None
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
        for old in sorted(self._folder.glob(f"step-*{SUFFIX}"))[:-count]:
            old.unlink()


def checkpoints(folder: Path) -> list[Path]:
    """A run's checkpoints, oldest first."""
    return sorted(
        [*folder.glob(f"step-*{SUFFIX}"), *folder.glob(f"rollout-*{SUFFIX}")], key=lambda path: path.stem[-10:]
    )


def kept_checkpoints(folder: Path) -> list[Path]:
    """Those of a run's checkpoints that stay when the next update is saved, oldest first."""
    return [path for path in checkpoints(folder) if path.stem.startswith("step-")]


def find_checkpoint(folder: Path, name: str | None = None) -> Path:
    """A run's checkpoint by its file's name, with or without leading zeros and ending; the newest without a name.

    Raises:
        TrainerError: There is none of that name (those that there are, are named), or none at all.
    """
    found = checkpoints(folder)
    if not found:
        raise TrainerError(f"{folder} holds no checkpoint (*{SUFFIX}); train the run first.")
    if name is None:
        return found[-1]
    for path in found:
        if _short(path.stem) == _short(name.removesuffix(SUFFIX)):
            return path
    raise TrainerError(
        f"There is no checkpoint {name!r} in {folder}; there are: {', '.join(_short(path.stem) for path in found)}."
    )


def read_checkpoint(folder: Path, name: str | None = None) -> Checkpoint:
    """Reads a run's checkpoint; the newest without a name.

    Raises:
        TrainerError: There is none, or it is damaged (the newest good one is named), or of a later version.
    """
    for _ in range(20):  # a run that is being trained replaces its newest one while we look
        path = find_checkpoint(folder, name)
        try:
            return _read(path)
        except FileNotFoundError:
            continue
        except DamagedCheckpoint as damage:
            raise TrainerError(f"The checkpoint {path} is damaged: {damage}. {_offer(folder, path)}") from damage
    raise TrainerError(f"The checkpoints in {folder} change too fast to be read; stop the run first.")


def read_checkpoint_file(path: Path) -> Checkpoint:
    """Reads one checkpoint.

    Raises:
        TrainerError: It can't be read, is damaged, or of a later version.
    """
    try:
        return _read(path)
    except FileNotFoundError as error:
        raise TrainerError(
            f"There is no checkpoint {path}; give a run's folder, or a file in its checkpoints."
        ) from error
    except DamagedCheckpoint as damage:
        raise TrainerError(f"The checkpoint {path} is damaged: {damage}; give another one.") from damage


def _read(path: Path) -> Checkpoint:
    try:
        return from_bytes(path.read_bytes())
    except FileNotFoundError:
        raise
    except OSError as error:
        raise TrainerError(f"The checkpoint {path} can't be read ({error}).") from error


def _offer(folder: Path, damaged: Path) -> str:
    for path in reversed(checkpoints(folder)):
        try:
            if path != damaged:
                _read(path)
                return f"The last good one is {path.name}: delete {damaged.name} to go on from there."
        except (DamagedCheckpoint, TrainerError, FileNotFoundError):
            continue
    return "There is no good one; train the run again with --force."


def _short(stem: str) -> str:
    kind, _, steps = stem.rpartition("-")
    return f"{kind or 'step'}-{steps.lstrip('0') or '0'}"
