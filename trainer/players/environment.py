"""``UnityEnvironment``, faster and listening on one host: the only place that touches its private parts."""

import atexit
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from mlagents_envs.base_env import BehaviorSpec, DecisionSteps, TerminalSteps
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.exception import UnityCommunicatorStoppedException, UnityException, UnityObservationException

from corridor_server.protocol.agents import Agents
from corridor_server.protocol.columnar import read_output, write_step
from trainer.players.channels_first import channels_last
from trainer.players.communicator import ExchangeCommunicator, parse, serialise
from trainer.players.failures import BadNumbers
from trainer.players.location import LOOPBACK


@dataclass(frozen=True)
class _Plain:
    """The one behavior of an environment with one vector observation and continuous actions."""

    behavior: str
    observation: str
    observation_size: int


class Environment(UnityEnvironment):  # type: ignore[misc]  # mlagents_envs has no type information
    """``UnityEnvironment`` over our communicator, listening on one host.

    The same to its users. Where the environment has one behavior with one vector observation and continuous actions,
    steps go by columns instead of a message object per agent, as long as the player's messages have the form for it.

    Args:
        file_name: The player's executable; None waits for a player that somebody else starts.
        port: Where the player finds the trainer.
        host: Where to listen.
        number: Of several players; names the log of one that is launched.
        graphics: Whether a launched player shall open a window and render.
        **options: ``UnityEnvironment``'s.

    Attributes:
        exchange_seconds: Time spent in ``send`` and ``receive``, which is most of ``step``: from actions to
            observations, encoding, waiting and decoding.
    """

    _env_specs: dict[str, BehaviorSpec]

    def __init__(
        self,
        file_name: str | None,
        port: int,
        host: str = LOOPBACK,
        number: int = 0,
        graphics: bool = False,
        **options: Any,
    ) -> None:
        self._host = host
        self.exchange_seconds = 0.0
        self._plain: _Plain | None = None
        worker_id = 0 if file_name is None else number  # mlagents_envs waits for players as worker 0 only
        try:
            super().__init__(
                file_name, worker_id=worker_id, base_port=port - worker_id, no_graphics=not graphics, **options
            )
        except (UnityException, OSError):
            if hasattr(self, "_communicator"):
                self.kill()
            atexit.unregister(self._close)
            raise

    @property
    def is_open(self) -> bool:
        """Whether it was neither closed nor killed."""
        return bool(self._loaded)

    @property
    def process_id(self) -> int | None:
        """Of the player that was launched; None if it was not launched here."""
        return None if self._process is None else int(self._process.pid)

    def kill(self) -> None:
        """Closes the environment without waiting for a player that hangs; one that announced its end may finish."""
        self._close(None if self._communicator.end_announced else 0)

    def _close(self, timeout: int | None = None) -> None:
        process = self._process
        super()._close(timeout)
        atexit.unregister(self._close)
        if process is not None:
            process.wait()  # of one that had to be killed, too: no zombie stays

    def reset(self) -> None:
        """Begins an episode everywhere."""
        super().reset()
        self._plain = _plain(self.behavior_specs)

    def _update_state(self, output: Any) -> None:
        sent = self._env_specs
        self._env_specs, turned = channels_last(output.agentInfos, sent)
        try:
            super()._update_state(output)
        except RuntimeError as error:  # what mlagents_envs raises for NaN or Inf, and for nothing else
            raise _bad_number(output) from error
        except (OSError, SyntaxError) as error:  # Pillow's
            raise UnityObservationException(f"The player sent a picture that can't be read ({error}).") from error
        finally:
            self._env_specs = sent
        for behavior, index in turned:
            for steps in self._env_state[behavior]:
                steps.obs[index] = steps.obs[index].transpose(0, 3, 1, 2)

    def step(self) -> None:
        """Sends the actions that were set and takes the player's next message."""
        if self._is_first_message or not self._loaded:
            super().step()  # begins with a reset; refuses a closed environment
            return
        self.send()
        self.receive()

    def send(self) -> None:
        """The first half of ``step``: the player computes from here on, while the caller does something else."""
        began = time.perf_counter()
        for name, spec in self._env_specs.items():
            if name not in self._env_actions:
                self._env_actions[name] = spec.action_spec.empty_action(len(self._env_state[name][0]))
        plain = self._plain
        if plain is not None and len(self._env_state[plain.behavior][0]):
            side_channel = bytes(self._side_channel_manager.generate_side_channel_messages())
            message = write_step(plain.behavior, self._env_actions[plain.behavior].continuous, side_channel)
        else:
            message = serialise(self._generate_step_input(self._env_actions))
        self._communicator.send(message)
        self.exchange_seconds += time.perf_counter() - began

    def receive(self) -> None:
        """The second half of ``step``: waits for the player's message, which ``get_steps`` then shows."""
        began = time.perf_counter()
        data = self._communicator.receive(self._poll_process)
        if data is None:
            raise UnityCommunicatorStoppedException("Communicator has exited.")
        plain = self._plain
        read = None
        if plain is not None:
            read = read_output(data, plain.behavior, plain.observation, plain.observation_size)
        if plain is None or read is None:
            output = parse(data).unity_output
            self._update_behavior_specs(output)
            self._update_state(output.rl_output)
            self._plain = _plain(self.behavior_specs)
        else:
            self._env_state[plain.behavior] = _steps(read[0])
            self._side_channel_manager.process_side_channel_message(read[1])
        self._env_actions.clear()
        self.exchange_seconds += time.perf_counter() - began

    def _get_communicator(self, worker_id: int, base_port: int, timeout_wait: int) -> ExchangeCommunicator:
        return ExchangeCommunicator(worker_id, base_port, timeout_wait, self._host)


def _bad_number(output: Any) -> BadNumbers:
    """Finds what ``mlagents_envs`` refused in an UnityRLOutputProto."""
    for infos in output.agentInfos.values():
        for info in infos.value:
            for index, observation in enumerate(info.observations):
                for component, value in enumerate(observation.float_data.data):
                    if not math.isfinite(value):
                        of_several = f"s[{index}]" if len(info.observations) > 1 else ""
                        return BadNumbers(f"observation{of_several}[{component}]", value, info.id)
            for field, value in (("reward", info.reward), ("group reward", info.group_reward)):
                if not math.isfinite(value):
                    return BadNumbers(field, value, info.id)
    return BadNumbers("a number", math.nan)


def _plain(specs: Mapping[str, BehaviorSpec]) -> _Plain | None:
    if len(specs) != 1:
        return None
    name = next(iter(specs))
    observations, action = specs[name].observation_specs, specs[name].action_spec
    if len(observations) != 1 or len(observations[0].shape) != 1 or not action.is_continuous():
        return None
    return _Plain(name, observations[0].name, int(observations[0].shape[0]))


def _steps(agents: Agents) -> tuple[DecisionSteps, TerminalSteps]:
    for values, field in ((agents.observations[0], "observation"), (agents.rewards, "reward")):
        finite = np.isfinite(values)
        if not finite.all():
            row, *component = np.argwhere(~finite)[0].tolist()
            raise BadNumbers(f"{field}{component or ''}", float(values[row, *component]), int(agents.ids[row]))
    return _decision(agents.deciding), _terminal(agents.ended)


def _decision(agents: Agents) -> DecisionSteps:
    none = np.zeros(len(agents), dtype=np.float32)
    return DecisionSteps(list(agents.observations), agents.rewards, agents.ids, None, [0] * len(agents), none)


def _terminal(agents: Agents) -> TerminalSteps:
    none = np.zeros(len(agents), dtype=np.float32)
    observations, groups = list(agents.observations), [0] * len(agents)
    return TerminalSteps(observations, agents.rewards, agents.interrupted, agents.ids, groups, none)


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
