"""The commands of ``corridor``, and what becomes of what is typed."""

import operator
import shlex
import sys
from functools import reduce
from importlib import import_module
from typing import Annotated, Any

import tyro
from tyro.conf import subcommand

from trainer.commands.typed_values import TYPED
from trainer.errors import SettingError, TrainerError
from trainer.signals import INTERRUPTED

ENV_ARGS = "--env-args"
COMMAND_MODULES = "trainer.commands"
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

# Of mlagents-learn's options those that have another name here.
OF_MLAGENTS_LEARN = {
    "--initialize-from": "name that run's folder as a behavior's init_path in the file",
    "--torch-device": "--device says where networks compute",
    "--inference": "corridor evaluate plays what was trained",
    "--deterministic": "an evaluation plays the most likely actions; of training, network_settings has deterministic",
    "--load": "--resume goes on with a run",
    "--debug": "leave it out",
    "--no-graphics-monitor": "--no-graphics is the default here; leave it out",
}


def run_command(arguments: list[str]) -> int:
    """Runs a command; returns the process's exit code."""
    typed = shlex.join(["corridor", *arguments])
    env_args, given = [], ENV_ARGS in arguments
    if given:  # what follows is the player's, dashes and all, as with mlagents-learn
        at = arguments.index(ENV_ARGS)
        arguments, env_args = arguments[:at], arguments[at + 1 :]
    try:
        command = parse(arguments)
        if given and hasattr(command, "with_env_args"):
            command = command.with_env_args(tuple(env_args))
        elif given:
            raise TrainerError(
                f"{ENV_ARGS} is for corridor train, study and check, and a run keeps what it was trained with; leave "
                "it out, with all that follows it."
            )
        code: int = command.run(typed)
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


def parse(arguments: list[str]) -> Any:
    """The command that is typed, with its file's values where it has a file. Only its own module is read.

    Raises:
        TrainerError: An option is out of its range, options contradict each other, or the file can't be used.
        SystemExit: An option or a command is misspelt, or help was asked for; that has been printed.
    """
    name, rest = arguments[0] if arguments else "", arguments[1:]
    if name not in COMMANDS:
        every: Any = reduce(operator.or_, (Annotated[_kind(each), subcommand(each)] for each in COMMANDS))
        return _read(every, "corridor", arguments)
    kind, typed = _kind(name), f"corridor {name}"
    if name == "study" and rest and rest[0] in (studies := import_module(f"{COMMAND_MODULES}.study").STUDIES):
        kind, typed, rest = studies[rest[0]], f"{typed} {rest[0]}", rest[1:]
    for each in rest if name == "train" else []:
        if (option := each.partition("=")[0]) in OF_MLAGENTS_LEARN:
            raise TrainerError(f"{option} is mlagents-learn's; {OF_MLAGENTS_LEARN[option]}.")
    try:
        command = _read(kind, typed, rest)
        over = command.over_its_file() if name == "train" else None
        return command if over is None else _read(kind, typed, rest, default=over)
    except SettingError as error:
        raise TrainerError(f"{str(error).removesuffix('.')}; see {typed} --help.") from error


def _read(kind: Any, typed: str, arguments: list[str], **options: Any) -> Any:
    return tyro.cli(kind, prog=typed, args=arguments, config=MARKERS, registry=TYPED, **options)


def _kind(name: str) -> Any:
    return getattr(import_module(f"{COMMAND_MODULES}.{name}"), COMMANDS[name])
