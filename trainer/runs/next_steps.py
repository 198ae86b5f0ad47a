"""What can be done with a run that has just been trained, as commands that can be pasted."""

import shlex
import shutil
import sys
from pathlib import Path

from trainer.config import RESULTS
from trainer.runs.folder import RunFolder


def next_steps(folder: RunFolder, *, replay: bool, export: bool) -> str:
    """The lines that ``corridor train`` ends with.

    Args:
        folder: The run's.
        replay: Whether its evaluation can be shown.
        export: Whether its policies can be exported.
    """
    place = folder.shown.parent
    run = folder.path.name if place == RESULTS else str(folder.shown)
    commands = {
        "see what it learned": ["replay", run, "--open"] if replay else None,
        "watch learning curves": ["watch", "--open", *([] if place == RESULTS else ["--results-dir", str(place)])],
        "give the policy to Unity": ["export", run, "--onnx", f"{folder.path.name}.onnx"] if export else None,
    }
    lines = [
        f"  {f'{what}:':26}{shlex.join([_program(), *command])}"
        for what, command in commands.items()
        if command is not None
    ]
    return "\n".join(["What next?", *lines])


def _program() -> str:
    """How this program is called from here: in a folder of programs that the shell does not look in, with its path."""
    called = Path(sys.argv[0])
    if called.name != "corridor" or shutil.which("corridor") is not None:
        return "corridor"
    return str(called.relative_to(Path.cwd()) if called.is_relative_to(Path.cwd()) else called)
