"""A client in a process of its own: ``python client_program.py PLAYER PORT AREAS``.

For every line that it reads, a number of seconds, it plays for so long and prints its exchanges per second.

The interpreter may be a Python 3.10 that has Unity's own client and nothing of ours: no newer syntax, and no import of
ours that must succeed. Python puts this folder first on its path, so no file here may have the name of a module that
this program needs.
"""

import contextlib
import sys
import time

import numpy as np

with contextlib.suppress(ImportError):
    import trainer  # noqa: F401 - makes mlagents_envs 0.28.0 importable

from mlagents_envs.base_env import ActionTuple
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel


def main(player: str, port: int, areas: int) -> None:
    """Launches the player, and plays with it whenever a line comes, until there are no more."""
    environment = UnityEnvironment(
        player, base_port=port, seed=1, no_graphics=True, num_areas=areas, side_channels=[StatsSideChannel()]
    )
    environment.reset()
    behavior = next(iter(environment.behavior_specs))
    actions = np.zeros((areas, 2), np.float32)
    print("ready", flush=True)
    for line in sys.stdin:
        begun, count = time.perf_counter(), 0
        while time.perf_counter() - begun < float(line):
            environment.set_actions(behavior, ActionTuple(continuous=actions))
            environment.step()
            environment.get_steps(behavior)
            count += 1
        print(count / (time.perf_counter() - begun), flush=True)
    environment.close()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
