"""``corridor bench``: how fast the wire and training are on this machine, side by side in one run.

Rates on a shared machine drift, so the things compared are open at the same time and measured in turn; the medians are
reported, and beside them ratios.
"""

import json
import logging
import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from trainer.activity import doing
from trainer.bench.bench_report import (
    exchange_heading,
    exchange_line,
    limit_heading,
    limit_line,
    memory_line,
    players_line,
    plot_report,
    startup_line,
    train_line,
    world_line,
)
from trainer.bench.beside_peers import EVERYONE, beside_peers
from trainer.bench.exchange_rates import exchange_rates, world_rate
from trainer.bench.footprint import memory_megabytes, startup_seconds
from trainer.bench.limit_parts import limit_parts
from trainer.bench.peer_environments import Peer
from trainer.bench.peers_report import plot_peers, print_heading, print_peer
from trainer.bench.training_rates import KINDS, player_rates, preset_rates
from trainer.bench.workload import FULL, Workload
from trainer.files import write_whole
from trainer.learning.kernels import PROBLEM
from trainer.terminal import Terminal

PACKAGES = ("curious-corridor", "mlagents-envs", "grpcio", "protobuf", "numpy", "torch", "stable-baselines3")


def run_bench(
    json_file: Path | None,
    plot: Path | None,
    official: str | None,
    port: int,
    console: Terminal,
    workload: Workload = FULL,
) -> None:
    """Measures everything; what has been measured is printed and is in the JSON file at once, whatever comes next.

    Args:
        json_file: Where to write the report.
        plot: Where to draw it, as PNG, at the end.
        official: A Python interpreter that has Unity's own client, to be measured beside.
        port: The first port for players.
        console: Where to print.
        workload: How much to measure.

    Raises:
        TrainerError: A client can't be started, or a training run failed.
    """
    _say_slower(console)
    logging.getLogger("mlagents_envs").setLevel(logging.ERROR)
    report: dict[str, Any] = {"machine": _machine()}

    def measured(name: str, value: Any, *lines: str) -> None:
        report[name] = value
        _keep(report, json_file)  # before anybody can see the row, and stop
        for line in lines:
            console.print(line)

    exchange: list[dict[str, Any]] = []
    for areas in workload.areas:
        with doing(f"Measuring the exchange with {areas:,} areas"):
            exchange.append(exchange_rates(areas, official, port, workload))
        heading = [exchange_heading()] if len(exchange) == 1 else []
        measured("exchange", exchange, *heading, exchange_line(exchange[-1]))
    world: list[dict[str, Any]] = []
    for areas in workload.areas:
        with doing(f"Measuring the world in process with {areas:,} areas"):
            world.append({"areas": areas, "steps_per_second": world_rate(areas, workload)})
        measured("world", world, world_line(world[-1]))
    with doing("Training with and without curiosity", len(KINDS) * workload.train_rounds) as tell:
        for trained in preset_rates(port, workload, tell):
            measured("train", trained)
    measured("train", trained, *map(train_line, trained))
    with doing("Measuring what an update is spent in"):
        limit = limit_parts(port, workload)
    measured("limit", limit, limit_heading(limit), *(limit_line(limit, name) for name in limit["parts"]))
    with doing("Training with one player and with several", len(workload.players) * workload.train_rounds) as tell:
        players = player_rates(port, workload, tell)
    measured("players", players, *map(players_line, players))
    with doing("Measuring how long both commands take to start"):
        startup = startup_seconds()
    measured("startup_seconds", startup, *(startup_line(*each) for each in startup.items()))
    with doing("Measuring memory"):
        memory = memory_megabytes(port, workload)
    measured("memory_mb", memory, *(memory_line(*each) for each in memory.items()))
    if plot is not None:
        plot_report(report, plot)


def run_peers(
    json_file: Path | None,
    plot: Path | None,
    official: str | None,
    port: int,
    console: Terminal,
    workload: Workload = FULL,
    peers: Sequence[Peer] = EVERYONE,
) -> None:
    """Measures PPO beside others, prints each row when it is there, and keeps what there is in the JSON.

    Args:
        json_file: Where to write the report, after every row.
        plot: Where to draw it, as PNG.
        official: A Python interpreter with mlagents 1.1.0, to be measured beside.
        port: The first port for players.
        console: Where to print.
        workload: How much to measure.
        peers: Which; the first is the one that all are measured beside.

    Raises:
        TrainerError: This trainer can't be measured, or this system can't hold a process to a core.
    """
    _say_slower(console)
    report: dict[str, Any] = {"machine": _machine(), "peers": []}
    print_heading(console)
    rows = beside_peers(official, port, workload, peers)
    while True:
        with doing("Installing others, and training beside them"):
            row = next(rows, None)
        if row is None:
            break
        report["peers"].append(row)
        print_peer(row, console)
        _keep(report, json_file)
    if plot is not None:
        plot_peers(report["peers"], plot)


def _keep(report: dict[str, Any], json_file: Path | None) -> None:
    if json_file is not None:
        write_whole(json_file, json.dumps(report, indent=2) + "\n")


def _say_slower(console: Terminal) -> None:
    if PROBLEM is not None:
        console.print(PROBLEM, style="yellow")


def _machine() -> dict[str, Any]:
    return {
        "cpus": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
    }
