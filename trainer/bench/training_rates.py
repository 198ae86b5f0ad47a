"""How fast ``corridor train`` is: by preset, with and without curiosity, with one player and with several."""

import json
import statistics
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from trainer.bench.instant_trainer import instant_trainer
from trainer.bench.workload import Workload
from trainer.errors import TrainerError
from trainer.signals import temporary_folder


def preset_rates(port: int, workload: Workload) -> list[dict[str, Any]]:
    """Agent steps per second of training, and the exchange's share of the time, by preset and curiosity.

    Raises:
        TrainerError: A run failed.
    """
    kinds = (("fast", 0.3), ("fast", 0.0), ("paper", 0.3))
    options = {(preset, c): ["--preset", preset, "--c", str(c)] for preset, c in kinds}
    summaries = _train_in_turn(options, port, workload)
    measures = ("steps_per_second", "exchange_share")
    return [
        {"c": c, "preset": preset, **{name: statistics.median(each[name] for each in found) for name in measures}}
        for (preset, c), found in summaries.items()
    ]


def player_rates(port: int, workload: Workload) -> list[dict[str, Any]]:
    """Training with as many areas in one player and in several, and what an instant trainer has with them.

    Raises:
        TrainerError: A run failed, or a player can't be started.
    """
    kinds = {kind: ["--num-envs", str(kind[0]), "--num-areas", str(kind[1])] for kind in workload.players}
    summaries = _train_in_turn(kinds, port, workload)
    limits: dict[tuple[int, int], list[float]] = {kind: [] for kind in workload.players}
    with ExitStack() as stack:
        trainers = {}
        for players, areas in workload.players:
            trainers[players, areas] = stack.enter_context(instant_trainer(players, areas, port))
            port += players
        for _ in range(workload.rounds):
            for (players, areas), trainer in trainers.items():
                limits[players, areas].append(trainer.rate(workload.seconds) * players * areas)
    return [
        {
            "num_envs": players,
            "num_areas": areas,
            "steps_per_second": statistics.median(each["steps_per_second"] for each in summaries[players, areas]),
            "limit": statistics.median(limits[players, areas]),
        }
        for players, areas in workload.players
    ]


def _train_in_turn(kinds: Mapping[Any, list[str]], port: int, workload: Workload) -> dict[Any, list[dict[str, Any]]]:
    """Summaries of the runs with each kind's options."""
    summaries: dict[Any, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    with temporary_folder() as folder:
        for kind, options in [*kinds.items()] * workload.train_rounds:
            steps = workload.train_steps["paper" if "paper" in options else "fast"]
            command = [sys.executable, "-m", "trainer.main", "train", "--run-id", "bench", "--results-dir", str(folder)]
            command += ["--force", "--steps", str(steps), "--base-port", str(port), "--eval-episodes", "1", *options]
            run = subprocess.run(command, capture_output=True, text=True)
            if run.returncode:
                raise TrainerError(f"A training run failed: {run.stderr.strip().splitlines()[-1]}")
            summaries[kind].append(json.loads((folder / "bench" / "summary.json").read_text()))
    return summaries
