"""A thousand connections leave nothing behind: no process, thread, port, descriptor or growing memory."""

import gc
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel

from corridor_server.connection import Connection
from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.player import Player
from trainer.players.environment import Environment
from trainer.players.opening import open_environment

PAGE = os.sysconf("SC_PAGE_SIZE")


def resident_megabytes() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def connect_and_close(port: int) -> None:
    """One whole session: our player in a thread, the trainer's side as it always is."""

    def play() -> None:
        time.sleep(0.01)  # dials when the trainer listens: a first try that fails costs a tenth of a second
        connection = Connection("localhost", port, timeout_wait=20, timeout_reply=20)
        Player(connection, lambda seed, count: Areas(CorridorConfig(), seed, range(count)), "test").run()
        connection.close()

    player = threading.Thread(target=play)
    player.start()
    environment = Environment(None, port, timeout_wait=20, seed=1, num_areas=2, side_channels=[StatsSideChannel()])
    environment.reset()
    environment.step()
    environment.close()
    player.join(20)
    assert not player.is_alive()


@pytest.mark.slow
def test_hundreds_of_sessions_leave_nothing_behind(free_port):
    for _ in range(100):
        connect_and_close(free_port)
    gc.collect()
    threads, files, memory = threading.active_count(), descriptors(), resident_megabytes()
    for _ in range(300):
        connect_and_close(free_port)
    gc.collect()
    assert threading.active_count() <= threads + 2
    assert descriptors() <= files + 4
    assert resident_megabytes() - memory < 10
    with socket.create_server(("127.0.0.1", free_port)):
        pass


@pytest.mark.slow
def test_sessions_of_real_processes_leave_nothing_behind(free_port):
    for seed in range(10):
        environment = open_environment("builtin", seed=seed, num_areas=1, port=free_port, timeout_wait=20)
        environment.reset()
        environment.close()
    found = subprocess.run(["pgrep", "-f", f"mlagents-port {free_port}"], capture_output=True, text=True)
    assert found.stdout == ""


INTERRUPTED_START = """
import signal, sys
from grpc import _server
from trainer.players.communicator import ExchangeCommunicator

signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent may have had it ignored
request = _server._request_call

def interrupted(state):
    request(state)
    signal.raise_signal(signal.SIGINT)  # gRPC's own server runs by now, but nobody serves it yet

_server._request_call = interrupted
try:
    ExchangeCommunicator(0, int(sys.argv[1]), timeout_wait=1)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_a_signal_while_the_trainer_begins_to_listen_ends_it(free_port):
    command = [sys.executable, "-c", INTERRUPTED_START, str(free_port)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert (run.stdout, run.returncode) == ("interrupted\n", 0), run.stderr
