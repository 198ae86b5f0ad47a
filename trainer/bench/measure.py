"""``corridor bench``: how fast the wire and training are on this machine, side by side in one run.

Rates on a shared machine drift, so the things compared are open at the same time and measured in turn; the medians are
reported, and beside them ratios.
"""

import json
import logging
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import grpc
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mlagents_envs.base_env import ActionTuple
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from rich.console import Console
from rich.table import Table

from corridor_server.corridor.areas import BEHAVIOR, Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol import columnar
from corridor_server.protocol.agents import Agents
from corridor_server.protocol.messages import API_VERSION, EXCHANGE, RESET, SERVICE, UnityMessageProto
from trainer.corridor import LEARNER_COLOUR, OPPONENT_COLOUR, WALL_COLOUR
from trainer.errors import TrainerError
from trainer.players.communicator import OK, STOP
from trainer.players.environment import BUILTIN, launch_path, open_environment, place

AREAS = (1, 16, 64, 256, 1024, 4096)
ROUNDS = 5
SECONDS = 0.6
TRAIN_STEPS = {"fast": 400_000, "paper": 20_000}
PLAYERS = ((1, 256), (4, 64))  # as many areas in one player and in several
START_SECONDS = 20
MEMORY_AREAS = 1024
_OTHERS = ("mlagents_envs", "official", "limit")
MEMORY_STEPS = {"1e6": 10**6, "1e7": 10**7}

# A client in a process of its own: for every line it reads, it plays so many seconds and prints exchanges a second.
_CLIENT = """
import sys, time
import numpy as np
try:
    import trainer
except ImportError:
    pass
from mlagents_envs.base_env import ActionTuple
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
player, port, areas = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
channels = [StatsSideChannel()]
env = UnityEnvironment(
    player, base_port=port, seed=1, no_graphics=True, num_areas=areas, side_channels=channels
)
env.reset()
name = list(env.behavior_specs)[0]
actions = np.zeros((areas, 2), np.float32)
print("ready", flush=True)
for line in sys.stdin:
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < float(line):
        env.set_actions(name, ActionTuple(continuous=actions))
        env.step()
        env.get_steps(name)
        count += 1
    print(count / (time.perf_counter() - begun), flush=True)
env.close()
"""
_ECHO = """
import sys, time
import grpc
channel = grpc.insecure_channel(f"localhost:{sys.argv[1]}")
grpc.channel_ready_future(channel).result(20)
call, data = channel.unary_unary(sys.argv[3]), b"x" * int(sys.argv[2])
print("ready", flush=True)
for line in sys.stdin:
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < float(line):
        call(data)
        count += 1
    print(count / (time.perf_counter() - begun), flush=True)
"""


class _Child:
    """A program that measures when told to."""

    def __init__(self, python: str, program: str, *arguments: object) -> None:
        command = [python, "-c", program, *map(str, arguments)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self._line()

    def rate(self) -> float:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{SECONDS}\n")
        self._process.stdin.flush()
        return float(self._line())

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(20)

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise TrainerError(f"{self._process.args!r:.80}... ended before it measured anything; run it by hand.")
        return line


def run_bench(json_file: Path | None, plot: Path | None, official: str | None, port: int, console: Console) -> None:
    """Measures everything, prints tables, and writes the JSON and the plot if asked to.

    Raises:
        TrainerError: A client can't be started.
    """
    logging.getLogger("mlagents_envs").setLevel(logging.ERROR)
    report: dict[str, Any] = {"machine": _machine(), "exchange": [], "world": []}
    with console.status("Measuring") as status:
        for areas in AREAS:
            status.update(f"Exchange with {areas} areas")
            report["exchange"].append(_exchange(areas, official, port))
            report["world"].append({"areas": areas, "steps_per_second": _world(areas)})
        status.update("Training with and without curiosity")
        report["train"] = _training(port)
        status.update("Training with one player and with several")
        report["players"] = _players(port)
        status.update("Start-up and memory")
        report["startup_seconds"] = _startup()
        report["memory_mb"] = _memory(port)
    _print(report, console)
    if json_file is not None:
        json_file.write_text(json.dumps(report, indent=2) + "\n")
    if plot is not None:
        _plot(report, plot)


def _exchange(areas: int, official: str | None, port: int) -> dict[str, Any]:
    """Agent steps a second for each client, and round trips a second for an echo of the same payloads.

    ``limit`` is the player against a trainer that answers at once, without reading: what no Python client can beat.
    """
    player = launch_path(place(BUILTIN, 0)[0] or "")
    with ExitStack() as stack:
        environment, _ = stack.enter_context(_our_client(areas, port))
        measures: dict[str, Any] = {"ours": lambda: _rate(environment, areas, SECONDS)}
        children = {"mlagents_envs": (sys.executable, port + 1)}
        if official is not None:
            children["official"] = (official, port + 2)
        for name, (python, child_port) in children.items():
            child = _Child(python, _CLIENT, player, child_port, areas)
            stack.callback(child.close)
            measures[name] = child.rate
        measures["echo"] = stack.enter_context(_echo(areas))
        measures["limit"] = stack.enter_context(_limit(1, areas, port + 3))
        rates: dict[str, list[float]] = {name: [] for name in measures}
        for _ in range(ROUNDS):
            for name, measure in measures.items():
                rates[name].append(measure())
    medians = {name: statistics.median(values) for name, values in rates.items()}
    row: dict[str, Any] = {"areas": areas, "ours": None, **dict.fromkeys(_OTHERS), "echo": medians["echo"]}
    return row | {name: rate * areas for name, rate in medians.items() if name != "echo"}


@contextmanager
def _our_client(areas: int, port: int) -> Iterator[tuple[UnityEnvironment, StatsSideChannel]]:
    """This trainer's environment on the built-in player, after its first reset."""
    channel = StatsSideChannel()
    with tempfile.TemporaryDirectory() as logs:
        environment = open_environment(
            BUILTIN,
            seed=1,
            num_areas=areas,
            port=port,
            timeout_wait=30,
            log_folder=Path(logs),
            side_channels=[channel],
        )
        environment.reset()
        try:
            yield environment, channel
        finally:
            environment.close()


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
def _echo(areas: int) -> Iterator[Any]:
    """A bare gRPC server that answers as many bytes as a STEP has, and a client that sends as many as a batch has."""
    size = CorridorConfig().observation_size
    flags, observations = np.zeros(areas, np.bool_), np.zeros((areas, size), np.float32)
    agents = Agents(np.zeros(areas, np.int32), observations[:, 0], flags, flags, observations)
    request = len(columnar.write_output(BEHAVIOR, f"VectorSensor_size{size}", agents, b""))
    reply = columnar.write_step(BEHAVIOR, np.zeros((areas, 2), np.float32), b"")
    server, port = _serve(lambda data, context: reply, 0)
    child = _Child(sys.executable, _ECHO, port, request, EXCHANGE)
    try:
        yield child.rate
    finally:
        child.close()
        server.stop(grace=None)


def _serve(answer: Any, port: int) -> tuple[grpc.Server, int]:
    """A bare gRPC server on the port, or on any free one for 0, and its port."""
    server = grpc.server(ThreadPoolExecutor(max_workers=2))
    handler = grpc.unary_unary_rpc_method_handler(answer)
    server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler(SERVICE, {"Exchange": handler})])
    port = server.add_insecure_port(f"localhost:{port}")
    server.start()
    return server, port


class _InstantTrainer:
    """Leads players through the handshake, then answers all of them with the same STEP as soon as each has asked."""

    def __init__(self, players: int, areas: int) -> None:
        hello, reset, stop = UnityMessageProto(), UnityMessageProto(), UnityMessageProto()
        hello.header.status = reset.header.status = OK
        start = hello.unity_input.rl_initialization_input
        start.seed, start.num_areas, start.communication_version = 1, areas, API_VERSION
        reset.unity_input.rl_input.command = RESET
        stop.header.status = STOP
        opening: list[bytes] = [hello.SerializeToString(), reset.SerializeToString()]
        self._openings = [list(opening) for _ in range(players)]
        self._step = columnar.write_step(BEHAVIOR, np.zeros((areas, 2), np.float32), b"")
        self._stop: bytes = stop.SerializeToString()
        self._all_asked = threading.Barrier(players)
        self.ready, self._measuring, self._ended = threading.Event(), threading.Event(), False
        self._exchanges = 0

    def answer(self, player: int, request: bytes, context: grpc.ServicerContext) -> bytes:
        if self._openings[player]:
            return self._openings[player].pop(0)
        with suppress(threading.BrokenBarrierError):  # closed
            self._all_asked.wait()
        self.ready.set()
        self._measuring.wait()
        self._exchanges += player == 0
        return self._stop if self._ended else self._step

    def rate(self) -> float:
        before, begun = self._exchanges, time.perf_counter()
        self._measuring.set()
        time.sleep(SECONDS)
        self._measuring.clear()
        return (self._exchanges - before) / (time.perf_counter() - begun)

    def close(self) -> None:
        self._ended = True
        self._all_asked.abort()
        self._measuring.set()


@contextmanager
def _limit(players: int, areas: int, port: int) -> Iterator[Any]:
    """Players, as processes, that wait for an answer only as long as gRPC takes to bring it."""
    trainer = _InstantTrainer(players, areas)
    with ExitStack() as stack:
        for number in range(players):
            server, listening = _serve(partial(trainer.answer, number), port + number)
            stack.callback(server.stop, grace=None)
            command = [launch_path(place(BUILTIN, 0)[0] or ""), "--mlagents-port", str(listening)]
            stack.callback(subprocess.Popen(command, stderr=subprocess.DEVNULL).wait, 20)
        stack.callback(trainer.close)
        if not trainer.ready.wait(START_SECONDS):
            raise TrainerError(f"{command[0]} sent no batch within {START_SECONDS} s; run it by hand.")
        yield trainer.rate


def _world(areas: int) -> float:
    """Agent steps a second of the world in process."""
    corridor = Areas(CorridorConfig(), 1, range(areas))
    corridor.reset()
    actions = np.zeros((areas, 2), np.float32)
    rates = []
    for _ in range(ROUNDS):
        begun, count = time.perf_counter(), 0
        while time.perf_counter() - begun < SECONDS / 2:
            corridor.step(actions)
            count += 1
        rates.append(count * areas / (time.perf_counter() - begun))
    return statistics.median(rates)


def _training(port: int) -> list[dict[str, Any]]:
    kinds = (("fast", 0.3), ("fast", 0.0), ("paper", 0.3))
    summaries = _train_in_turn({(preset, c): ["--preset", preset, "--c", str(c)] for preset, c in kinds}, port)
    measures = ("steps_per_second", "exchange_share")
    return [
        {"c": c, "preset": preset, **{name: statistics.median(each[name] for each in found) for name in measures}}
        for (preset, c), found in summaries.items()
    ]


def _players(port: int) -> list[dict[str, Any]]:
    """Training with as many areas in one player and in several, and what an instant trainer has with them."""
    kinds = {kind: ["--num-envs", str(kind[0]), "--num-areas", str(kind[1])] for kind in PLAYERS}
    summaries = _train_in_turn(kinds, port)
    limits: dict[tuple[int, int], list[float]] = {kind: [] for kind in PLAYERS}
    with ExitStack() as stack:
        rates = {}
        for players, areas in PLAYERS:
            rates[players, areas] = stack.enter_context(_limit(players, areas, port))
            port += players
        for _ in range(ROUNDS):
            for (players, areas), rate in rates.items():
                limits[players, areas].append(rate() * players * areas)
    return [
        {
            "num_envs": players,
            "num_areas": areas,
            "steps_per_second": statistics.median(each["steps_per_second"] for each in summaries[players, areas]),
            "limit": statistics.median(limits[players, areas]),
        }
        for players, areas in PLAYERS
    ]


def _train_in_turn(kinds: Mapping[Any, list[str]], port: int) -> dict[Any, list[dict[str, Any]]]:
    """Summaries of two runs with each kind's options."""
    summaries: dict[Any, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    with tempfile.TemporaryDirectory() as folder:
        for kind, options in [*kinds.items()] * 2:
            steps = TRAIN_STEPS["paper" if "paper" in options else "fast"]
            command = [sys.executable, "-m", "trainer.main", "train", "--run-id", "bench", "--results-dir", folder]
            command += ["--force", "--steps", str(steps), "--base-port", str(port), "--eval-episodes", "1", *options]
            run = subprocess.run(command, capture_output=True, text=True)
            if run.returncode:
                raise TrainerError(f"A training run failed: {run.stderr.strip().splitlines()[-1]}")
            summaries[kind].append(json.loads((Path(folder) / "bench" / "summary.json").read_text()))
    return summaries


def _startup() -> dict[str, float]:
    """Seconds until the player gives up a port where nobody listens, and until the trainer shows its help."""
    player = launch_path(place(BUILTIN, 0)[0] or "")
    commands = {
        "corridor-server": [player, "--mlagents-port", "1", "--timeout-wait", "0"],
        "corridor": [sys.executable, "-m", "trainer.main", "--help"],
    }
    seconds = {}
    for name, command in commands.items():
        found = []
        for _ in range(3):
            begun = time.perf_counter()
            subprocess.run(command, capture_output=True)
            found.append(time.perf_counter() - begun)
        seconds[name] = statistics.median(found)
    return seconds


def _memory(port: int) -> dict[str, dict[str, float]]:
    """Resident memory of the player and of this process, in MB, after so many agent steps."""
    found = {}
    actions, steps = np.zeros((MEMORY_AREAS, 2), np.float32), 0
    with _our_client(MEMORY_AREAS, port) as (environment, channel):
        for name, goal in MEMORY_STEPS.items():
            while steps < goal:
                environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
                environment.step()
                channel.get_and_reset_stats()
                steps += MEMORY_AREAS
            found[name] = {"player": _resident(environment._process.pid), "trainer": _resident(os.getpid())}
    return found


def _resident(process: int) -> float:
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)


def _machine() -> dict[str, Any]:
    packages = ("curious-corridor", "mlagents-envs", "grpcio", "protobuf", "numpy", "torch", "stable-baselines3")
    return {
        "cpus": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in packages},
    }


def _print(report: dict[str, Any], console: Console) -> None:
    table = Table("areas", "ours", "0.28.0", "official", "limit", "echo", box=None)
    for row in report["exchange"]:
        clients = [f"{row[name]:,.0f} ({row['ours'] / row[name]:.1f})" if row[name] else "-" for name in _OTHERS]
        part = row["ours"] / row["areas"] / row["echo"]
        table.add_row(f"{row['areas']:,}", f"{row['ours']:,.0f}", *clients, f"{row['echo']:,.0f} ({part:.0%})")
    console.print(
        "Exchange, agent steps a second (in brackets: how many times as fast ours is). limit: the player against a "
        "trainer that answers at once, unread. echo: bare round trips a second with as many bytes (ours: exchanges)."
    )
    console.print(table)
    for row in report["world"]:
        console.print(f"world in process, {row['areas']:>5,} areas: {row['steps_per_second']:>12,.0f} steps/s")
    for row in report["train"]:
        console.print(
            f"training, preset {row['preset']}, c = {row['c']:g}: {row['steps_per_second']:,.0f} steps/s, "
            f"{row['exchange_share']:.0%} of the time in the exchange"
        )
    for row in report["players"]:
        console.print(
            f"training, {row['num_envs']} x {row['num_areas']} areas: {row['steps_per_second']:,.0f} steps/s; "
            f"limit {row['limit']:,.0f}"
        )
    for name, seconds in report["startup_seconds"].items():
        console.print(f"{name} starts in {seconds:.2f} s")
    for name, memory in report["memory_mb"].items():
        console.print(f"after {name} agent steps: player {memory['player']} MB, trainer {memory['trainer']} MB")


def _plot(report: dict[str, Any], path: Path) -> None:
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    lines = [("ours", "this trainer"), ("mlagents_envs", "mlagents-envs 0.28.0"), ("official", "mlagents-envs 1.1.0")]
    for (name, label), colour in zip(lines, (LEARNER_COLOUR, OPPONENT_COLOUR, WALL_COLOUR), strict=True):
        points = [(row["areas"], row[name]) for row in report["exchange"] if row[name]]
        if points:
            axes.plot(*zip(*points, strict=True), marker="o", label=label, color=colour)
    world = [(row["areas"], row["steps_per_second"]) for row in report["world"]]
    axes.plot(*zip(*world, strict=True), linestyle=":", color="#3a8f5c", label="the world in process")
    axes.set(xscale="log", yscale="log", xlabel="areas in one player", ylabel="agent steps a second")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110)
