"""A player's command line: its options, what each takes, and which of them belong together."""

import argparse
import json
import re
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from corridor_server.decision_timing import TIMINGS
from corridor_server.protocol.agents import Behavior
from corridor_server.shared.addresses import LOOPBACK, PORTS, parse_host
from corridor_server.shared.given import MAX_AREAS, Range, shown

EDITOR_PORT = 5004
SEEDS = Range(-(2**31), 2**31 - 1)  # what the protocol carries
SECONDS = Range(0, 10**9)
PIXELS = Range(1, 1024)
TEAMS = Range(0, 2**31 - 1)
# An option -> with which of these it goes. None of them plays the corridor.
CORRIDOR, GYM, PETTINGZOO, OWN = "the corridor", "--gym", "--pettingzoo", "a simulation of its own"
GOES_WITH = {
    "config": (CORRIDOR,),
    "camera": (CORRIDOR, GYM),
    "camera_raw": (CORRIDOR, GYM, PETTINGZOO, OWN),
    "env_kwargs": (GYM, PETTINGZOO),
    "parameters": (GYM, PETTINGZOO),
    "wrapper": (GYM,),
    "vectorization_mode": (GYM,),
    "behavior": (PETTINGZOO,),
    "team": (PETTINGZOO,),
    "group": (PETTINGZOO,),
}


def package_version() -> str:
    """The installed package's; 0 in a checkout that is not installed."""
    try:
        return version("curious-corridor")
    except PackageNotFoundError:
        return "0"


def check_options(options: argparse.Namespace, own: bool = False) -> None:
    """Refuses an option that does nothing with the others.

    Args:
        options: As they were read.
        own: Whether a simulation of the caller's own is played, which is no matter of options.

    Raises:
        ValueError: There is one.
    """
    if options.gym is not None and options.pettingzoo is not None:
        raise ValueError("--gym and --pettingzoo are both given, but a player plays one of them.")
    played = GYM if options.gym is not None else CORRIDOR if options.pettingzoo is None else PETTINGZOO
    if own:
        if played != CORRIDOR:
            raise ValueError(f"{played} is given, but this program plays a simulation of its own.")
        played = OWN
    for name, kinds in GOES_WITH.items():
        if getattr(options, name) not in (None, False) and played not in kinds:
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option} goes with {' or '.join(kinds)}, but {played} is played.")
    if options.camera_raw and options.camera is None and played == CORRIDOR:
        raise ValueError("--camera-raw says how a picture is sent, but there is none; give its size with --camera.")


def check_pictures(options: argparse.Namespace, environment: str, behaviors: Iterable[Behavior]) -> None:
    """Refuses ``--camera-raw`` of an environment without pictures.

    Args:
        options: As they were read.
        environment: Its name, for the error.
        behaviors: All that it has.

    Raises:
        ValueError: It has none.
    """
    if options.camera_raw and not any(sensor.is_picture for behavior in behaviors for sensor in behavior.sensors):
        raise ValueError(f"--camera-raw says how a picture is sent, but {environment} has none; leave it out.")


def parser() -> argparse.ArgumentParser:
    """Reads the command line."""
    parser = argparse.ArgumentParser(
        prog="corridor-server",
        description="An ML-Agents player: the paper's corridor, or any Gymnasium or PettingZoo environment. Unknown "
        "arguments are ignored, as Unity does.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {package_version()}")
    _add_unitys(parser.add_argument_group("arguments that a trainer passes to any player"))
    _add_own(parser.add_argument_group("any player's own"))
    _add_corridors(parser.add_argument_group("the corridor"))
    _add_environments(parser.add_argument_group("a Gymnasium or PettingZoo environment instead of the corridor"))
    return parser


def _add_unitys(group: Any) -> None:
    group.add_argument(
        "--mlagents-port",
        type=_number(PORTS, whole=True),
        default=EDITOR_PORT,
        metavar="N",
        help="the trainer's port (default: %(default)s)",
    )
    group.add_argument(
        "-logFile", "-logfile", dest="log_file", metavar="PATH", help="log to this file; - is standard output"
    )
    group.add_argument("-nographics", action="store_true", help="accepted: there are no graphics")
    group.add_argument("-batchmode", action="store_true", help="accepted: there is no window")


def _add_own(group: Any) -> None:
    group.add_argument("--host", type=_host, default=LOOPBACK, help="the trainer's host (default: %(default)s)")
    group.add_argument(
        "--num-areas",
        type=_number(Range(1, MAX_AREAS), whole=True),
        metavar="N",
        help="areas, where the trainer asks for one or none",
    )
    group.add_argument(
        "--seed", type=_number(SEEDS, whole=True), metavar="N", help="used instead of the trainer's seed"
    )
    group.add_argument(
        "--timeout-wait",
        type=_number(SECONDS),
        default=60.0,
        metavar="S",
        help="seconds to wait for it (default: %(default)g)",
    )
    group.add_argument(
        "--timeout-reply",
        type=_number(SECONDS),
        default=3600.0,
        metavar="S",
        help="and for each reply (default: %(default)g)",
    )
    group.add_argument(
        "--parent",
        type=_number(Range(1, 2**31), whole=True),
        metavar="PID",
        help="the trainer that starts this player: not waited for once it is gone",
    )
    group.add_argument("--camera", type=_size, metavar="WIDTHxHEIGHT", help="add a picture as a visual observation")
    group.add_argument("--camera-raw", action="store_true", help="send pictures as floats instead of PNG")
    group.add_argument(
        "--decision-timing",
        choices=sorted(TIMINGS),
        default="together",
        help="unity: ended agents in a message of their own, and an idle step after a reset (default: %(default)s)",
    )


def _add_corridors(group: Any) -> None:
    group.add_argument("--config", type=Path, metavar="FILE", help="the corridor's parameters, YAML or JSON")


def _add_environments(group: Any) -> None:
    group.add_argument("--gym", metavar="ID", help="a registered Gymnasium environment; MODULE:ID imports one first")
    group.add_argument("--pettingzoo", metavar="MODULE", help="a module with parallel_env or env")
    group.add_argument("--env-kwargs", type=_object, metavar="JSON", help="arguments that the environment is made with")
    group.add_argument(
        "--parameters",
        nargs="+",
        metavar="NAME",
        help="attributes of the environment that a trainer may set, beside numbers in --env-kwargs",
    )
    group.add_argument(
        "--wrapper", action="append", metavar="MODULE:NAME", help="a Gymnasium wrapper around it; the inmost first"
    )
    group.add_argument(
        "--vectorization-mode", choices=("sync", "async"), help="async: a process per copy (default: sync)"
    )
    group.add_argument(
        "--behavior",
        type=_pattern,
        action="append",
        metavar="NAME=REGEX",
        help="the behavior of agents with such names; otherwise adversary_0 is of adversary",
    )
    group.add_argument("--team", type=_team, action="append", metavar="NAME=N", help="a behavior's team (default: 0)")
    group.add_argument(
        "--group",
        nargs="*",
        metavar="NAME",
        help="agents of these behaviors, or all, are a group per area, and a reward that all of it get is the group's",
    )


def _number(allowed: Range, whole: bool = False) -> Callable[[str], float]:
    def parse(text: str) -> float:
        number = allowed.parse(text, whole)
        if number is None:
            raise argparse.ArgumentTypeError(f"it is {shown(text)}, but {allowed.expected(whole)}.")
        return number

    return parse


def _host(text: str) -> str:
    try:
        return parse_host(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _size(text: str) -> tuple[int, int]:
    width, height = (PIXELS.parse(number, whole=True) for number in text.partition("x")[::2])
    if width is None or height is None:
        raise argparse.ArgumentTypeError(f"{shown(text)} is no picture size; 1x1 to 1024x1024 was expected.")
    return int(width), int(height)


def _object(text: str) -> dict[str, Any]:
    try:
        read = json.loads(text)
    except (ValueError, RecursionError):
        read = None
    if not isinstance(read, dict):
        raise argparse.ArgumentTypeError(
            f"it is {shown(text)}, but a JSON object was expected, such as '{{\"continuous\": true}}'."
        )
    return read


def _pattern(text: str) -> tuple[str, re.Pattern[str]]:
    name, separator, pattern = text.partition("=")
    try:
        if name and separator:
            return name, re.compile(pattern)
        wrong = "NAME=REGEX was expected"
    except (re.error, RecursionError, OverflowError) as error:
        wrong = f"its pattern is none ({error})"
    raise argparse.ArgumentTypeError(f"it is {shown(text)}, but {wrong}, such as 'adversary=adversary_.*'.")


def _team(text: str) -> tuple[str, int]:
    name, _, number = text.rpartition("=")
    team = TEAMS.parse(number, whole=True)
    if not name or team is None:
        raise argparse.ArgumentTypeError(f"it is {shown(text)}, but NAME=NUMBER was expected, such as 'agent=1'.")
    return name, int(team)
