"""A player in mid-conversation: what it sent, who asks for a decision, and a valid answer for whoever asks."""

import math
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from corridor_server.protocol.messages import OK, RESET
from corridor_server.protocol.trainer_messages import command, step
from corridor_server.shared.patience import MESSAGES_WITHOUT_DECISION
from trainer.conformance.raw_trainer import RawTrainer
from trainer.conformance.verdicts import NotApplicable, NotAsExpected

EXIT_SECONDS = 15.0
PLAY_SECONDS = 60.0
VARIABLE_SIZE = 4  # DimensionProperty, of which a tensor's axis may have several
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class PlayerStopped(NotAsExpected):
    """The player said, with a status other than 200, that it stops."""


@dataclass(frozen=True)
class AgentAction:
    """What one agent does.

    Attributes:
        continuous: Its continuous actions.
        discrete: The number of its choice in each branch.
    """

    continuous: list[float]
    discrete: list[int]


@dataclass
class Session:
    """A player in the middle of a conversation.

    Every step acts for the agents that asked in the last message and for no other, in the order in which they were
    sent, with the sizes of their own behavior, and never chooses what a mask forbids.

    Attributes:
        trainer: The other end.
        process: The player's process, or None if it was not started here.
        specs: Behavior -> its parameters, as the player introduced them.
        output: The player's last output (UnityOutputProto).
        generator: Draws the random actions.
    """

    trainer: RawTrainer
    process: "subprocess.Popen[bytes] | None"
    specs: dict[str, Any] = field(default_factory=dict)
    output: Any = None
    generator: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def reset(self, side_channel: bytes = b"") -> Any:
        """RESET; returns and keeps the output."""
        return self._ask(command(RESET, side_channel))

    def step(self, action: float = 0.0, side_channel: bytes = b"", deprecated: bool = False) -> Any:
        """STEP with the same number for every continuous action of every agent that asked (see ``message``)."""
        return self._ask(self.message(action, side_channel, deprecated))

    def step_randomly(self) -> Any:
        """STEP with actions drawn from [-1, 1] and from the choices that are allowed."""
        return self._ask(self.answer(self.actions(self._draw)))

    def act(self, actions: Mapping[str, Sequence[Sequence[float]]]) -> Any:
        """STEP with the given continuous actions by behavior."""
        return self._ask(step(actions))

    def message(self, action: float = 0.0, side_channel: bytes = b"", deprecated: bool = False) -> Any:
        """The message that ``step`` sends: ``action`` everywhere.

        In a discrete branch, -1 is the first of the choices that are allowed and 1 the last.
        """

        def same(continuous: int, branches: list[list[int]]) -> AgentAction:
            share = 0.0 if math.isnan(action) else (min(max(action, -1.0), 1.0) + 1.0) / 2.0
            return AgentAction([action] * continuous, [each[round(share * (len(each) - 1))] for each in branches])

        return self.answer(self.actions(same), side_channel, deprecated)

    def actions(self, choose: Callable[[int, list[list[int]]], AgentAction]) -> dict[str, list[AgentAction]]:
        """An action for every agent that asked, by behavior, in sent order.

        Args:
            choose: Is given the number of continuous actions and the allowed choices of each branch.
        """
        return {
            name: [
                choose(spec.action_spec.num_continuous_actions, allowed(spec, info))
                for info in deciding(self.output, name)
            ]
            for name, spec in self.specs.items()
        }

    def answer(
        self, actions: Mapping[str, list[AgentAction]], side_channel: bytes = b"", deprecated: bool = False
    ) -> Any:
        """The STEP message of such actions; a behavior of which nobody asked has no list."""
        asked = {name: each for name, each in actions.items() if each}
        continuous = {name: [action.continuous for action in each] for name, each in asked.items()}
        discrete = {name: [action.discrete for action in each] for name, each in asked.items()}
        return step(continuous, side_channel, deprecated, discrete)

    def wrong_count(self, surplus: int) -> Any:
        """A STEP with one action too many (1) or too few (-1) for each behavior of which agents asked."""
        actions = self.actions(_zero)
        return self.answer({name: each + each[-1:] if surplus > 0 else each[:-1] for name, each in actions.items()})

    def wrong_size(self, surplus: int) -> Any:
        """A STEP whose actions have one number too many (1) or too few (-1), of each kind that the agents have."""

        def wrong(continuous: int, branches: list[list[int]]) -> AgentAction:
            numbers = [0.0] * (continuous + surplus if continuous else 0)
            choices = [each[0] for each in branches]
            return AgentAction(numbers, choices + choices[-1:] if surplus > 0 else choices[:-1])

        return self.answer(self.actions(wrong))

    def play(self, messages: int, seconds: float = PLAY_SECONDS) -> Iterator[Any]:
        """Yields the last output, then those of so many random steps.

        There are fewer if the seconds are over, or if the player says that it stops: builds may end by themselves.
        """
        deadline = time.monotonic() + seconds
        yield self.output
        for _ in range(messages):
            if time.monotonic() > deadline:
                return
            try:
                output = self.step_randomly()
            except PlayerStopped:
                return
            yield output

    def to_decisions(self) -> Any:
        """Goes on until agents ask for a decision, if none does: answers with no actions; returns the output.

        A message may hold ended agents only: Unity's agents begin their next episode some fixed steps later.

        Raises:
            NotAsExpected: Nobody asks.
        """
        for _ in range(MESSAGES_WITHOUT_DECISION):
            if deciding(self.output):
                return self.output
            self.step()
        raise NotAsExpected(f"nobody asks for a decision in {MESSAGES_WITHOUT_DECISION} messages; one was expected")

    def with_continuous_actions(self) -> None:
        """Raises NotApplicable unless an agent with continuous actions asks."""
        if not any(
            spec.action_spec.num_continuous_actions and deciding(self.output, name) for name, spec in self.specs.items()
        ):
            raise NotApplicable("no agent with continuous actions asks")

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

    def _draw(self, continuous: int, branches: list[list[int]]) -> AgentAction:
        numbers = self.generator.uniform(-1, 1, continuous).tolist()
        return AgentAction(numbers, [int(self.generator.choice(each)) for each in branches])

    def _ask(self, message: Any) -> Any:
        answer = self.trainer.ask(message)
        if answer.header.status != OK:
            raise PlayerStopped(f"the player stops with status {answer.header.status}; {OK} was expected")
        for parameters in answer.unity_output.rl_initialization_output.brain_parameters:
            self.specs[parameters.brain_name] = parameters
        self.output = answer.unity_output
        return self.output


def _zero(continuous: int, branches: list[list[int]]) -> AgentAction:
    return AgentAction([0.0] * continuous, [each[0] for each in branches])


def allowed(parameters: Any, info: Any) -> list[list[int]]:
    """The choices that an agent's mask leaves in each branch; all of them where no mask of the right size came.

    Args:
        parameters: The behavior's BrainParametersProto.
        info: The agent's AgentInfoProto.
    """
    sizes = list(parameters.action_spec.discrete_branch_sizes)
    forbidden = list(info.action_mask) if len(info.action_mask) == sum(sizes) else [False] * sum(sizes)
    choices = []
    for size in sizes:
        branch, forbidden = forbidden[:size], forbidden[size:]
        choices.append([choice for choice, no in enumerate(branch) if not no] or [0])
    return choices


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


def pictures(compressed: bytes) -> list[bytes]:
    """The PNG files of a compressed observation: one for every three channels, one after another."""
    return [PNG_SIGNATURE + each for each in compressed.split(PNG_SIGNATURE)[1:]]


def until_an_episode_ends(session: Session, messages: int = 3000, seconds: float = PLAY_SECONDS) -> Any:
    """Acts at random until an output after the last one has an ended agent, and returns it.

    Raises:
        NotApplicable: No episode ended.
    """
    outputs = session.play(messages, seconds)
    next(outputs)
    for output in outputs:
        if ended(output):
            return output
    raise NotApplicable("no episode ended under random actions")


def all_finite(values: Iterable[float]) -> bool:
    """Whether there is no NaN or infinity among the values."""
    return all(math.isfinite(value) for value in values)
