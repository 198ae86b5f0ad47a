"""The commands of ``corridor``, and what becomes of what is typed."""

import dataclasses
import shlex
from typing import Annotated

import tyro
from tyro.conf import subcommand

from trainer.commands.bench import Bench
from trainer.commands.check import Check
from trainer.commands.evaluate import Evaluate
from trainer.commands.export import Export
from trainer.commands.replay import Replay
from trainer.commands.study import StudyCommand
from trainer.commands.train import Train
from trainer.commands.watch import Watch
from trainer.errors import TrainerError
from trainer.signals import INTERRUPTED
from trainer.terminal import Terminal

ENV_ARGS = "--env-args"
MARKERS = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes)

Command = (
    Annotated[Train, subcommand("train")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[StudyCommand, subcommand("study")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Replay, subcommand("replay")]
    | Annotated[Watch, subcommand("watch")]
    | Annotated[Check, subcommand("check")]
    | Annotated[Bench, subcommand("bench")]
)


def run_command(arguments: list[str]) -> int:
    """Runs a command; returns the process's exit code."""
    env_args, given = [], ENV_ARGS in arguments
    if given:  # what follows is the player's, dashes and all, as with mlagents-learn
        at = arguments.index(ENV_ARGS)
        arguments, env_args = arguments[:at], arguments[at + 1 :]
    console = Terminal(stderr=True)
    try:
        command = tyro.cli(Command, prog="corridor", args=arguments, config=MARKERS)
        if isinstance(command, Train) and (over := command.over_its_file()) is not None:
            command = tyro.cli(Train, prog="corridor train", args=arguments[1:], default=over, config=MARKERS)
        if given and isinstance(command, Train | Check):
            command = dataclasses.replace(command, env_args=tuple(env_args))
        elif given:
            raise TrainerError(
                f"{ENV_ARGS} is for corridor train and check, and a run keeps what it was trained with; leave it out, "
                "with all that follows it."
            )
        return command.run(shlex.join(["corridor", *arguments]))
    except TrainerError as error:
        console.print_failure("error:", str(error))
        return 1
    except OSError as error:
        of = f" {error.filename}" if error.filename else ""
        console.print_failure("error:", f"The system refuses{of}: {error.strerror or error}.")
        return 1
    except KeyboardInterrupt:
        console.print("Stopped.")
        return INTERRUPTED
