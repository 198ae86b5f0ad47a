"""What the two commands cost before and beside the work: time to start, and memory."""

import statistics
import subprocess
import sys
import time

import numpy as np
import psutil
from mlagents_envs.base_env import ActionTuple

from corridor_server.corridor.areas import BEHAVIOR
from trainer.bench.our_player import our_client, player_path
from trainer.bench.workload import Workload

STARTS = 3


def startup_seconds() -> dict[str, float]:
    """Seconds until the player gives up a port where nobody listens, and until the trainer shows its help."""
    commands = {
        "corridor-server": [player_path(), "--mlagents-port", "1", "--timeout-wait", "0"],
        "corridor": [sys.executable, "-m", "trainer.main", "--help"],
    }
    seconds = {}
    for name, command in commands.items():
        found = []
        for _ in range(STARTS):
            begun = time.perf_counter()
            subprocess.run(command, capture_output=True)
            found.append(time.perf_counter() - begun)
        seconds[name] = statistics.median(found)
    return seconds


def memory_megabytes(port: int, workload: Workload) -> dict[str, dict[str, float]]:
    """Resident memory of the player and of this process, in MB, after so many agent steps."""
    found = {}
    actions, steps = np.zeros((workload.memory_areas, 2), np.float32), 0
    trainer = psutil.Process()
    others = set(trainer.children())
    with our_client(workload.memory_areas, port) as (environment, channel):
        (player,) = set(trainer.children()) - others
        for name, goal in workload.memory_steps.items():
            while steps < goal:
                environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
                environment.step()
                channel.get_and_reset_stats()
                steps += workload.memory_areas
            found[name] = {"player": _resident(player), "trainer": _resident(trainer)}
    return found


def _resident(process: psutil.Process) -> float:
    return round(process.memory_info().rss / 2**20, 1)
