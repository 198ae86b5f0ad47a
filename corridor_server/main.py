"""The ``corridor-server`` command: a player's process, as a trainer or a person starts it."""

import argparse
import importlib
import logging
import os
import signal
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import NoReturn

from corridor_server.connection import Connection, ConnectionBroken, ConnectionFailed
from corridor_server.player import MakeSimulation, Player, PlayerError
from corridor_server.player_options import check_options, check_pictures, package_version, parser
from corridor_server.shared.standard_streams import drop_failing_output
from corridor_server.simulations.simulation import SimulationError, Stopped

logger = logging.getLogger("corridor_server")


def main(arguments: Sequence[str] | None = None, make_simulation: MakeSimulation | None = None) -> int:
    """Runs a player.

    Args:
        arguments: Of the command line; the process's own if not given.
        make_simulation: Makes what is played, from a seed and a number of areas, where the command line doesn't say it.

    Returns:
        The process's exit code: 0 when the trainer ended the session, or itself.
    """
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _stop)
    drop_failing_output()
    os.environ.pop("GRPC_POLL_STRATEGY", None)  # gRPC aborts the process for one that it does not know
    try:
        return _run(arguments, make_simulation)
    except Stopped as stopped:
        logger.info("%s before a trainer was found.", stopped)
        return 0
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)  # it is ending


def _run(arguments: Sequence[str] | None, make_simulation: MakeSimulation | None) -> int:
    options, ignored = parser().parse_known_args(arguments)
    try:
        _start_log(options.log_file)
        if ignored:
            logger.info("Arguments ignored: %s", " ".join(ignored))
        check_options(options, make_simulation is not None)
        return _play(options, make_simulation or _simulation(options))
    except SimulationError as error:
        if error.__cause__ is not None:  # where in its author's code
            logger.info("Traceback:", exc_info=error.__cause__)
        logger.error("%s", error)
        return 1
    except (ValueError, OSError, ConnectionFailed, PlayerError) as error:
        logger.error("%s", error)
        return 1


def _simulation(options: argparse.Namespace) -> MakeSimulation:
    """What the options say is played, which can be made."""
    if options.gym is not None or options.pettingzoo is not None:
        sys.path.append("")  # an environment's module may lie where the player is started
        return _pettingzoo(options) if options.gym is None else _gymnasium(options)
    from corridor_server.corridor.areas import Areas
    from corridor_server.corridor.corridor_config import CorridorConfig

    config = CorridorConfig() if options.config is None else CorridorConfig.from_file(options.config)
    return lambda seed, count: Areas(config, seed, range(count), options.camera)


def _gymnasium(options: argparse.Namespace) -> MakeSimulation:
    try:
        from corridor_server.simulations import gymnasium_simulation as served
    except ModuleNotFoundError as error:
        raise _missing("--gym", error, "gym") from None
    environment = served.GymnasiumEnvironment(
        options.gym,
        options.env_kwargs or {},
        tuple(options.wrapper or ()),
        tuple(options.parameters or ()),
        options.camera,
        options.vectorization_mode or "sync",
    )
    check_pictures(options, options.gym, environment.check().values())
    return partial(served.GymnasiumSimulation, environment)


def _pettingzoo(options: argparse.Namespace) -> MakeSimulation:
    try:
        importlib.import_module("pettingzoo")
        from corridor_server.simulations import pettingzoo_simulation as served
    except ModuleNotFoundError as error:
        raise _missing("--pettingzoo", error, "pettingzoo") from None
    groups = options.group if options.group != [] else [served.EVERY_BEHAVIOR]
    environment = served.PettingZooEnvironment(
        options.pettingzoo,
        options.env_kwargs or {},
        tuple(options.behavior or ()),
        dict(options.team or ()),
        frozenset(groups or ()),
        tuple(options.parameters or ()),
    )
    check_pictures(options, options.pettingzoo, environment.check().values())
    return partial(served.PettingZooSimulation, environment)


def _missing(option: str, error: ModuleNotFoundError, extra: str) -> SimulationError:
    return SimulationError(
        f"{option} needs {error.name}, which is not installed: pip install curious-corridor[{extra}]"
    )


def _play(options: argparse.Namespace, make_simulation: MakeSimulation) -> int:
    connection = Connection(
        options.host, options.mlagents_port, options.timeout_wait, options.timeout_reply, options.parent
    )
    player = Player(
        connection,
        make_simulation,
        package_version(),
        options.seed,
        options.num_areas,
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
    logging.captureWarnings(True)  # Gymnasium's, which have the traceback of an environment in another process
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", handlers=[handler], force=True
    )


if __name__ == "__main__":
    sys.exit(main())
