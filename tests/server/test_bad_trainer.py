"""What our player does with a trainer that misbehaves: an exit code, and one sentence in its log."""

import subprocess
import time
from pathlib import Path

import pytest
from conftest import BIN
from prepared import Prepared

from corridor_server.protocol.messages import QUIT, UnityMessageProto
from corridor_server.protocol.trainer_messages import command, initialization, step, stopping
from trainer.conformance.channels import environment_parameter
from trainer.conformance.raw_trainer import RawTrainer

BEHAVIOR = "Corridor?team=0"
ONE = {BEHAVIOR: [[0.1, 0.2]]}


class Player:
    """Our player, dialling a raw trainer, with what it logged."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.trainer = RawTrainer()
        self._log = folder / "player.log"
        dialling = ("--mlagents-port", self.trainer.port, "-logFile", self._log)
        self.process = Prepared([BIN / "corridor-server", *dialling, *arguments])

    def begin(self) -> "Player":
        self.trainer.handshake()
        self.trainer.reset()
        return self

    def reach(self, at: str) -> "Player":
        """Goes on until this message of the player's has come, and its reply is due."""
        self.trainer.receive()
        if at != "hello":
            self.trainer.ask(initialization())
        if at in ("reset", "step"):
            self.trainer.reset()
        if at == "step":
            self.trainer.step(ONE)
        return self

    def ends(self, code: int, says: str) -> None:
        assert self.process.wait(15) == code
        lines = self._log.read_text().splitlines()
        assert says in lines[-1], lines
        assert not any("Traceback" in line for line in lines)

    def close(self) -> None:
        self.trainer.cut()
        self.process.kill()
        self.process.wait()


@pytest.fixture
def player(tmp_path):
    made = []

    def make(*arguments: str) -> Player:
        made.append(Player(tmp_path, *arguments))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.mark.parametrize("version", ["2.0.0", "0.9.0", "", "nonsense"])
def test_a_wrong_version_names_both(player, version):
    ours = player()
    ours.trainer.receive()
    farewell = ours.trainer.ask(initialization(version=version))
    assert farewell.header.status == 400
    ours.trainer.reply(stopping())
    ours.ends(1, f"The trainer speaks communication version {version or 'unknown'} and this player 1.5.0")


@pytest.mark.parametrize("areas", [-5, 2**31 - 1])
def test_an_impossible_number_of_areas(player, areas):
    ours = player("--num-areas", "1")
    ours.trainer.receive()
    ours.trainer.reply(initialization(num_areas=areas))
    if areas > 0:
        ours.ends(1, f"The trainer asks for {areas} areas, but 1 to 65536 can be served.")
    else:
        ours.trainer.receive()


@pytest.mark.parametrize("at", ["hello", "acknowledgement", "reset", "step"])
def test_status_400_at_every_point_is_an_orderly_end(player, at):
    ours = player().reach(at)
    ours.trainer.reply(stopping())
    assert ours.process.wait(15) == 0


@pytest.mark.parametrize("at", ["reset", "step"])
def test_a_cut_connection_is_an_end_of_the_session(player, at):
    ours = player().reach(at)
    ours.trainer.cut()
    ours.ends(0, "it stopped or was killed")


@pytest.mark.parametrize("at", ["hello", "acknowledgement"])
def test_a_connection_cut_in_the_handshake_says_that_nobody_plays_on(player, at):
    ours = player().reach(at)
    ours.trainer.cut()
    ours.ends(0, "That was in the handshake, where Unity's player would go on by itself; this one ends.")


def test_quit_at_once(player):
    ours = player()
    ours.trainer.handshake()
    ours.trainer.reply(command(QUIT))
    ours.ends(0, "The trainer ended the session.")


def test_quit_before_the_handshake_is_over(player):
    ours = player()
    ours.trainer.receive()
    ours.trainer.reply(command(QUIT))
    assert ours.process.wait(15) == 0


@pytest.mark.parametrize("timing", ["together", "unity"])
def test_a_storm_of_resets_keeps_the_ids(player, timing):
    ours = player("--num-areas", "2", "--decision-timing", timing).begin()
    for _ in range(500):
        infos = ours.trainer.reset().rl_output.agentInfos[BEHAVIOR].value
        assert [(info.id, info.done) for info in infos] == [(0, False), (1, False)]


@pytest.mark.parametrize(
    ("actions", "says"),
    [
        ({}, "The trainer sent 0 actions for behavior Corridor?team=0, but 1 agents asked for one."),
        ({BEHAVIOR: [[0.0, 0.0]] * 2}, "The trainer sent 2 actions for behavior Corridor?team=0"),
        ({"Other?team=0": [[0.0, 0.0]]}, "The trainer sent 0 actions for behavior Corridor?team=0"),
        ({BEHAVIOR: [[0.0]]}, "Action 0 has 1 continuous values, but 2 were expected."),
        ({BEHAVIOR: [[0.0] * 3]}, "Action 0 has 3 continuous values, but 2 were expected."),
        ({BEHAVIOR: [[]]}, "Action 0 has 0 continuous values, but 2 were expected."),
        ({BEHAVIOR: [[0.0, float("nan")]]}, "Action 0 is [0.0, nan], but finite numbers in [-1, 1] were expected"),
        ({BEHAVIOR: [[float("-inf"), 0.0]]}, "Action 0 is [-inf, 0.0], but finite numbers in [-1, 1] were expected"),
    ],
)
def test_actions_that_cant_be_used(player, actions, says):
    ours = player().begin()
    farewell = ours.trainer.ask(step(actions))
    assert farewell.header.status == 400, "the trainer is told"
    ours.trainer.reply(stopping())
    ours.ends(1, says)


@pytest.mark.parametrize(
    ("buffer", "says"),
    [
        (b"\x01\x02", "The side-channel buffer ends after 2 of a message header's 20 bytes."),
        (b"\x00" * 16 + b"\xff\xff\xff\x7f", "announces 2147483647 bytes, but 0 are left in the buffer."),
        (b"\x00" * 16 + b"\xff\xff\xff\xff", "announces -1 bytes"),
        (environment_parameter("goal_x", 1.0)[:-1], "534c891e-810f-11ea-a9d0-822485860400 announces 18 bytes"),
    ],
)
def test_side_channel_bytes_that_cant_be_read(player, buffer, says):
    ours = player().begin()
    assert ours.trainer.ask(step(ONE, buffer)).header.status == 400
    ours.trainer.reply(stopping())
    ours.ends(1, says)


@pytest.mark.parametrize("at", ["hello", "acknowledgement", "reset"])
def test_bytes_that_are_no_message(player, at):
    ours = player().reach(at)
    ours.trainer.reply_bytes(b"\xff\xff\xff")
    ours.ends(1, "sent 3 bytes that are not a protocol message; is it an ML-Agents trainer?")


def test_a_command_that_does_not_exist(player):
    ours = player().begin()
    assert ours.trainer.ask(command(7)).header.status == 400
    ours.trainer.reply(stopping())
    ours.ends(1, "The trainer sent command 7; STEP, RESET or QUIT was expected.")


def test_an_empty_message_is_a_status_other_than_200(player):
    ours = player().begin()
    ours.trainer.reply(UnityMessageProto())
    ours.ends(0, "The trainer ended the session.")


def test_a_reply_that_never_comes(player):
    ours = player("--timeout-reply", "0.5").begin()
    ours.ends(1, "sent no reply for 0.5 s; it hangs.")


def test_a_peer_that_is_no_trainer(tmp_path, free_port):
    from concurrent.futures import ThreadPoolExecutor

    import grpc

    server = grpc.server(ThreadPoolExecutor(1))
    server.add_insecure_port(f"localhost:{free_port}")
    server.start()
    run = subprocess.run([BIN / "corridor-server", "--mlagents-port", str(free_port)], capture_output=True, text=True)
    server.stop(None)
    assert run.returncode == 1
    assert f"What listens on localhost:{free_port} is no ML-Agents trainer (API 1.5.0)" in run.stderr


def test_a_second_player_is_refused_and_the_first_plays_on(open_corridor, free_port):
    environment = open_corridor()
    environment.reset()
    second = subprocess.run(
        [BIN / "corridor-server", "--mlagents-port", str(free_port)], capture_output=True, text=True, timeout=30
    )
    assert second.returncode == 1
    assert "has another player; give each player a port of its own" in second.stderr
    environment.step()


def test_a_trainer_that_starts_later_is_found(tmp_path, free_port):
    process = subprocess.Popen([BIN / "corridor-server", "--mlagents-port", str(free_port)])
    time.sleep(1.5)
    with RawTrainer(port=free_port) as trainer:
        trainer.handshake()
        assert trainer.reset().rl_output.agentInfos[BEHAVIOR].value
        trainer.reply(command(QUIT))
        assert process.wait(15) == 0


def test_a_reset_command_with_an_unknown_parameter_goes_on(player, tmp_path):
    ours = player().begin()
    ours.trainer.reset(environment_parameter("no\nsuch", 1.0))
    ours.trainer.reply(command(QUIT))
    assert ours.process.wait(15) == 0
    log = (tmp_path / "player.log").read_text()
    assert r"'no\nsuch' is not an environment parameter of the corridor; the nearest is" in log
    assert "It was ignored." in log
