"""How fast ``corridor train`` is: by preset, with and without curiosity, with one player and with several."""

import json
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any

from trainer.bench.instant_trainer import instant_trainer
from trainer.bench.workload import Workload
from trainer.errors import TrainerError
from trainer.signals import temporary_folder

KINDS = (("fast", 0.3), ("fast", 0.0), ("paper", 0.3))  # preset and c


def preset_rates(port: int, workload: Workload, tell: Callable[[int], None]) -> Iterator[list[dict[str, Any]]]:
    """Agent steps per second of training, and the exchange's share of the time, by preset and curiosity.

    Args:
        port: Of the player.
        workload: How much to train, and how often.
        tell: Told how many runs have ended.

    Yields:
        The rows after every round: medians of the rounds so far.

    Raises:
        TrainerError: A run failed.
    """
    options = {(preset, c): ["--preset", preset, "--c", str(c)] for preset, c in KINDS}
    measures = ("steps_per_second", "exchange_share")
    for summaries in _train_in_turn(options, port, workload, tell):
        yield [
            {"c": c, "preset": preset, **{name: statistics.median(each[name] for each in found) for name in measures}}
            for (preset, c), found in summaries.items()
        ]


def player_rates(port: int, workload: Workload, tell: Callable[[int], None]) -> list[dict[str, Any]]:
    """Training with as many areas in one player and in several, and what an instant trainer has with them.

    Args:
        port: Of the first player.
        workload: How much to train, and how often.
        tell: Told how many runs have ended.

    Raises:
        TrainerError: A run failed, or a player can't be started.
    """
    kinds = {kind: ["--num-envs", str(kind[0]), "--num-areas", str(kind[1])] for kind in workload.players}
    *_, summaries = _train_in_turn(kinds, port, workload, tell)
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


def _train_in_turn(
    kinds: Mapping[Any, list[str]], port: int, workload: Workload, tell: Callable[[int], None]
) -> Iterator[dict[Any, list[dict[str, Any]]]]:
    """Trains with each kind's options, one after the other in every round; the summaries so far after each."""
    summaries: dict[Any, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    with temporary_folder() as folder:
        for _ in range(workload.train_rounds):
            for kind, options in kinds.items():
                steps = workload.train_steps["paper" if "paper" in options else "fast"]
                command = [sys.executable, "-m", "trainer.main", "train", "--run-id", "bench"]
                command += ["--results-dir", str(folder), "--force", "--steps", str(steps), "--base-port", str(port)]
                run = subprocess.run([*command, "--eval-episodes", "1", *options], capture_output=True, text=True)
                if run.returncode:
                    raise TrainerError(f"A training run failed: {run.stderr.strip().splitlines()[-1]}")
                summaries[kind].append(json.loads((folder / "bench" / "summary.json").read_text()))
                tell(sum(map(len, summaries.values())))
            yield summaries
