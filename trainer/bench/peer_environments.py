"""Where peers are installed: each in a virtual environment of its own in a cache folder, away from the user's."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import corridor_server
from trainer.bench import peers
from trainer.errors import TrainerError
from trainer.signals import temporary_folder

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "curious-corridor" / "peers"
ERROR = re.compile(r"([\w.]*Error: |ERROR: )")
WHOLE = "whole.txt"  # in an environment whose packages are all there: what was asked for


@dataclass(frozen=True)
class Peer:
    """A PPO that is measured.

    Attributes:
        name: As rows have it.
        module: The program, in ``trainer.bench.peers``.
        package: Whose version and size are reported, as pip would be told to install it.
        pins: What its own environment has, with exact versions; None for what this environment has anyway.
        built_with: What has to be there before, where pip compiles it: it is compiled for that, and not for the newest.
        c: Curiosity's strength.
        over_grpc: Whether the corridor is a player's.
    """

    name: str
    module: str
    package: str
    pins: tuple[str, ...] | None = None
    built_with: tuple[str, ...] = ()
    c: float = 0.0
    over_grpc: bool = False


def install(peer: Peer) -> str:
    """The interpreter for a peer: this one, or that of its own environment, which is made if it isn't there.

    Raises:
        TrainerError: It can't be installed.
    """
    if peer.pins is None:
        return sys.executable
    folder = CACHE / peer.module
    python, whole, wanted = folder / "bin" / "python", folder / WHOLE, "\n".join(peer.pins)
    if whole.exists() and whole.read_text() == wanted and python.exists():
        return str(python)
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        commands = [[sys.executable, "-m", "venv", str(folder)], [*pip, *peer.pins]]
        if peer.built_with:
            commands[1:] = [[*pip, *peer.built_with], [*pip, "--no-build-isolation", *peer.pins]]
        for command in commands:
            made = subprocess.run(command, capture_output=True, text=True, env=_for_building())
            if made.returncode:
                raise TrainerError(f"{peer.name} can't be installed: {_reason(made.stdout + made.stderr)}")
        whole.write_text(wanted)
    except OSError as error:
        raise TrainerError(f"{peer.name} can't be installed in {folder} ({error.strerror or error}).") from error
    return str(python)


def _reason(said: str) -> str:
    """The last line of what pip said that names an error, or else the last."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    return next((line for line in reversed(lines) if ERROR.match(line)), lines[-1] if lines else "pip said nothing.")


def _for_building() -> dict[str, str]:
    """Environment variables under which pip compiles for the processor: PufferLib builds for CUDA where it finds it."""
    folders = [each for each in os.environ.get("PATH", "").split(os.pathsep) if not Path(each, "nvcc").exists()]
    return {**os.environ, "PATH": os.pathsep.join(folders)}


def same_torch() -> str:
    """The requirement of the torch that is installed here, of whichever build pip is told to take."""
    return f"torch=={version('torch').partition('+')[0]}"


@contextmanager
def importable() -> Iterator[dict[str, str]]:
    """The environment variables with which any interpreter imports ``corridor_server`` and ``trainer.bench.peers``.

    And nothing else of ours: PYTHONPATH is a folder of links to these two, since that which holds them may hold all of
    this interpreter's packages as well.
    """
    with temporary_folder() as folder:
        (folder / "trainer" / "bench").mkdir(parents=True)
        for inside in ("trainer", "trainer/bench"):
            (folder / inside / "__init__.py").touch()
        (folder / "trainer" / "bench" / "peers").symlink_to(Path(peers.__path__[0]).absolute())
        (folder / "corridor_server").symlink_to(Path(corridor_server.__path__[0]).absolute())
        yield {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}


def installed(python: str, package: str, variables: dict[str, str]) -> dict[str, Any]:
    """The ``version`` of a package, and ``install_mb``, with all that it needs, where an interpreter has it."""
    command = [python, "-m", "trainer.bench.peers.install_size", package]
    found = subprocess.run(command, capture_output=True, text=True, env=variables, cwd=variables["PYTHONPATH"])
    if found.returncode:
        return {"version": None, "install_mb": None}
    values = json.loads(found.stdout)
    return {"version": values["version"], "install_mb": round(values["bytes"] / 1e6)}
