"""A player of a few lines over gRPC alone, launched as a build is; what it does is a test's choice.

Its agents decide in every message, all end after the same number of steps, and keep their ids for life. It ignores
``num_areas``, as a scene without a TrainingAreaReplicator does.
"""

import itertools
import json
import sys
import time
from pathlib import Path
from typing import Any

import grpc

from corridor_server.protocol import side_channels
from corridor_server.protocol.messages import API_VERSION, EXCHANGE, OK, PNG, QUIT, RESET, STOP, UnityMessageProto

PROGRAM = """#!{python}
import sys
sys.path.insert(0, {tests!r})
from raw_player import play
play({log!r}, **{options!r})
"""


def write_player(folder: Path, **options: Any) -> tuple[Path, Path]:
    """The player's executable, and the file in which it writes what happens to it, one JSON list per line."""
    player, log = folder / "player", folder / "player.jsonl"
    player.write_text(
        PROGRAM.format(python=sys.executable, tests=str(Path(__file__).parent), log=str(log), options=options)
    )
    player.chmod(0o755)
    return player, log


def events(log: Path, kind: str) -> list[Any]:
    return [what for each, what in map(json.loads, log.read_text().splitlines()) if each == kind]


def play(
    log: str,
    behavior: str = "Raw?team=0",
    agents: int = 1,
    size: int = 3,
    length: int = 5,
    success: tuple[float | None, ...] = (1.0,),
    picture: tuple[tuple[int, int, int], bytes, list[int]] | None = None,
    announces_end_after: int | None = None,
    spoil: str = "",
    spoiled: tuple[int, ...] = (),
) -> None:
    """Plays until the trainer ends it.

    Args:
        log: The file.
        behavior: The behavior's name.
        agents: How many there are.
        size: Of the vector observation.
        length: Of every episode.
        success: What ended episodes report, in turn; None: cut by a step limit, and reports nothing.
        picture: Instead of the vector: shape, compressed data and channel mapping.
        announces_end_after: Steps after which the player says that it stops.
        spoil: Statements that change a ``message``, or make other bytes of it as ``data``.
        spoiled: The messages that they change, by number; -2 is the first of all, and 0 is the first with agents.
    """

    def note(kind: str, what: Any) -> None:
        with open(log, "a", encoding="utf-8") as file:
            file.write(json.dumps([kind, what]) + "\n")

    def observe(info: Any, step: int) -> None:
        observation = info.observations.add(name="seen")
        if picture is None:
            observation.shape.append(size)
            observation.float_data.data.extend([step / 10] * size)
        else:
            observation.shape.extend(picture[0])
            observation.compression_type = PNG
            observation.compressed_data = picture[1]
            observation.compressed_channel_mapping.extend(picture[2])

    port = sys.argv[sys.argv.index("--mlagents-port") + 1]
    count = itertools.count(-2)

    def serialise(message: Any) -> bytes:
        names = {"message": message, "data": None, "channels": side_channels}
        if next(count) in spoiled:
            exec(spoil, names)
        return message.SerializeToString() if names["data"] is None else names["data"]

    exchange = grpc.insecure_channel(f"localhost:{port}").unary_unary(EXCHANGE, serialise, UnityMessageProto.FromString)
    note("arguments", sys.argv[1:])
    hello = _message()
    hello.unity_output.rl_initialization_output.communication_version = API_VERSION
    exchange(hello, wait_for_ready=True)
    reply, introduced, steps, episodes, taken = exchange(_message()), False, 0, 0, 0
    while reply.header.status == OK and reply.unity_input.rl_input.command != QUIT:
        given = reply.unity_input.rl_input
        parameters = [
            side_channels.read_environment_parameter(payload)
            for channel, payload in side_channels.split(given.side_channel)
            if channel == side_channels.ENVIRONMENT_PARAMETERS
        ]
        if given.command == RESET:
            note("reset", dict(parameters))
            steps = 0
        else:
            steps, taken = steps + 1, taken + 1
        message, sent = _message(), []
        output = message.unity_output.rl_output
        if steps == length:
            for agent in range(agents):
                reported = success[episodes % len(success)]
                info = output.agentInfos[behavior].value.add(
                    id=agent, done=True, reward=1.0, max_step_reached=reported is None
                )
                observe(info, steps)
                sent.append(reported)
                episodes += 1
            steps = 0
        for agent in range(agents):
            observe(output.agentInfos[behavior].value.add(id=agent), steps)
        values = [value for value in sent if value is not None]
        output.side_channel = side_channels.write_statistics({"Corridor/Success": values} if values else {})
        if not introduced:
            brain = message.unity_output.rl_initialization_output.brain_parameters.add()
            brain.brain_name, brain.is_training, introduced = behavior, True, True
            brain.action_spec.num_continuous_actions = 2
        if taken == announces_end_after:
            message = _message(STOP)
            exchange(message)
            time.sleep(0.5)  # Unity takes its time to quit
            note("quit", 0)
            return
        reply = exchange(message)
    note("quit", taken)


def _message(status: int = OK) -> Any:
    message = UnityMessageProto()
    message.header.status = status
    return message
