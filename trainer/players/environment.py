"""Opens any ML-Agents environment: our own player, a Unity build, the Unity editor, or a player elsewhere."""

import atexit
import ipaddress
import math
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mlagents_envs import env_utils
from mlagents_envs.base_env import BehaviorSpec, DecisionSteps, TerminalSteps
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.exception import (
    UnityCommunicatorStoppedException,
    UnityException,
    UnityTimeOutException,
    UnityWorkerInUseException,
)
from mlagents_envs.side_channel.side_channel import SideChannel
from rich.console import Console

from corridor_server.protocol.agents import Agents
from corridor_server.protocol.columnar import read_output, write_step
from trainer.corridor import check_contract, is_corridor
from trainer.errors import TrainerError
from trainer.players.communicator import ExchangeCommunicator, parse, serialise

BUILTIN, EDITOR = "builtin", "editor"
LOOPBACK = "localhost"
FOREIGN = {".exe": "Windows", ".app": "macOS", ".x86_64": "Linux", ".x86": "Linux"}


class BadNumbers(RuntimeError):
    """An observation or reward is NaN or infinite; a RuntimeError as in ``mlagents_envs``.

    Args:
        field: Which number, such as ``observation[3]``.
        value: It.
        agent: Whose; None if that is not known.
        area: In which area the agent is; None if that is not known.
    """

    def __init__(self, field: str, value: float, agent: int | None = None, area: int | None = None) -> None:
        self.field, self.value, self.agent, self.area = field, value, agent, area
        whose = "" if agent is None else f" of agent {agent}"
        where = "" if area is None else f" in area {area}"
        super().__init__(
            f"The player sent {field} = {value}{whose}{where}, but finite numbers were expected; look for a division "
            "by zero in the player."
        )

    def in_area(self, area: int) -> "BadNumbers":
        """The same, with the area named."""
        return BadNumbers(self.field, self.value, self.agent, area)


@dataclass(frozen=True)
class _Plain:
    """The one behavior of an environment with one vector observation and continuous actions."""

    behavior: str
    observation: str
    observation_size: int


class Environment(UnityEnvironment):  # type: ignore[misc]  # mlagents_envs has no type information
    """``UnityEnvironment`` over our communicator, listening on one host.

    The same to its users. Where the environment has one behavior with one vector observation and continuous actions,
    steps go by columns instead of a message object an agent, as long as the player's messages have the form for it.

    Args:
        file_name: The player's executable; None waits for a player that somebody else starts.
        port: Where the player finds the trainer.
        host: Where to listen.
        number: Of several players; names the log of one that is launched.
        **options: ``UnityEnvironment``'s.

    Attributes:
        exchange_seconds: Time spent in ``send`` and ``receive``, which is most of ``step``: from actions to
            observations, encoding, waiting and decoding.
    """

    def __init__(self, file_name: str | None, port: int, host: str = LOOPBACK, number: int = 0, **options: Any) -> None:
        self._host = host
        self.exchange_seconds = 0.0
        self._plain: _Plain | None = None
        worker_id = 0 if file_name is None else number  # mlagents_envs waits for players as worker 0 only
        try:
            super().__init__(file_name, worker_id=worker_id, base_port=port - worker_id, no_graphics=True, **options)
        except (UnityException, OSError):
            if hasattr(self, "_communicator"):
                self._close(0)
            atexit.unregister(self._close)
            raise

    def kill(self) -> None:
        """Closes the environment without waiting for a player that hangs."""
        self._close(0)

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
        try:
            super()._update_state(output)
        except RuntimeError as error:  # what mlagents_envs raises for NaN or Inf, and for nothing else
            raise _bad_number(output) from error

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
    for values, field in ((agents.observations, "observation"), (agents.rewards, "reward")):
        finite = np.isfinite(values)
        if not finite.all():
            row, *component = np.argwhere(~finite)[0].tolist()
            raise BadNumbers(f"{field}{component or ''}", float(values[row, *component]), int(agents.ids[row]))
    return _decision(agents.deciding), _terminal(agents.ended)


def _decision(agents: Agents) -> DecisionSteps:
    none = np.zeros(len(agents), dtype=np.float32)
    return DecisionSteps([agents.observations], agents.rewards, agents.ids, None, [0] * len(agents), none)


def _terminal(agents: Agents) -> TerminalSteps:
    none = np.zeros(len(agents), dtype=np.float32)
    observations, groups = [agents.observations], [0] * len(agents)
    return TerminalSteps(observations, agents.rewards, agents.interrupted, agents.ids, groups, none)


def open_environment(
    env: str,
    *,
    seed: int,
    num_areas: int,
    port: int,
    timeout_wait: int,
    log_folder: Path | None = None,
    side_channels: list[SideChannel] | None = None,
    number: int = 0,
    env_args: Sequence[str] = (),
    listen: str = LOOPBACK,
) -> Environment:
    """Starts or awaits a player and shakes hands.

    Args:
        env: ``builtin``; ``editor``; a build's path; or ``HOST:PORT``, where to listen for a player.
        seed: Sent to the player.
        num_areas: Training areas that the player shall make.
        port: The port for player 0 if it is launched here (the editor's is 5004).
        timeout_wait: Seconds to wait for the player.
        log_folder: Where a launched player writes ``Player-<number>.log``.
        side_channels: Channels to register.
        number: Of several players, from 0; added to the port.
        env_args: Arguments of a launched player's own.
        listen: Where to listen, unless ``env`` says so. The protocol has no authentication: a warning is printed for
            anything but loopback.

    Raises:
        TrainerError: No such executable, port in use, nobody dialled in, or the player stopped.
    """
    file_name, host, port = place(env, port, listen)
    port += number
    if not 1 <= port <= 65535:
        raise TrainerError(f"Port {port} does not exist; ports go from 1 to 65535.")
    options: dict[str, Any] = {
        "seed": seed,
        "num_areas": num_areas,
        "timeout_wait": timeout_wait,
        "side_channels": side_channels,
        "additional_args": list(env_args),
    }
    if env == BUILTIN:
        options["additional_args"] += ["--parent", str(os.getpid())]
        if host not in (LOOPBACK, "0.0.0.0", "[::]"):
            options["additional_args"] += ["--host", host]
    if file_name is not None:
        file_name = launch_path(file_name)
    if not is_loopback(host):
        Console(stderr=True).print(
            f"Warning: listening on {host}:{port}, which other machines can reach. The ML-Agents protocol has no "
            "authentication and no encryption: whoever connects first is the player. Trust that network, or leave it.",
            style="yellow",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
    if log_folder is not None:
        log_folder.mkdir(parents=True, exist_ok=True)
        options["log_folder"] = str(log_folder.absolute())
    try:
        return Environment(file_name, port, host, number, **options)
    except UnityWorkerInUseException as error:
        raise TrainerError(f"Port {port} on {host} is in use; choose another with --base-port.") from error
    except UnityTimeOutException as error:
        raise TrainerError(
            f"No player dialled in on {host}:{port} within {timeout_wait} s; start one with '--mlagents-port {port}', "
            "or give it more time with --timeout-wait."
        ) from error
    except UnityException as error:
        raise TrainerError(f"{_sentence(error)}{_log_hint(log_folder and log_path(log_folder, number))}") from error
    except OSError as error:
        raise TrainerError(
            f"{file_name} does not run on this machine ({platform.system()} {platform.machine()}: {error.strerror}); "
            f"build the player for {platform.system()} on {platform.machine()}."
        ) from error


def can_be_launched(env: str) -> bool:
    """Whether the player is a program that the trainer starts itself, and so can start again."""
    return place(env, 0)[0] is not None


@contextmanager
def player_errors(log: Path | None = None) -> Iterator[None]:
    """Turns what ``mlagents_envs`` raises while a player is in use into one sentence (``TrainerError``)."""
    try:
        yield
    except (UnityException, BadNumbers) as error:
        raise TrainerError(explain(error, log)) from error


def explain(error: UnityException | RuntimeError, log: Path | None = None) -> str:
    """One sentence for what ``mlagents_envs`` raises while a player is in use, and where its log is."""
    match error:
        case UnityCommunicatorStoppedException():
            text = "The player stopped in the middle of the run."
        case UnityTimeOutException():
            text = f"{_sentence(error)} The player hangs or is too slow."
        case _:
            text = _sentence(error)
    return text + _log_hint(log)


def log_path(log_folder: Path, number: int) -> Path:
    """Where a launched player logs."""
    return log_folder / f"Player-{number}.log"


def only_behavior(environment: UnityEnvironment) -> tuple[str, BehaviorSpec]:
    """Name and spec of the environment's one behavior, which it makes known with its first agents.

    Raises:
        TrainerError: There are several, or one called Corridor that does not keep the corridor's contract.
    """
    if not environment.behavior_specs:
        environment.reset()
    specs = dict(environment.behavior_specs.items())
    if len(specs) != 1:
        raise TrainerError(
            f"The player has {len(specs)} behaviors ({', '.join(specs)}), but one was expected; "
            "give all agents the same Behavior Name and team."
        )
    name, spec = next(iter(specs.items()))
    if is_corridor(name):
        check_contract(spec)
    return name, spec


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to what listens on a host."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == LOOPBACK


def place(env: str, port: int, listen: str = LOOPBACK) -> tuple[str | None, str, int]:
    """Executable (None: wait for a player), host and port to listen on; ``port`` is for an executable."""
    if env == BUILTIN:
        return _builtin_player(), listen, port
    if env == EDITOR:
        return None, listen, UnityEnvironment.DEFAULT_EDITOR_PORT
    host, colon, number = env.rpartition(":")
    if colon and number.isdigit() and os.sep not in env:
        return None, host, int(number)
    return env, listen, port


def check_launchable(env: str) -> None:
    """Refuses what can be seen, without starting it, not to be a player.

    Raises:
        TrainerError: A player is to be launched, and there is none, or it may not be executed.
    """
    file_name, _, _ = place(env, 0)
    if file_name is not None:
        launch_path(file_name)


def launch_path(file_name: str) -> str:
    """The program that ``mlagents_envs`` would launch for a build's name.

    Raises:
        TrainerError: There is none, or it may not be executed.
    """
    path = env_utils.validate_environment_path(file_name)
    if path is None:
        if Path(file_name).suffix in FOREIGN and Path(file_name).exists():
            system, here = FOREIGN[Path(file_name).suffix], platform.system()
            raise TrainerError(
                f"{file_name} is a build for {system}, but this machine runs {here}; choose {here} as the target "
                "platform in Unity's Build Settings and build again."
            )
        if Path(file_name).is_dir():
            raise TrainerError(f"{file_name} is a folder; give the path of the executable in it.")
        raise TrainerError(f"There is no player {file_name}; give the path of a build's executable.")
    if not os.access(path, os.X_OK):
        raise TrainerError(f"{path} may not be executed; run 'chmod +x {path}'.")
    return str(path)


def _builtin_player() -> str:
    beside = Path(sys.executable).with_name("corridor-server")
    found = str(beside) if beside.exists() else shutil.which("corridor-server")
    if found is None:
        raise TrainerError("The command corridor-server is not installed; run 'pip install .[trainer]'.")
    return found


def _sentence(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _log_hint(log: Path | None) -> str:
    return f" The player's log is {log}." if log is not None and log.exists() else ""
