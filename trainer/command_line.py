"""The commands of ``corridor``, and what becomes of what is typed."""

import dataclasses
import operator
import shlex
import sys
from functools import reduce
from importlib import import_module
from typing import Annotated, Any

import tyro
from tyro.conf import subcommand

from trainer.errors import TrainerError
from trainer.signals import INTERRUPTED

ENV_ARGS = "--env-args"
MARKERS = (tyro.conf.FlagCreatePairsOff, tyro.conf.HelptextFromCommentsOff, tyro.conf.OmitArgPrefixes)
# Each in the module of its name.
COMMANDS = {
    "train": "Train",
    "evaluate": "Evaluate",
    "study": "StudyCommand",
    "export": "Export",
    "replay": "Replay",
    "watch": "Watch",
    "check": "Check",
    "bench": "Bench",
}


def run_command(arguments: list[str]) -> int:
    """Runs a command; returns the process's exit code."""
    env_args, given = [], ENV_ARGS in arguments
    if given:  # what follows is the player's, dashes and all, as with mlagents-learn
        at = arguments.index(ENV_ARGS)
        arguments, env_args = arguments[:at], arguments[at + 1 :]
    try:
        command = _parse(arguments)
        if arguments[0] == "train" and (over := command.over_its_file()) is not None:
            command = _parse(arguments, default=over)
        if given and hasattr(command, "env_args"):
            command = dataclasses.replace(command, env_args=tuple(env_args))
        elif given:
            raise TrainerError(
                f"{ENV_ARGS} is for corridor train and check, and a run keeps what it was trained with; leave it out, "
                "with all that follows it."
            )
        code: int = command.run(shlex.join(["corridor", *arguments]))
        return code
    except TrainerError as error:
        return _fail(str(error))
    except OSError as error:
        of = f" {error.filename}" if error.filename else ""
        return _fail(f"The system refuses{of}: {error.strerror or error}.")
    except KeyboardInterrupt:
        print("Stopped.", file=sys.stderr)
        return INTERRUPTED


def _fail(text: str) -> int:
    from trainer.terminal import Terminal

    Terminal(stderr=True).print_failure("error:", text)
    return 1


def _parse(arguments: list[str], **options: Any) -> Any:
    """The command that is typed. Only its own module is read if it is one: each takes a while."""
    name = arguments[0] if arguments else ""
    if name in COMMANDS:
        return tyro.cli(_kind(name), prog=f"corridor {name}", args=arguments[1:], config=MARKERS, **options)
    every: Any = reduce(operator.or_, (Annotated[_kind(each), subcommand(each)] for each in COMMANDS))
    return tyro.cli(every, prog="corridor", args=arguments, config=MARKERS)


def _kind(name: str) -> Any:
    return getattr(import_module(f"trainer.commands.{name}"), COMMANDS[name])
