"""``UnityEnvironment``, faster and listening on one host: the only place that touches its private parts."""

import atexit
import struct
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from mlagents_envs.base_env import BehaviorSpec, DecisionSteps, TerminalSteps
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.exception import (
    UnityCommunicationException,
    UnityCommunicatorStoppedException,
    UnityException,
    UnityObservationException,
    UnitySideChannelException,
)
from mlagents_envs.logging_util import get_logger
from mlagents_envs.side_channel import IncomingMessage
from mlagents_envs.side_channel.side_channel_manager import SideChannelManager

from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import ActionBatch
from corridor_server.protocol.columnar import read_output, write_step
from corridor_server.protocol.side_channels import SideChannelError, split
from corridor_server.protocol.trainer_messages import stopping
from corridor_server.shared.addresses import LOOPBACK
from corridor_server.shared.patience import MESSAGES_WITHOUT_DECISION
from trainer.errors import TrainerError
from trainer.players import steps as mlagents_steps
from trainer.players.announcements import check_behaviors
from trainer.players.channels_first import channels_last, compressed_in
from trainer.players.communicator import ExchangeCommunicator, parse
from trainer.players.failures import FAILURES, last_lines

FAREWELL_SECONDS = 1  # for a player to end by itself, once it was told to

logger = get_logger(__name__)


class Environment(UnityEnvironment):  # type: ignore[misc]  # mlagents_envs has no type information
    """``UnityEnvironment`` over our communicator, listening on one host.

    The same to its users. Actions go by columns instead of a message object per agent, and so do observations where all
    are vectors or buffers of them, as long as the player's messages have the form that Unity and protobuf give them.

    Args:
        file_name: The player's executable; None waits for a player that somebody else starts.
        port: Where the player finds the trainer.
        host: Where to listen.
        number: Of several players; names the log of one that is launched.
        graphics: Whether a launched player shall open a window and render.
        log: Where a launched player logs, whose end is a note of what it fails with; None for one without.
        **options: ``UnityEnvironment``'s.

    Attributes:
        exchange_seconds: Time spent in ``send`` and ``receive``, which is most of ``step``: from actions to
            observations, encoding, waiting and decoding.
        compressed: Which observations came as compressed pictures, (behavior, index) each.

    Raises:
        TrainerError: The seed is none that the protocol carries; nothing was started.
    """

    _env_specs: dict[str, BehaviorSpec]

    def __init__(
        self,
        file_name: str | None,
        port: int,
        host: str = LOOPBACK,
        number: int = 0,
        graphics: bool = False,
        log: Path | None = None,
        **options: Any,
    ) -> None:
        seed = options.get("seed", 0)
        if not (isinstance(seed, int | np.integer) and -(2**31) <= seed < 2**31):
            raise TrainerError(f"The seed is {seed!r}, but a whole number from {-(2**31)} to {2**31 - 1} was expected.")
        self._host = host
        self.exchange_seconds = 0.0
        self._log = log
        self._in_step = False  # from a step's first half to the end of its second
        self.compressed: set[tuple[str, int]] = set()
        self._undecided = 0
        self._rows: dict[str, AgentRows] | None = None
        worker_id = 0 if file_name is None else number  # mlagents_envs waits for players as worker 0 only
        try:
            super().__init__(
                file_name, worker_id=worker_id, base_port=port - worker_id, no_graphics=not graphics, **options
            )
        except BaseException:  # an interrupt, too: who has not shaken hands can't be told to stop
            if hasattr(self, "_communicator"):
                self.kill()
            atexit.unregister(self._close)
            raise
        self._side_channel_manager: SideChannelManager = _Channels(self._side_channel_manager)

    @property
    def is_open(self) -> bool:
        """Whether it was neither closed nor killed."""
        return bool(self._loaded)

    @property
    def process_id(self) -> int | None:
        """Of the player that was launched; None if it was not launched here."""
        return None if self._process is None else int(self._process.pid)

    def kill(self) -> None:
        """Closes the environment, and hardly waits for a player that hangs; one that announced its end may finish."""
        self._close(None if self._communicator.end_announced else FAREWELL_SECONDS)

    def _close(self, timeout: int | None = None) -> None:
        process = self._process
        super()._close(timeout)
        atexit.unregister(self._close)
        if process is not None:
            process.wait()  # of one that had to be killed, too: no zombie stays

    def reset(self) -> None:
        """Begins an episode everywhere; what is left of a step that was interrupted is dropped."""
        try:
            super().reset()
        except FAILURES as error:
            self._quote_log(error)
            raise
        self._in_step = False
        self._rows = mlagents_steps.rows_of(self.behavior_specs)

    def _update_behavior_specs(self, output: Any) -> None:
        check_behaviors(output, self._env_specs)
        super()._update_behavior_specs(output)
        self.compressed |= compressed_in(output.rl_output.agentInfos)

    def _update_state(self, output: Any) -> None:
        mlagents_steps.check_counts(output, self._env_specs)
        sent = self._env_specs
        self._env_specs, turned = channels_last(output.agentInfos, sent)
        try:
            super()._update_state(output)
        except RuntimeError as error:  # what mlagents_envs raises for NaN or Inf, and for nothing else
            raise mlagents_steps.bad_number(output) from error
        except (OSError, SyntaxError) as error:  # Pillow's
            raise UnityObservationException(f"The player sent a picture that can't be read ({error}).") from error
        finally:
            self._env_specs = sent
        for behavior, index in turned:
            for steps in self._env_state[behavior]:
                steps.obs[index] = steps.obs[index].transpose(0, 3, 1, 2)
        for found in self._env_state.values():
            mlagents_steps.check_ids(found)
        self._count_undecided()

    def _count_undecided(self) -> None:
        """Ends what would go on for ever: a player that sends message after message in which nobody is to decide."""
        if any(len(decision) for decision, _ in self._env_state.values()):
            self._undecided = 0
            return
        self._undecided += 1
        if self._undecided == MESSAGES_WITHOUT_DECISION:
            raise UnityObservationException(
                f"No agent asked for a decision in {MESSAGES_WITHOUT_DECISION} messages of the player; look for agents "
                "without a DecisionRequester, or that end before they decide."
            )

    def step(self) -> None:
        """Sends the actions that were set and takes the player's next message."""
        if self._is_first_message or not self._loaded:
            super().step()  # begins with a reset; refuses a closed environment
            return
        self.send()
        self.receive()

    def send(self) -> None:
        """The first half of ``step``: the player computes from here on, while the caller does something else.

        Raises:
            UnityCommunicationException: The step before did not come to its end.
        """
        if self._in_step:
            raise UnityCommunicationException(
                "The step before this one failed, timed out or was interrupted; call reset() before the next."
            )
        self._in_step = True
        began = time.perf_counter()
        for name, spec in self._env_specs.items():
            if name not in self._env_actions:
                self._env_actions[name] = spec.action_spec.empty_action(len(self._env_state[name][0]))
        asked = {
            name: ActionBatch(actions.continuous, actions.discrete)
            for name, actions in self._env_actions.items()
            if len(self._env_state[name][0])
        }
        side_channel = bytes(self._side_channel_manager.generate_side_channel_messages())
        self._communicator.send(write_step(asked, side_channel))
        self.exchange_seconds += time.perf_counter() - began

    def receive(self) -> None:
        """The second half of ``step``: waits for the player's message, which ``get_steps`` then shows."""
        began = time.perf_counter()
        try:
            data = self._communicator.receive(self._poll_process)
            if data is None:
                raise UnityCommunicatorStoppedException("Communicator has exited.")
        except FAILURES as error:
            self._quote_log(error)
            raise
        read = None if self._rows is None else read_output(data, self._rows)
        if read is None:
            output = parse(data).unity_output
            self._update_behavior_specs(output)
            self._update_state(output.rl_output)
            if output.rl_initialization_output.brain_parameters:
                self._rows = mlagents_steps.rows_of(self.behavior_specs)
        else:
            for name, spec in self._env_specs.items():
                if name in read[0]:
                    self._env_state[name] = mlagents_steps.steps(read[0][name], spec)
                else:
                    self._env_state[name] = DecisionSteps.empty(spec), TerminalSteps.empty(spec)
            self._count_undecided()
            self._side_channel_manager.process_side_channel_message(read[1])
        self._env_actions.clear()
        self._in_step = False
        self.exchange_seconds += time.perf_counter() - began

    def _quote_log(self, error: UnityException) -> None:
        """Puts beside what the player failed with what it said itself; ``corridor train`` has that in its sentence."""
        if self._log is None or self._process is None:
            return
        if self._communicator.end_announced:  # its log says why once it has its answer
            self._communicator.send(stopping().SerializeToString())
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(FAREWELL_SECONDS)
        error.add_note(last_lines(self._log).strip() or f"The player's log, {self._log}, is empty.")

    def _get_communicator(self, worker_id: int, base_port: int, timeout_wait: int) -> ExchangeCommunicator:
        return ExchangeCommunicator(worker_id, base_port, timeout_wait, self._host)


class _Channels(SideChannelManager):  # type: ignore[misc]
    """``SideChannelManager`` that names the channel of what can't be read."""

    def __init__(self, manager: SideChannelManager) -> None:
        self._side_channels_dict = manager._side_channels_dict  # noqa: SLF001 - its own class

    def process_side_channel_message(self, data: bytes) -> None:
        """Hands each message to its channel.

        Raises:
            UnitySideChannelException: The bytes are cut, or a channel can't read its message.
        """
        try:
            for identifier, payload in split(data):
                channel = self._side_channels_dict.get(identifier)
                if channel is None:
                    logger.warning(f"Unknown side channel data received. Channel type: {identifier}.")
                    continue
                try:
                    channel.on_message_received(IncomingMessage(payload))
                except (ValueError, struct.error) as error:
                    raise UnitySideChannelException(
                        f"The player sent side channel {identifier} a message that can't be read ({error})"
                    ) from error
        except SideChannelError as error:
            raise UnitySideChannelException(f"The player's side-channel bytes can't be read: {error}") from error


class TwoHalves(Protocol):
    """A step in two halves, so that a player computes while others get their actions."""

    def send(self) -> None:
        """Sends the actions that were set, and does not wait."""

    def receive(self) -> None:
        """Waits for the player's message, which ``get_steps`` then shows."""


class _WholeStep:
    """The step of an environment that has no halves: all of it is the second."""

    def __init__(self, environment: UnityEnvironment) -> None:
        self._environment = environment

    def send(self) -> None:
        pass

    def receive(self) -> None:
        self._environment.step()


def in_two_halves(environment: UnityEnvironment) -> TwoHalves:
    """An environment's step in two halves, whichever ``UnityEnvironment`` it is."""
    return environment if isinstance(environment, Environment) else _WholeStep(environment)
