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

from trainer.bench.bench_report import plot_report, print_report
from trainer.bench.exchange_rates import exchange_rates, world_rate
from trainer.bench.footprint import memory_megabytes, startup_seconds
from trainer.bench.training_rates import player_rates, preset_rates
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
    """Measures everything, prints tables, and writes the JSON and the plot if asked to.

    Args:
        json_file: Where to write the report.
        plot: Where to draw it, as PNG.
        official: A Python interpreter that has Unity's own client, to be measured beside.
        port: The first port for players.
        console: Where to print.
        workload: How much to measure.

    Raises:
        TrainerError: A client can't be started, or a training run failed.
    """
    logging.getLogger("mlagents_envs").setLevel(logging.ERROR)
    report: dict[str, Any] = {"machine": _machine(), "exchange": [], "world": []}
    with console.status("Measuring") as status:
        for areas in workload.areas:
            status.update(f"Exchange with {areas} areas")
            report["exchange"].append(exchange_rates(areas, official, port, workload))
            report["world"].append({"areas": areas, "steps_per_second": world_rate(areas, workload)})
        status.update("Training with and without curiosity")
        report["train"] = preset_rates(port, workload)
        status.update("Training with one player and with several")
        report["players"] = player_rates(port, workload)
        status.update("Start-up and memory")
        report["startup_seconds"] = startup_seconds()
        report["memory_mb"] = memory_megabytes(port, workload)
    print_report(report, console)
    if json_file is not None:
        write_whole(json_file, json.dumps(report, indent=2) + "\n")
    if plot is not None:
        plot_report(report, plot)


def _machine() -> dict[str, Any]:
    return {
        "cpus": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
    }
