"""Records what tests/protocol/test_wire.py replays: ``python tests/golden/record.py`` after a wanted change.

A line is ``player`` or ``trainer`` and a message's bytes in base64. It covers the handshake, parameters as a float and
as a sampler, actions in both fields, ended and interrupted episodes, a reset in mid-episode, a camera, and QUIT.
"""

import base64
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from corridor_server.connection import Connection
from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.player import Player
from corridor_server.protocol.messages import QUIT, RESET
from corridor_server.protocol.side_channels import ENVIRONMENT_PARAMETERS, message
from corridor_server.protocol.trainer_messages import command, initialization, step
from trainer.conformance.channels import environment_parameter
from trainer.conformance.raw_trainer import RawTrainer

RECORD = Path(__file__).with_name("conversation.txt")
BEHAVIOR = "Corridor?team=0"
# The parameter goal_z with a uniform sampler: seed 7, from 1 to 2.
SAMPLER = message(
    ENVIRONMENT_PARAMETERS, b"\x06\x00\x00\x00goal_z" + bytes.fromhex("01000000 07000000 00000000 0000803f 00000040")
)


def replies() -> Iterator[bytes]:
    """What the trainer says, in order."""
    yield initialization(seed=11, num_areas=2).SerializeToString()
    yield command(RESET, environment_parameter("max_episode_steps", 6.0) + SAMPLER).SerializeToString()
    for number in range(14):
        actions = {BEHAVIOR: [[-1.0, 0.25 * (number % 3)], [1.5, -0.5]]}
        # from here on, new episodes fail at their second step instead of being cut at the sixth
        side_channel = environment_parameter("failure_return", -0.002) if number == 3 else b""
        yield step(actions, side_channel, deprecated=number % 4 == 3).SerializeToString()
    yield command(RESET).SerializeToString()
    yield step({BEHAVIOR: [[0.0, 0.0], [0.0, 0.0]]}).SerializeToString()
    yield command(QUIT).SerializeToString()


def corridor(seed: int, num_areas: int) -> Areas:
    """The areas that are played, with a camera of 4x2 pixels."""
    return Areas(CorridorConfig(), seed, range(num_areas), camera=(4, 2))


def converse(answers: Iterator[bytes], hear: Callable[[str, bytes], None]) -> None:
    """Plays the trainer's part against our player, and lets ``hear`` have every message of both."""
    with RawTrainer() as trainer:
        connection = Connection("localhost", trainer.port, timeout_wait=10, timeout_reply=10)
        player = Player(connection, corridor, package_version="golden", compressed=False)
        thread = threading.Thread(target=player.run)
        thread.start()
        for answer in answers:
            hear("player", trainer.receive_bytes())
            hear("trainer", answer)
            trainer.reply_bytes(answer)
        thread.join()
        connection.close()


if __name__ == "__main__":
    lines: list[str] = []
    converse(replies(), lambda who, data: lines.append(f"{who} {base64.b64encode(data).decode()}\n"))
    RECORD.write_text("".join(lines))
