"""The ``corridor-server`` command: a player's command line, as a trainer or a person uses it."""

import argparse
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import FrameType
from typing import NoReturn

from corridor_server.connection import Connection, ConnectionBroken, ConnectionFailed
from corridor_server.corridor.corridor_config import MAX_AREAS, CorridorConfig
from corridor_server.decision_timing import TIMINGS
from corridor_server.player import Player, PlayerError
from corridor_server.shared.addresses import LOOPBACK, PORTS, parse_host
from corridor_server.shared.given import Range, shown
from corridor_server.shared.standard_streams import drop_failing_output

EDITOR_PORT = 5004
SEEDS = Range(-(2**31), 2**31 - 1)  # what the protocol carries
SECONDS = Range(0, 10**9)
PIXELS = Range(1, 1024)
logger = logging.getLogger("corridor_server")


class Stopped(Exception):
    """A signal asked the player to stop."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a player; returns the process's exit code: 0 when the trainer ended the session, or itself."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _stop)
    drop_failing_output()
    os.environ.pop("GRPC_POLL_STRATEGY", None)  # gRPC aborts the process for one that it does not know
    try:
        return _run(arguments)
    except Stopped as stopped:
        logger.info("%s before a trainer was found.", stopped)
        return 0
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)  # it is ending


def _run(arguments: Sequence[str] | None) -> int:
    options, ignored = _parser().parse_known_args(arguments)
    try:
        _start_log(options.log_file)
        if ignored:
            logger.info("Arguments ignored: %s", " ".join(ignored))
        if options.camera_raw and options.camera is None:
            raise ValueError("--camera-raw says how a picture is sent, but there is none; give its size with --camera.")
        config = CorridorConfig() if options.config is None else CorridorConfig.from_file(options.config)
        return _play(options, config)
    except (ValueError, OSError, ConnectionFailed, PlayerError) as error:
        logger.error("%s", error)
        return 1


def _play(options: argparse.Namespace, config: CorridorConfig) -> int:
    connection = Connection(
        options.host, options.mlagents_port, options.timeout_wait, options.timeout_reply, options.parent
    )
    player = Player(
        connection,
        config,
        _package_version(),
        options.seed,
        options.num_areas,
        options.camera,
        compressed=not options.camera_raw,
        decision_timing=options.decision_timing,
    )
    try:
        player.run()
    except Stopped as stopped:
        logger.info("%s; the trainer is told.", stopped)
        player.say_farewell()
    except ConnectionBroken as broken:
        logger.warning("%s", broken)
    finally:
        connection.close()
    return 0


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    signal.signal(number, signal.SIG_IGN)
    raise Stopped(f"Stopped by {signal.Signals(number).name}")


def _start_log(path: str | None) -> None:
    handler: logging.Handler
    if path is None:
        handler = logging.StreamHandler(sys.stderr)
    elif path == "-":
        handler = logging.StreamHandler(sys.stdout)
    else:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(path, mode="w", encoding="utf-8", errors="backslashreplace")
    logging.raiseExceptions = False  # a full disk costs the log, not the run
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", handlers=[handler], force=True
    )


def _package_version() -> str:
    try:
        return version("curious-corridor")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "0"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="corridor-server",
        description="The paper's corridor as an ML-Agents player. Unknown arguments are ignored, as Unity does.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {_package_version()}")
    unity = parser.add_argument_group("arguments that a trainer passes to any player")
    unity.add_argument(
        "--mlagents-port",
        type=_number(PORTS, whole=True),
        default=EDITOR_PORT,
        metavar="N",
        help="the trainer's port (default: %(default)s)",
    )
    unity.add_argument(
        "-logFile", "-logfile", dest="log_file", metavar="PATH", help="log to this file; - is standard output"
    )
    unity.add_argument("-nographics", action="store_true", help="accepted: there are no graphics")
    unity.add_argument("-batchmode", action="store_true", help="accepted: there is no window")
    own = parser.add_argument_group("the corridor's own")
    own.add_argument("--host", type=_host, default=LOOPBACK, help="the trainer's host (default: %(default)s)")
    own.add_argument(
        "--num-areas",
        type=_number(Range(1, MAX_AREAS), whole=True),
        metavar="N",
        help="areas, where the trainer asks for one or none",
    )
    own.add_argument("--seed", type=_number(SEEDS, whole=True), metavar="N", help="used instead of the trainer's seed")
    own.add_argument("--config", type=Path, metavar="FILE", help="the corridor's parameters, YAML or JSON")
    own.add_argument(
        "--timeout-wait",
        type=_number(SECONDS),
        default=60.0,
        metavar="S",
        help="seconds to wait for it (default: %(default)g)",
    )
    own.add_argument(
        "--timeout-reply",
        type=_number(SECONDS),
        default=3600.0,
        metavar="S",
        help="and for each reply (default: %(default)g)",
    )
    own.add_argument(
        "--parent",
        type=_number(Range(1, 2**31), whole=True),
        metavar="PID",
        help="the trainer that starts this player: not waited for once it is gone",
    )
    own.add_argument("--camera", type=_size, metavar="WIDTHxHEIGHT", help="add a top view as a visual observation")
    own.add_argument(
        "--decision-timing",
        choices=sorted(TIMINGS),
        default="together",
        help="unity: ended agents in a message of their own, and an idle step after a reset (default: %(default)s)",
    )
    own.add_argument("--camera-raw", action="store_true", help="send it as floats instead of PNG")
    return parser


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


if __name__ == "__main__":
    sys.exit(main())
