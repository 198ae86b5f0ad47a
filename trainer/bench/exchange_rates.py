"""How fast clients step the built-in player over the wire, and what the wire and the world alone would allow."""

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
from mlagents_envs.base_env import ActionTuple
from mlagents_envs.environment import UnityEnvironment

from corridor_server.corridor.areas import BEHAVIOR, Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol import columnar
from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import ActionBatch, Agents, Sensor
from corridor_server.protocol.messages import EXCHANGE
from trainer.bench.bare_server import serve
from trainer.bench.instant_trainer import instant_trainer, zero_step
from trainer.bench.measuring_process import CLIENT_PROGRAM, ECHO_PROGRAM, MeasuringProcess
from trainer.bench.our_player import our_client, player_path
from trainer.bench.workload import Workload

OTHERS = ("mlagents_envs", "official", "limit")  # what stands beside ours, in the table's order


def exchange_rates(areas: int, official: str | None, port: int, workload: Workload) -> dict[str, Any]:
    """Agent steps per second for each client, and round trips per second for an echo of the same payloads.

    Args:
        areas: In the player.
        official: An interpreter that has Unity's own client.
        port: The first of four.
        workload: How often and how long to measure.

    Returns:
        ``areas``, ``ours``, ``echo`` and each of ``OTHERS``: None for a client that is not there. ``limit`` is the
        player against a trainer that answers at once.

    Raises:
        TrainerError: A client or a player can't be started.
    """
    with ExitStack() as stack:
        environment, _ = stack.enter_context(our_client(areas, port))
        measures: dict[str, Callable[[float], float]] = {"ours": lambda seconds: _rate(environment, areas, seconds)}
        client = MeasuringProcess(CLIENT_PROGRAM, player_path(), port + 1, areas)
        measures["mlagents_envs"] = stack.enter_context(client).rate
        if official is not None:
            client = MeasuringProcess(CLIENT_PROGRAM, player_path(), port + 2, areas, python=official)
            measures["official"] = stack.enter_context(client).rate
        measures["echo"] = stack.enter_context(_echo(areas)).rate
        measures["limit"] = stack.enter_context(instant_trainer(1, areas, port + 3)).rate
        rates: dict[str, list[float]] = {name: [] for name in measures}
        for _ in range(workload.rounds):
            for name, measure in measures.items():
                rates[name].append(measure(workload.seconds))
    medians = {name: statistics.median(values) for name, values in rates.items()}
    row: dict[str, Any] = {"areas": areas, "ours": None, **dict.fromkeys(OTHERS), "echo": medians["echo"]}
    return row | {name: rate * areas for name, rate in medians.items() if name != "echo"}


def world_rate(areas: int, workload: Workload) -> float:
    """Agent steps per second of the world in process."""
    corridor = Areas(CorridorConfig(), 1, range(areas))
    corridor.reset()
    actions = {BEHAVIOR: ActionBatch.zeros(areas, corridor.behaviors[BEHAVIOR])}
    rates = []
    for _ in range(workload.rounds):
        begun, count = time.perf_counter(), 0
        while time.perf_counter() - begun < workload.seconds / 2:
            corridor.step(actions)
            count += 1
        rates.append(count * areas / (time.perf_counter() - begun))
    return statistics.median(rates)


def _rate(environment: UnityEnvironment, areas: int, seconds: float) -> float:
    actions = np.zeros((areas, 2), np.float32)
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
        environment.step()
        environment.get_steps(BEHAVIOR)
        count += 1
    return count / (time.perf_counter() - begun)


@contextmanager
def _echo(areas: int) -> Iterator[MeasuringProcess]:
    """A bare gRPC server that answers as many bytes as a STEP has, and a client that sends as many as a batch has."""
    size = CorridorConfig().observation_size
    flags, observations = np.zeros(areas, np.bool_), np.zeros((areas, size), np.float32)
    agents = Agents.ungrouped(np.zeros(areas, np.int32), observations[:, 0], flags, flags, (observations,))
    rows = AgentRows((Sensor.of(f"VectorSensor_size{size}", (size,)),))
    request = len(columnar.write_output([(BEHAVIOR, rows, agents)], b""))
    reply = zero_step(areas)
    server, port = serve(lambda data, context: reply)
    try:
        with MeasuringProcess(ECHO_PROGRAM, port, request, EXCHANGE) as client:
            yield client
    finally:
        server.stop(grace=None)
