"""What every topic of the kit shares: starting a player, playing with it, and looking at what it sends."""

import math
import subprocess
import time
import unittest
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from corridor_server.protocol.trainer_messages import step
from trainer.conformance.raw_trainer import RawTrainer

EXIT_SECONDS = 15.0


class NotApplicable(unittest.SkipTest):
    """The player has no such feature, so the sentence says nothing about it. pytest and unittest show it as skipped."""


class NotAsExpected(AssertionError):
    """The sentence does not hold for the player. pytest and unittest show it as a failure."""


def expect(holds: object, came: str, expected: str) -> None:
    """Fails unless the condition holds; unlike ``assert``, under ``python -O`` too.

    Args:
        holds: The condition.
        came: What the player did.
        expected: What it should have done, as a singular: "... was expected" follows.

    Raises:
        NotAsExpected: It does not hold.
    """
    if not holds:
        raise NotAsExpected(f"{came}; {expected} was expected")


def expect_equal(came: object, expected: object, what: str) -> None:
    """Fails unless two values are equal.

    Args:
        came: The player's.
        expected: The one to compare with.
        what: What they are, to stand before the value.

    Raises:
        NotAsExpected: They differ.
    """
    expect(came == expected, f"{what} {came}", str(expected))


@dataclass
class Session:
    """A player in the middle of a conversation.

    Attributes:
        trainer: The other end.
        process: The player's process, or None if it was not started here.
        specs: Behavior -> its parameters, as the player introduced them.
        output: The player's last output (UnityOutputProto).
    """

    trainer: RawTrainer
    process: "subprocess.Popen[bytes] | None"
    specs: dict[str, Any] = field(default_factory=dict)
    output: Any = None

    def reset(self, side_channel: bytes = b"") -> Any:
        """RESET; returns and keeps the output."""
        return self._take(self.trainer.reset(side_channel))

    def step(self, action: float = 0.0, side_channel: bytes = b"", deprecated: bool = False) -> Any:
        """STEP with the same number for every continuous action of every agent that asked."""
        return self._take(self.trainer.ask(self.message(action, side_channel, deprecated)).unity_output)

    def message(self, action: float = 0.0, side_channel: bytes = b"", deprecated: bool = False) -> Any:
        """The message that ``step`` sends."""
        rows = {name: [[action] * self.action_size(name) for _ in deciding(self.output, name)] for name in self.specs}
        return step(rows, side_channel, deprecated)

    def step_randomly(self, generator: np.random.Generator) -> Any:
        """STEP with actions drawn from [-1, 1]."""
        return self.act(
            {
                name: [generator.uniform(-1, 1, self.action_size(name)).tolist() for _ in deciding(self.output, name)]
                for name in self.specs
            }
        )

    def act(self, actions: dict[str, list[list[float]]]) -> Any:
        """STEP with the given actions."""
        return self._take(self.trainer.ask(step(actions)).unity_output)

    def exit_code(self) -> int:
        """Waits for the player to end.

        Raises:
            NotAsExpected: It does not.
            NotApplicable: It was not started here.
        """
        if self.process is None:
            raise NotApplicable("the player's exit code can't be seen: it was not started here")
        try:
            return self.process.wait(EXIT_SECONDS)
        except subprocess.TimeoutExpired:
            raise NotAsExpected(f"the player still runs after {EXIT_SECONDS:g} s") from None

    def _take(self, output: Any) -> Any:
        for parameters in output.rl_initialization_output.brain_parameters:
            self.specs[parameters.brain_name] = parameters
        self.output = output
        return output

    def action_size(self, behavior: str) -> int:
        """Number of a behavior's continuous actions.

        Raises:
            NotApplicable: It has none.
        """
        size = int(self.specs[behavior].action_spec.num_continuous_actions)
        if not size:
            raise NotApplicable(f"behavior {behavior} has no continuous actions")
        return size


class Conformance:
    """One topic. A subclass says how its player is started; ``arguments`` are passed on to the player."""

    arguments: tuple[str, ...] = ()
    timeout: float = 20.0
    port: int = 0
    host: str = "localhost"

    def start_player(self, port: int, *arguments: str) -> "subprocess.Popen[bytes] | None":
        """Starts the player so that it dials ``localhost:port``.

        Args:
            port: Where the trainer listens.
            *arguments: More arguments for the player.

        Returns:
            Its process; None for a player that somebody else starts.
        """
        raise NotImplementedError

    @contextmanager
    def connected(self, *arguments: str) -> Iterator[Session]:
        """A player that was started, before its first message is read. It is killed at the end, if it has not ended."""
        with RawTrainer(self.timeout, self.port, self.host) as trainer:
            process = self.start_player(trainer.port, *self.arguments, *arguments)
            try:
                yield Session(trainer, process)
            finally:
                trainer.cut()
                if process is not None and process.poll() is None:
                    process.kill()
                if process is not None:
                    process.wait()

    @contextmanager
    def playing(
        self, *arguments: str, seed: int = 0, num_areas: int = 1, side_channel: bytes = b""
    ) -> Iterator[Session]:
        """A player after handshake and first RESET."""
        with self.connected(*arguments) as session:
            session.trainer.handshake(seed, num_areas)
            session.reset(side_channel)
            yield session


def agents(output: Any, behavior: str | None = None) -> list[Any]:
    """All AgentInfoProtos of a behavior (or of all), in sent order."""
    infos = output.rl_output.agentInfos
    names = sorted(infos) if behavior is None else [behavior]
    return [info for name in names if name in infos for info in infos[name].value]


def deciding(output: Any, behavior: str | None = None) -> list[Any]:
    """Agents that ask for a decision, in sent order."""
    return [info for info in agents(output, behavior) if not info.done]


def ended(output: Any, behavior: str | None = None) -> list[Any]:
    """Agents whose episode ended, in sent order."""
    return [info for info in agents(output, behavior) if info.done]


def vector(info: Any) -> list[float]:
    """All of an agent's vector observations, one after another."""
    return [value for each in info.observations if len(each.shape) == 1 for value in each.float_data.data]


def until_an_episode_ends(session: Session, messages: int = 3000, seconds: float = 60.0) -> Any:
    """Acts at random until an output has an ended agent, and returns it.

    Raises:
        NotApplicable: No episode ended.
    """
    generator = np.random.default_rng(0)
    deadline = time.monotonic() + seconds
    for _ in range(messages):
        if ended(session.step_randomly(generator)):
            return session.output
        if time.monotonic() > deadline:
            break
    raise NotApplicable("no episode ended under random actions")


def all_finite(values: list[float]) -> bool:
    """Whether there is no NaN or infinity among the values."""
    return all(math.isfinite(value) for value in values)
