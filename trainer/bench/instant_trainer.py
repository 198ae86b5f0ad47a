"""A trainer that answers at once, without reading: what no Python client can beat."""

import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

import grpc
import numpy as np

from corridor_server.corridor.areas import BEHAVIOR
from corridor_server.protocol import columnar
from corridor_server.protocol.agents import ActionBatch
from corridor_server.protocol.messages import RESET
from corridor_server.protocol.trainer_messages import command, initialization, stopping
from trainer.bench.bare_server import serve
from trainer.bench.our_player import player_path
from trainer.errors import TrainerError

START_SECONDS = 20
END_SECONDS = 20


def zero_step(areas: int) -> bytes:
    """A STEP in which every area's agent does nothing."""
    nothing = ActionBatch(np.zeros((areas, 2), np.float32), np.empty((areas, 0), np.int32))
    return columnar.write_step({BEHAVIOR: nothing}, b"")


class InstantTrainer:
    """Leads players through the handshake, then answers all of them with the same STEP as soon as each has asked.

    Args:
        players: Number of players.
        areas: In each player.

    Attributes:
        ready: Set once every player has sent its first agents.
    """

    def __init__(self, players: int, areas: int) -> None:
        opening: list[bytes] = [
            initialization(seed=1, num_areas=areas).SerializeToString(),
            command(RESET).SerializeToString(),
        ]
        self._openings = [list(opening) for _ in range(players)]
        self._step = zero_step(areas)
        self._stop: bytes = stopping().SerializeToString()
        self._all_asked = threading.Barrier(players)
        self.ready, self._measuring, self._ended = threading.Event(), threading.Event(), False
        self._exchanges = 0

    def answer(self, player: int, request: bytes, context: grpc.ServicerContext) -> bytes:
        """The reply to a player's message, once all players have sent theirs (runs in a gRPC thread)."""
        if self._openings[player]:
            return self._openings[player].pop(0)
        with suppress(threading.BrokenBarrierError):  # closed
            self._all_asked.wait()
        self.ready.set()
        self._measuring.wait()
        self._exchanges += player == 0
        return self._stop if self._ended else self._step

    def rate(self, seconds: float) -> float:
        """Lets the players go on for so long; returns the exchanges of each per second."""
        before, begun = self._exchanges, time.perf_counter()
        self._measuring.set()
        time.sleep(seconds)
        self._measuring.clear()
        return (self._exchanges - before) / (time.perf_counter() - begun)

    def close(self) -> None:
        """Has every player stop."""
        self._ended = True
        self._all_asked.abort()
        self._measuring.set()


@contextmanager
def instant_trainer(players: int, areas: int, port: int) -> Iterator[InstantTrainer]:
    """An instant trainer with its players, as processes, that wait only as long as gRPC takes to bring an answer.

    Args:
        players: Number of players.
        areas: In each player.
        port: The first player's; each has one of its own.

    Raises:
        TrainerError: A player sent no agents.
    """
    trainer = InstantTrainer(players, areas)
    with ExitStack() as stack:
        for number in range(players):
            server, listening = serve(partial(trainer.answer, number), port + number)
            stack.callback(server.stop, grace=None)
            player = [player_path(), "--mlagents-port", str(listening)]
            stack.callback(subprocess.Popen(player, stderr=subprocess.DEVNULL).wait, END_SECONDS)
        stack.callback(trainer.close)
        if not trainer.ready.wait(START_SECONDS):
            raise TrainerError(f"{player_path()} sent no batch within {START_SECONDS} s; run it by hand.")
        yield trainer
