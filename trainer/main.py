"""The ``corridor`` command."""

import dataclasses
import shlex
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from tyro.conf import subcommand

from corridor_server.standard_streams import drop_failing_output
from trainer.commands.bench import Bench
from trainer.commands.check import Check
from trainer.commands.evaluate import Evaluate
from trainer.commands.export import Export
from trainer.commands.replay import Replay
from trainer.commands.study import StudyCommand
from trainer.commands.train import Train
from trainer.commands.watch import Watch
from trainer.errors import TrainerError
from trainer.signals import INTERRUPTED, interrupt_on_stop_signals

ENV_ARGS = "--env-args"

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


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the process's exit code."""
    drop_failing_output()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    env_args = []
    if ENV_ARGS in arguments:  # what follows is the player's, dashes and all, as with mlagents-learn
        at = arguments.index(ENV_ARGS)
        arguments, env_args = arguments[:at], arguments[at + 1 :]
    console = Console(stderr=True)
    try:
        command = tyro.cli(
            Command, prog="corridor", args=arguments, config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes)
        )
        if env_args and isinstance(command, Train):
            command = dataclasses.replace(command, env_args=tuple(env_args))
        interrupt_on_stop_signals()
        return command.run(shlex.join(["corridor", *arguments]))
    except TrainerError as error:
        console.print(f"[bold red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return 1
    except OSError as error:
        of = f" {error.filename}" if error.filename else ""
        text = f"The system refuses{of}: {error.strerror or error}."
        console.print(f"[bold red]error:[/] {escape(text)}", highlight=False, soft_wrap=True)
        return 1
    except KeyboardInterrupt:
        console.print("Stopped.")
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
