"""Plays with the stand-in message by message, and keeps the books that its own ledger is held against."""

import json
import random
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prepared import Prepared

from corridor_server.protocol import side_channels as channels
from corridor_server.protocol.messages import RESET, STEP, UnityMessageProto
from corridor_server.protocol.trainer_messages import command, initialization, quitting
from trainer.conformance.raw_trainer import RawTrainer

BUILD = Path(__file__).with_name("Build.x86_64")
SPECS = sorted(path.stem for path in BUILD.with_name("specs").glob("*.toml") if path.stem != "scene")

Choose = Callable[[Any, Any], tuple[list[float], list[int]]]  # (info, action spec) -> continuous, discrete


def parameter(name: str, layout: str, *values: float) -> bytes:
    """The bytes that set an environment parameter: its kind, and what that kind says."""
    payload = struct.pack("<i", len(name)) + name.encode() + struct.pack(layout, *values)
    return channels.message(channels.ENVIRONMENT_PARAMETERS, payload)


@dataclass
class Books:
    """What came of one agent: numbers of messages by kind, and sums."""

    decisions: int = 0
    reward: float = 0.0
    group_reward: float = 0.0
    ends: list[str] = field(default_factory=list)

    def rounded(self) -> tuple[Any, ...]:
        return self.decisions, round(self.reward, 3), round(self.group_reward, 3), self.ends


def at_random(generator: random.Random) -> Choose:
    def choose(info: Any, spec: Any) -> tuple[list[float], list[int]]:
        continuous = [generator.uniform(-1, 1) for _ in range(spec.num_continuous_actions)]
        return continuous, [generator.randrange(size) for size in spec.discrete_branch_sizes]

    return choose


def always(value: float, choice: int = 0) -> Choose:
    return lambda _, spec: ([value] * spec.num_continuous_actions, [choice] * spec.num_discrete_actions)


@dataclass
class Game:
    """A conversation with a build: its outputs (UnityOutputProto) and the bytes of its messages, as they came."""

    trainer: RawTrainer
    process: Prepared
    log: Path
    specs: dict[str, Any] = field(default_factory=dict)
    books: dict[int, Books] = field(default_factory=dict)
    output: Any = None
    messages: list[bytes] = field(default_factory=list)

    def reset(self, side_channel: bytes = b"") -> Any:
        return self._ask(command(RESET, side_channel))

    def step(self, choose: Choose | None = None, side_channel: bytes = b"") -> Any:
        """Answers everybody who asked; without ``choose``, nobody."""
        message = command(STEP, side_channel)
        for name, listed in self.output.rl_output.agentInfos.items():
            for info in listed.value:
                if choose is not None and not info.done:
                    row = message.unity_input.rl_input.agent_actions[name].value.add()
                    continuous, discrete = choose(info, self.specs[name].action_spec)
                    row.continuous_actions.extend(continuous)
                    row.discrete_actions.extend(discrete)
        return self._ask(message)

    def _ask(self, message: Any) -> Any:
        self.trainer.reply(message)
        self.messages.append(self.trainer.receive_bytes())
        self.output = UnityMessageProto.FromString(self.messages[-1]).unity_output
        for brain in self.output.rl_initialization_output.brain_parameters:
            assert brain.brain_name not in self.specs
            self.specs[brain.brain_name] = brain
        for info in self.infos():
            books = self.books.setdefault(info.id, Books())
            books.reward += info.reward
            books.group_reward += info.group_reward
            if info.done:
                books.ends.append("interrupted" if info.max_step_reached else "terminated")
            else:
                books.decisions += 1
        return self.output

    def infos(self, behavior: str | None = None) -> list[Any]:
        """All agents of the last message, or a behavior's, in sent order."""
        listed = self.output.rl_output.agentInfos
        return [info for name in listed for info in listed[name].value if behavior in (None, name.split("?")[0])]

    def asking(self) -> list[Any]:
        return [info for info in self.infos() if not info.done]

    def ended(self) -> list[Any]:
        return [info for info in self.infos() if info.done]

    def quit(self) -> int:
        """QUIT; returns the exit code."""
        self.trainer.reply(quitting())
        return self.process.wait(20)


@contextmanager
def started(spec: str | Path, folder: Path, *arguments: str) -> Iterator[Game]:
    """A build that was started, before its first message is read."""
    log = folder / f"{Path(spec).stem}.log"
    with RawTrainer() as trainer:
        own = ("-nographics", "-batchmode", "--mlagents-port", str(trainer.port), "-logFile", str(log))
        process = Prepared([BUILD, *own, "--spec", spec, *arguments])
        try:
            yield Game(trainer, process, log)
        finally:
            process.kill()
            process.wait()


@contextmanager
def playing(
    spec: str | Path, folder: Path, *arguments: str, num_areas: int = 1, seed: int = 3, side_channel: bytes = b""
) -> Iterator[Game]:
    """A build after handshake and first RESET."""
    with started(spec, folder, *arguments) as game:
        game.trainer.receive()
        game.trainer.reply(initialization(seed, num_areas))
        game.trainer.receive()
        game.reset(side_channel)
        yield game


def ledger(log: Path) -> tuple[dict[str, Any], dict[int, Books]]:
    """The build's own account: of its whole life, and of each agent by id."""
    life, *agents = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    books = {}
    for agent in agents:
        books[agent["id"]] = own = Books()
        for episode in agent["episodes"]:
            own.decisions += episode["decisions"]
            own.reward += episode["reward"]
            own.group_reward += episode["group_reward"]
            if episode["told"]:
                own.ends.append("interrupted" if episode["end"] == "interrupted" else "terminated")
    return life, {number: own for number, own in books.items() if own.decisions or own.ends}
