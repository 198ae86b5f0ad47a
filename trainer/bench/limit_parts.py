"""What an update of the default preset is spent in, and how near that is to what a processor could do."""

import json
import subprocess
import sys
from typing import Any

from trainer.bench.workload import Workload
from trainer.errors import TrainerError
from trainer.presets import PRESETS
from trainer.signals import temporary_folder

# What the program's clock tells apart. Networks' time is then split in three.
NETWORKS = "networks"
EXCHANGE = "exchange: actions written, observations read"
WAITING = "waiting for the player and gRPC"
CHECKPOINT = "checkpoints"
STAGES = "slots, monitoring, normalisation, curiosity's rows"
OTHERS = "callbacks, logs, buffer, loop"
PRODUCTS = "networks: matrix products alone"
PYTHON = "networks: Python, the same calls on next to nothing"
ELEMENTWISE = "networks: elementwise work, and memory"
UNMEASURED = 10  # updates at the run's beginning, more than the program leaves out


def limit_parts(port: int, workload: Workload) -> dict[str, Any]:
    """Seconds of an update by what they are spent in, measured in a training run of the default preset with curiosity.

    Returns:
        ``updates`` that were measured; ``update_seconds``, their mean; ``parts``, by name, which add up to it; and
        ``networks_to_products``, how many times as long as their matrix products alone all calls of networks take.

    Raises:
        TrainerError: The run failed.
    """
    preset = PRESETS["fast"]
    steps = (workload.limit_updates + UNMEASURED) * preset.ppo.n_steps * preset.num_areas
    with temporary_folder() as folder:
        command = [sys.executable, "-m", "trainer.bench.limit_program", str(folder), str(steps), str(port)]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode:
            raise TrainerError(f"A training run failed: {(run.stderr.strip() or 'it said nothing').splitlines()[-1]}")
        return split(json.loads((folder / "parts.json").read_text()))


def split(measured: dict[str, Any]) -> dict[str, Any]:
    """What ``limit_parts`` returns, of what its program wrote.

    Args:
        measured: ``updates``; ``seconds`` of an update by part; ``products``, seconds of an update's matrix products
            alone; and ``calls``, seconds of as many calls of networks on next to nothing.
    """
    seconds: dict[str, float] = measured["seconds"]
    networks, products, calls = seconds[NETWORKS], measured["products"], measured["calls"]
    parts = {PRODUCTS: products, ELEMENTWISE: networks - products - calls, PYTHON: calls}
    parts |= {name: seconds.get(name, 0.0) for name in (EXCHANGE, WAITING, CHECKPOINT, STAGES, OTHERS)}
    return {
        "updates": measured["updates"],
        "update_seconds": sum(seconds.values()),
        "parts": parts,
        "networks_to_products": networks / products,
    }
