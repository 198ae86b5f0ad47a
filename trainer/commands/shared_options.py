"""Options that several commands have."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from corridor_server.shared.given import Range
from trainer.config import PAPER_STEPS, RESULTS, PresetName
from trainer.errors import TrainerError
from trainer.options import Count, Options
from trainer.terminal import Terminal

if TYPE_CHECKING:
    from trainer.runs.folder import RunFolder

PRESET: PresetName = "fast"
STUDIED: PresetName = "case-studies"
ResultsDir = Annotated[Path, tyro.conf.arg(help="Where runs are kept.")]
Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
OpenPage = Annotated[bool, tyro.conf.arg(help="Open the page in the browser.", help_behavior_hint="")]
Episodes = Annotated[int, Range(1, otherwise="1 or more was expected")]


def check_file(path: Path, option: str) -> None:
    """Refuses a path that no file can be written to, before the work that it is for.

    Raises:
        TrainerError: It names no file, or its folder is not there or can't be written.
    """
    if not path.name or os.path.isdir(path) or not os.access(path.parent, os.W_OK):
        raise TrainerError(f"{option} {path} can't be written; give a file's name in a folder that is there.")


def open_page(address: str) -> None:
    """Opens a page in the user's browser, or says that there is none."""
    import webbrowser

    if not webbrowser.open(address):
        Terminal(stderr=True).print("No browser could be started; open the page by hand.")


@dataclass(frozen=True)
class TrainingOptions(Options):
    """How, and how long, a run trains."""

    preset: Annotated[
        PresetName | None, tyro.conf.arg(help_behavior_hint=f"(default: {PRESET}; of studies {STUDIED})")
    ] = None
    """What it begins as. fast has many copies of the training area at once, case-studies the same with a larger r_i
    (the studies'), threshold the same with a longer way, where c = 0.5 is too much, and paper one area, through
    UnityToGymWrapper, as the paper did."""
    steps: Annotated[
        Count | None, tyro.conf.arg(help_behavior_hint=f"(default: {PAPER_STEPS:,}, or what the file says)")
    ] = None
    """How many decisions to learn from, all agents' together (agent steps); over a file's max_steps."""
    eval_episodes: Count = 200
    """How many episodes the evaluation at the end plays."""


@dataclass(frozen=True)
class ExistingRun:
    """Where the run is."""

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run's id, or the path of its folder."""
    results_dir: ResultsDir = RESULTS

    def find(self) -> "RunFolder":
        """The run's folder.

        Raises:
            TrainerError: There is none.
        """
        from trainer.runs.folder import RunFolder

        return RunFolder.find(self.run, self.results_dir)
