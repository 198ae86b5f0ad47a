"""Opens players: one environment by hand, or all the players of a run."""

import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mlagents_envs.exception import UnityException, UnityTimeOutException, UnityWorkerInUseException
from mlagents_envs.side_channel.side_channel import SideChannel
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from corridor_server.shared.addresses import LOOPBACK, PORTS, WILDCARDS, authority, is_loopback
from corridor_server.shared.given import Range, shown
from trainer.config import ConnectionOptions, RestartLimits, RunConfig
from trainer.corridor import DEFAULT_PENALTY, check_areas, is_corridor
from trainer.curriculum import Curricula
from trainer.errors import TrainerError
from trainer.players.area_state import PlayerState
from trainer.players.behavior import only_behavior
from trainer.players.connected import Connected
from trainer.players.environment import Environment
from trainer.players.failures import PlayerLogs, last_lines, player_errors, sentence
from trainer.players.gym_wrapper import UnityGymException, UnityToGymWrapper
from trainer.players.location import BUILTIN, can_be_launched, check_connection, launch_path, place
from trainer.players.scene import Scene
from trainer.players.settings import channels, tell_corridor
from trainer.players.several import OpenPlayer, Players
from trainer.players.statistics_channel import NoStatistics, Statistics
from trainer.players.trained import EpisodeStatistics, TrainedSlots
from trainer.players.vec_env import action_space
from trainer.seeds import player_seed
from trainer.signals import deferred
from trainer.terminal import Terminal

AREAS = Range(1, 2**31 - 1)  # what the protocol carries
SECONDS = Range(0, 10**9)


def open_environment(
    env: str | Path,
    *,
    seed: int,
    num_areas: int,
    port: int,
    timeout_wait: float,
    log_folder: str | Path | None = None,
    side_channels: list[SideChannel] | None = None,
    number: int = 0,
    env_args: Sequence[str] = (),
    listen: str = LOOPBACK,
    graphics: bool = False,
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
        graphics: Whether a launched build shall open a window and render, as cameras in a scene need.

    Raises:
        TrainerError: An argument is none that can be, no such executable, port in use, nobody dialled in, or the
            player stopped.
    """
    env = str(env)
    num_areas = int(_number("num_areas", num_areas, AREAS, whole=True))
    timeout_wait = _number("timeout_wait", timeout_wait, SECONDS)
    if isinstance(env_args, str) or not all(isinstance(each, str) for each in env_args):
        raise TrainerError(
            f"env_args is {shown(env_args)}, but a list of texts was expected, such as ['--gym', 'CartPole-v1']."
        )
    if env == BUILTIN:
        check_areas(num_areas)
    file_name, host, port = place(env, port, listen)
    port = int(_number("port", port, PORTS, whole=True)) + number
    if PORTS.read(port, whole=True) is None:
        raise TrainerError(f"Port {port} does not exist; ports go from 1 to 65535.")
    given = side_channels or []
    options: dict[str, Any] = {
        "seed": seed,
        "num_areas": num_areas,
        "timeout_wait": timeout_wait,
        "side_channels": given
        if any(isinstance(each, StatsSideChannel) for each in given)
        else [*given, NoStatistics()],
        "additional_args": list(env_args),
        "graphics": graphics,
    }
    if env == BUILTIN:
        options["additional_args"] += ["--parent", str(os.getpid())]
        if host != LOOPBACK and host not in WILDCARDS:
            options["additional_args"] += ["--host", host]
    if file_name is not None:
        file_name = launch_path(file_name)
    if not is_loopback(host):
        Terminal(stderr=True).print(
            f"Warning: listening on {authority(host, port)}, which other machines can reach. The ML-Agents protocol "
            "has no authentication and no encryption: whoever connects first is the player. Trust that network, or "
            "leave it.",
            style="yellow",
        )
    log = None if log_folder is None else PlayerLogs(Path(log_folder)).of(number)
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)
        options["log_folder"] = str(log.parent.absolute())
        if file_name is not None:
            log.unlink(missing_ok=True)  # who fails before it logs anything must not be quoted with another's words
    try:
        return Environment(file_name, port, host, number, log=log, **options)
    except UnityWorkerInUseException as error:
        raise TrainerError(
            f"Port {port} on {host} is in use; choose another with --base-port (in Python, port)."
        ) from error
    except UnityTimeOutException as error:
        raise TrainerError(
            f"No player dialled in on {authority(host, port)} within {timeout_wait:g} s; start one with "
            f"'--mlagents-port {port}', or give it more time with --timeout-wait (in Python, timeout_wait)."
            + _said(log)
        ) from error
    except UnityException as error:
        raise TrainerError(sentence(error) + _said(log)) from error
    except OSError as error:
        raise TrainerError(
            f"{file_name} does not run on this machine ({platform.system()} {platform.machine()}: {error.strerror}); "
            f"build the player for {platform.system()} on {platform.machine()}."
        ) from error


@contextmanager
def open_players(
    config: RunConfig,
    logs: PlayerLogs,
    connection: ConnectionOptions,
    *,
    seed: int,
    limits: RestartLimits = RestartLimits(),  # noqa: B008 - frozen
    lives: Sequence[int] | None = None,
    states: Sequence[bytes] | None = None,
    curricula: Curricula | None = None,
) -> Iterator[Players | Scene]:
    """Opens the run's players, and closes them whatever happens.

    Args:
        config: The run.
        logs: Where the players log.
        connection: Where they are reached, unless ``config.env`` says so; the first one's port, the others' follow.
        seed: Player 0's; the others' follow from it.
        limits: How often one that failed may be started again.
        lives: How often each was started before, in earlier parts of a resumed run.
        states: Of each, the areas' state to go on with.
        curricula: Whose present lessons a player begins with, whenever it is started; None for the first ones.

    Yields:
        The players as a ``VecEnv`` where the run is in lockstep (a corridor, or with a preset), else as a scene.

    Raises:
        TrainerError: A player can't be started, or does not fit.
    """
    lives = [0] * config.num_envs if lives is None else lives

    def connect(number: int, life: int) -> Connected:
        state = PlayerState(states[number] if states is not None and life == lives[number] else None)
        return _connect(config, logs, connection, number, player_seed(seed, number, life), state, curricula)

    check_connection(config, connection)
    players = _open_players(config, logs, connect, lives, limits)
    try:
        with player_errors(logs, 0):
            yield players
    except UnityGymException as error:
        raise TrainerError(str(error)) from error
    finally:
        with deferred():
            players.close()


@contextmanager
def open_slots(
    config: RunConfig,
    logs: PlayerLogs,
    connection: ConnectionOptions,
    *,
    seed: int,
    limits: RestartLimits = RestartLimits(),  # noqa: B008 - frozen
) -> Iterator[Players]:
    """``open_players`` for what only runs in lockstep have.

    Raises:
        TrainerError: It is another run; or as ``open_players``.
    """
    with open_players(config, logs, connection, seed=seed, limits=limits) as players:
        if not isinstance(players, Players):
            players.reset()  # which says what behaviors it has
            raise TrainerError(
                f"The run {config.run_id} is of behaviors {', '.join(players.behaviors) or 'that come late'}, but one "
                "of the corridor, or with a preset, was expected; corridor evaluate plays every run."
            )
        yield players


def _open_players(
    config: RunConfig,
    logs: PlayerLogs,
    connect: Callable[[int, int], Connected],
    lives: Sequence[int],
    limits: RestartLimits,
) -> Players | Scene:
    launched = can_be_launched(config.env)

    def as_slots(number: int, life: int) -> OpenPlayer:
        return _as_slots(config, logs, number, connect(number, life))

    if _is_lockstep(config):
        return Players(as_slots, lives, limits, logs, launched)
    opened: list[Connected] = []

    def begin(number: int, life: int) -> Connected:
        if number == 0 and opened:
            return opened.pop()
        player = connect(number, life)
        try:
            with player_errors(logs, number):
                player.environment.reset()  # behaviors are only known once the player has sent agents
            if not _becomes_lockstep(config, player):
                _check_penalty(config)
        except BaseException:
            player.environment.kill()
            raise
        return player

    opened.append(begin(0, lives[0]))  # the first shows what there is to train
    if _becomes_lockstep(config, opened[0]):
        return Players(
            lambda number, life: _as_slots(config, logs, number, begin(number, life)), lives, limits, logs, launched
        )
    return Scene(begin, lives, limits, logs, launched)


def _becomes_lockstep(config: RunConfig, player: Connected) -> bool:
    """Whether a run that nobody said more of trains as the paper, as its player turned out to be a corridor."""
    is_said = config.behaviors or config.default_settings is not None
    return not is_said and all(map(is_corridor, player.environment.behavior_specs))


def _check_penalty(config: RunConfig) -> None:
    """Refuses a penalty of a run whose player will not be told of it."""
    if config.env != BUILTIN and config.penalty != DEFAULT_PENALTY:
        raise TrainerError(
            f"--penalty is {config.penalty:g}, but only the corridor has one, and only in runs that train as a preset "
            "does; leave it out."
        )


def _is_lockstep(config: RunConfig) -> bool:
    """Whether a run trains as the paper, whatever its players show: one behavior, whose agents all decide together.

    A preset and an algorithm are for that; settings for behaviors are for everything else.
    """
    if config.behaviors or config.default_settings is not None:
        return False
    return config.env == BUILTIN or config.preset_given or config.algo != "ppo" or config.from_sb3 is not None


def _connect(
    config: RunConfig,
    logs: PlayerLogs,
    connection: ConnectionOptions,
    number: int,
    seed: int,
    state: PlayerState,
    curricula: Curricula | None,
) -> Connected:
    statistics, (engine, parameters) = Statistics(), channels(config, seed, curricula)
    environment = open_environment(
        config.env,
        seed=seed,
        num_areas=config.num_areas,
        port=connection.base_port,
        timeout_wait=connection.timeout_wait,
        log_folder=logs.folder,
        side_channels=[statistics, engine, parameters, state],
        number=number,
        env_args=config.env_args,
        listen=connection.listen,
        graphics=config.graphics,
    )
    return Connected(environment, statistics, parameters, state, seed)


def _as_slots(config: RunConfig, logs: PlayerLogs, number: int, player: Connected) -> OpenPlayer:
    environment = player.environment
    try:
        with player_errors(logs, number):
            found = only_behavior(environment)[0].partition("?")[0]
            if config.behavior not in (None, found):
                raise TrainerError(
                    f"The file has settings for the behavior {shown(config.behavior)}, but the player's is "
                    f"{shown(found)}; rename it there."
                )
            if config.env != BUILTIN and is_corridor(only_behavior(environment)[0]):
                tell_corridor(config, player.parameters)
                if not config.through_gym:  # UnityToGymWrapper begins with a reset
                    environment.reset()
            else:
                _check_penalty(config)
            slots = (
                _one_area(config, environment, player.statistics)
                if config.through_gym
                else TrainedSlots(environment, player.statistics)
            )
            return OpenPlayer(environment, slots, player.state, *only_behavior(environment))
    except BaseException:
        environment.kill()
        raise


def _number(name: str, value: Any, numbers: Range, whole: bool = False) -> float:
    """An argument that is a number.

    Raises:
        TrainerError: It is another, or none.
    """
    read = numbers.read(value, whole)
    if read is None:
        raise TrainerError(f"{name} is {shown(value)}, but {numbers.expected(whole)}.")
    return read


def _said(log: Path | None) -> str:
    return "" if log is None else last_lines(log)


def _one_area(config: RunConfig, environment: Environment, statistics: Statistics) -> VecEnv:
    try:
        wrapper = UnityToGymWrapper(environment, action_space_seed=config.seed)
    except UnityGymException as error:
        behavior, _ = only_behavior(environment)  # which knows better what a scene has to change
        agents = max(map(len, environment.get_steps(behavior)))  # its last, though the wrapper has closed it
        if agents > 1:
            raise TrainerError(
                f"The player has {agents} agents, but preset {config.preset} trains one, through UnityToGymWrapper; "
                "leave one agent in the scene, or take preset fast."
            ) from error
        raise TrainerError(str(error)) from error
    action_space(only_behavior(environment)[1])  # one kind
    return DummyVecEnv([lambda: EpisodeStatistics(wrapper, statistics)])
