"""``corridor bench``: how fast the wire and training are on this machine, side by side in one run.

Rates on a shared machine drift, so the things compared are open at the same time and measured in turn; the medians are
reported, and beside them ratios.
"""

import json
import logging
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from trainer.activity import doing
from trainer.bench.bench_report import (
    exchange_heading,
    exchange_line,
    memory_line,
    players_line,
    plot_report,
    startup_line,
    train_line,
    world_line,
)
from trainer.bench.exchange_rates import exchange_rates, world_rate
from trainer.bench.footprint import memory_megabytes, startup_seconds
from trainer.bench.training_rates import KINDS, player_rates, preset_rates
from trainer.bench.workload import FULL, Workload
from trainer.files import write_whole
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
    logging.getLogger("mlagents_envs").setLevel(logging.ERROR)
    report: dict[str, Any] = {"machine": _machine()}

    def measured(name: str, value: Any, *lines: str) -> None:
        report[name] = value
        for line in lines:
            console.print(line)
        if json_file is not None:
            write_whole(json_file, json.dumps(report, indent=2) + "\n")

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


def _machine() -> dict[str, Any]:
    return {
        "cpus": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
    }
