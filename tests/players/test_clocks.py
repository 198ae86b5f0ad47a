"""A pause of this process is not its peer's silence, and a clock that is put back changes no duration."""

import csv
import os
import signal
import subprocess
import sys
import time

import grpc
import pytest
from conftest import BIN

from corridor_server.protocol.messages import EXCHANGE, OK, QUIT, RESET, UnityMessageProto
from corridor_server.protocol.trainer_messages import command
from corridor_server.shared import patience
from corridor_server.shared.patience import Patience
from trainer.conformance.raw_trainer import RawTrainer
from trainer.main import main
from trainer.runs import callbacks

PAUSE = 1.5  # seconds, of which a peer has one
YEAR = 365 * 24 * 3600

TRAINER = """
import sys
import trainer
from trainer.players.communicator import ExchangeCommunicator
communicator = ExchangeCommunicator(0, int(sys.argv[1]), timeout_wait=1)
communicator._timeout_wait = 30  # for the player to dial
received = communicator.receive()
communicator._timeout_wait = 1
for _ in range(3):
    communicator.send(received)
    print("waits", flush=True)
    received = communicator.receive()
print("done")
"""
CONFORMANCE = """
import sys
import trainer
from trainer.conformance.raw_trainer import RawTrainer
with RawTrainer(timeout=1, port=int(sys.argv[1])) as trainer:
    received = trainer.receive_bytes(timeout=30)
    for _ in range(3):
        trainer.reply_bytes(received)
        print("waits", flush=True)
        received = trainer.receive_bytes()
print("done")
"""


@pytest.mark.parametrize("program", [TRAINER, CONFORMANCE])
def test_a_paused_trainer_hears_what_its_player_said_meanwhile(program, free_port):
    trainer = subprocess.Popen([sys.executable, "-c", program, str(free_port)], stdout=subprocess.PIPE, text=True)
    assert trainer.stdout
    with grpc.insecure_channel(f"localhost:{free_port}") as channel:
        exchange, message = channel.unary_unary(EXCHANGE), UnityMessageProto()
        message.header.status = OK
        exchange(message.SerializeToString(), timeout=30, wait_for_ready=True)
        for _ in range(3):
            assert trainer.stdout.readline() == "waits\n"
            os.kill(trainer.pid, signal.SIGSTOP)
            reply = exchange.future(message.SerializeToString())
            time.sleep(PAUSE)
            os.kill(trainer.pid, signal.SIGCONT)
        assert trainer.stdout.readline() == "done\n"
        reply.cancel()
    trainer.kill()
    trainer.communicate()


def test_a_paused_player_hears_what_its_trainer_said_meanwhile(tmp_path):
    with RawTrainer() as trainer:
        arguments = ["--mlagents-port", str(trainer.port), "--timeout-reply", "1"]
        player = subprocess.Popen([BIN / "corridor-server", *arguments, "-logFile", str(tmp_path / "log")])
        trainer.handshake()
        for _ in range(3):
            os.kill(player.pid, signal.SIGSTOP)
            trainer.reply(command(RESET))
            time.sleep(PAUSE)
            os.kill(player.pid, signal.SIGCONT)
            trainer.receive()
        trainer.reply(command(QUIT))
        assert player.wait(15) == 0, (tmp_path / "log").read_text()


def test_a_peers_time_is_that_in_which_it_could_have_been_heard(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(patience.time, "monotonic", lambda: clock[0])

    def looks(*seconds: float) -> list[bool]:
        clock[0] = 0.0
        waiting, found = Patience(10.0), []
        for each in seconds:
            clock[0] += each
            found.append(waiting.is_over())
        return found

    assert looks(*[0.5] * 20) == [False] * 19 + [True]
    assert looks(*[0.9] * 11, 1000.0, 0.5) == [*[False] * 12, True]  # once more after waking
    assert looks(1000.0, *[0.95] * 10) == [*[False] * 10, True]  # which leaves the others as they were


def test_a_clock_that_is_put_back_does_not_change_what_is_logged(tmp_path, free_port, monkeypatch):
    real, calls = time.time_ns, []

    def put_back() -> int:
        calls.append(None)
        return real() - (YEAR * 10**9 if len(calls) > 1 else 0)

    monkeypatch.setattr(time, "time_ns", put_back)
    monkeypatch.setattr(callbacks, "ROW_STEPS", 128)  # those of an update
    options = ["--run-id", "r", "--results-dir", str(tmp_path), "--base-port", str(free_port), "--num-areas", "8"]
    assert main(["train", *options, "--steps", "384", "--eval-episodes", "1"]) == 0
    assert calls
    with (tmp_path / "r" / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
        assert len(rows) == 3
        for row in rows:
            assert 0 <= float(row["wall_seconds"]) < 900
            assert 0 < float(row["steps_per_second"]) < 1e6
