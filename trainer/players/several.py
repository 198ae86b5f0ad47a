"""The players of a run as one ``VecEnv``: stepped concurrently, and started again when they die.

Crash handling is that of ``mlagents-learn``: the same failures, limits and defaults, each limit counted for each player
alone. What differs: only the player that failed starts again, and its seed moves on, so that it does not play the
episodes of its first life once more.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mlagents_envs.base_env import BehaviorSpec
from mlagents_envs.exception import (
    UnityCommunicationException,
    UnityCommunicatorStoppedException,
    UnityEnvironmentException,
    UnityException,
    UnityTimeOutException,
)
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray
from rich.console import Console
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from trainer.config import RestartLimits, RunConfig
from trainer.errors import TrainerError
from trainer.players.area_state import PlayerState
from trainer.players.environment import (
    LOOPBACK,
    BadNumbers,
    Environment,
    can_be_launched,
    explain,
    log_path,
    only_behavior,
    open_environment,
    place,
    player_errors,
)
from trainer.players.gym_wrapper import EpisodeStatistics, UnityGymException, UnityToGymWrapper
from trainer.players.settings import channels
from trainer.players.vec_env import Areas, UnityVecEnv
from trainer.signals import uninterrupted

# Player k of a run with seed s has seed s + k * PLAYER_STRIDE, and after its r-th restart r * RESTART_STRIDE more.
PLAYER_STRIDE = 2**24
RESTART_STRIDE = 2**16 + 1
SEEDS = 2**31

# Of these mlagents-learn says that the player died or hangs.
FAILURES = (
    UnityCommunicationException,
    UnityCommunicatorStoppedException,
    UnityEnvironmentException,
    UnityTimeOutException,
)


@dataclass(frozen=True)
class Player:
    """One player, open: its environment, its areas as slots, what they are doing, and its one behavior."""

    environment: Environment
    slots: VecEnv
    state: PlayerState
    behavior: str
    spec: BehaviorSpec


class Players(Areas):
    """Players of one kind, whose areas are slots: player k has the slots from ``k * areas`` on.

    All get their actions before the first answer is awaited. A player that dies or hangs is started again, and its
    running episodes are dropped: each of its slots shows an episode that is cut (``TimeLimit.truncated``, reward 0,
    the last observation that was seen as ``terminal_observation``), marked ``dropped`` in its info, and the first
    observation of the next.

    Args:
        start: Opens player k for its n-th life.
        lives: For each player, how often one was started before, in earlier parts of a resumed run.
        limits: How often one may be started again.
        logs: Folder of the players' logs; one that died leaves its log as ``Player-<k>.died-<r>.log``.
        launched: Whether ``start`` launches players; else it waits for one to dial in, and waits only once.

    Attributes:
        behavior: The name of the players' behavior.
        behavior_spec: What its agents observe and do.
        restarts: How often players were started again.
        exchange_seconds: Time spent exchanging messages with them, as ``Environment`` counts it.
        observations: What every slot showed last, (slots, observation size).

    Raises:
        TrainerError: A player can't be opened, or one differs from the others.
    """

    def __init__(
        self,
        start: Callable[[int, int], Player],
        lives: Sequence[int],
        limits: RestartLimits,
        logs: Path,
        launched: bool,
    ) -> None:
        self._start = start
        self._earlier_lives = lives
        self._limits = limits
        self._logs = logs
        self._launched = launched
        self._console = Console(stderr=True)
        self._restarts: list[list[float]] = [[] for _ in lives]
        self._former_exchange_seconds = 0.0  # of players that died
        self._players = _open_all(start, lives)
        first = self._players[0]
        self.behavior, self.behavior_spec, self._areas = first.behavior, first.spec, first.slots.num_envs
        try:
            for number, player in enumerate(self._players):
                self._check_alike(number, player)
        except TrainerError:
            self.close()
            raise
        super().__init__(len(lives) * self._areas, first.slots.observation_space, first.slots.action_space)

    @property
    def restarts(self) -> int:
        """How often players were started again."""
        return sum(len(times) for times in self._restarts)

    @property
    def exchange_seconds(self) -> float:
        """Time spent exchanging messages with them."""
        return self._former_exchange_seconds + sum(each.environment.exchange_seconds for each in self._players)

    @property
    def lives(self) -> list[int]:
        """For each player, how often one was started before the present one, in the whole run."""
        return [earlier + len(times) for earlier, times in zip(self._earlier_lives, self._restarts, strict=True)]

    def ask_states(self) -> None:
        """Has every player that can send its areas' state with its answer to the next step."""
        for player in self._players:
            player.state.ask()

    def states(self) -> list[bytes] | None:
        """What every player last answered to ``ask_states``; None if one never did."""
        states = [player.state.state for player in self._players]
        known = [state for state in states if state is not None]
        return known if len(known) == len(states) else None

    def reset(self) -> VecEnvObs:
        """Begins an episode in every slot."""
        parts = [self._reset(number) for number in range(len(self._players))]
        self.observations = parts[0] if len(parts) == 1 else np.concatenate(parts)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return self.observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hands every player its actions."""
        for number, player in enumerate(self._players):
            player.slots.step_async(actions[self._slots(number)])

    def step_wait(self) -> VecEnvStepReturn:
        """Waits for every player's areas to ask for their next decision."""
        parts = [self._wait(number) for number in range(len(self._players))]
        if len(parts) == 1:
            self.observations = np.asarray(parts[0][0])
            return parts[0]
        observations, rewards, dones, infos = zip(*parts, strict=True)
        self.observations = np.concatenate(observations)
        return self.observations, np.concatenate(rewards), np.concatenate(dones), [i for part in infos for i in part]

    def close(self) -> None:
        """Closes every player."""
        for player in self._players:
            if player.environment._loaded:
                player.environment.close()

    def _slots(self, number: int) -> slice:
        return slice(number * self._areas, (number + 1) * self._areas)

    def _reset(self, number: int) -> NDArray[Any]:
        while True:
            try:
                return np.asarray(self._players[number].slots.reset())
            except FAILURES as error:
                self._restart(number, error)
            except BadNumbers as error:
                raise TrainerError(explain(error, log_path(self._logs, number))) from error

    def _wait(self, number: int) -> VecEnvStepReturn:
        try:
            return self._players[number].slots.step_wait()
        except FAILURES as error:
            self._restart(number, error)
        except BadNumbers as error:
            where = error.in_area(0) if self._areas == 1 else error
            raise TrainerError(explain(where, log_path(self._logs, number))) from where
        last, next_observations = self.observations[self._slots(number)], self._reset(number)
        cut = [{"terminal_observation": each, "TimeLimit.truncated": True, "dropped": True} for each in last]
        return next_observations, np.zeros(len(last), np.float32), np.ones(len(last), np.bool_), cut

    def _restart(self, number: int, failure: UnityException) -> None:
        """Starts a player again, as often as it takes to have one that plays.

        Raises:
            TrainerError: It failed too often, or it can't be started.
        """
        dead = self._players[number].environment
        self._former_exchange_seconds += dead.exchange_seconds
        dead.kill()
        while True:
            self._allow_restart(number, failure)
            try:
                player = self._start(number, self.lives[number])
                break
            except TrainerError as error:
                if not self._launched or not isinstance(error.__cause__, FAILURES):
                    raise
                failure = error.__cause__
        self._players[number] = player
        self._check_alike(number, player)

    def _allow_restart(self, number: int, failure: UnityException) -> None:
        """Counts a restart and says why it is made.

        Raises:
            TrainerError: The limits allow no more.
        """
        limits, times, now = self._limits, self._restarts[number], time.monotonic()
        log = _keep_log(log_path(self._logs, number), len(times) + 1)
        reason = explain(failure, log)
        if limits.max_lifetime_restarts != -1 and len(times) >= limits.max_lifetime_restarts:
            raise TrainerError(
                f"{reason} Player {number} is not started again: --max-lifetime-restarts allows "
                f"{limits.max_lifetime_restarts}."
            ) from failure
        recent = sum(now - each < limits.restarts_rate_limit_period_s for each in times)
        if limits.restarts_rate_limit_n != -1 and recent >= limits.restarts_rate_limit_n:
            raise TrainerError(
                f"{reason} Player {number} is not started again: --restarts-rate-limit-n allows "
                f"{limits.restarts_rate_limit_n} in {limits.restarts_rate_limit_period_s:g} s."
            ) from failure
        times.append(now)
        again = "It is started again" if self._launched else "Waiting for it to dial in again"
        self._console.print(
            f"Player {number}: {reason} {again} (restart {len(times)}).", markup=False, highlight=False, soft_wrap=True
        )

    def _check_alike(self, number: int, player: Player) -> None:
        same = player.behavior == self.behavior and player.spec.action_spec == self.behavior_spec.action_spec
        shapes = [[tuple(each.shape) for each in spec.observation_specs] for spec in (player.spec, self.behavior_spec)]
        if not same or shapes[0] != shapes[1] or player.slots.num_envs != self._areas:
            raise TrainerError(
                f"Player {number} has {player.slots.num_envs} areas of {player.behavior} with observations of shapes "
                f"{shapes[0]}, but the first had {self._areas} of {self.behavior} with {shapes[1]}; all players have "
                "to be the same build."
            )


class EpisodeMonitor(VecMonitor):
    """``VecMonitor`` that reports no episode which a player's death cut."""

    def step_wait(self) -> VecEnvStepReturn:
        """Adds ``episode`` to the info of every episode that was played to its end."""
        observations, rewards, dones, infos = super().step_wait()
        for slot in np.flatnonzero(dones):
            if "dropped" in infos[slot]:
                del infos[slot]["episode"]
        return observations, rewards, dones, infos


@contextmanager
def open_player(
    config: RunConfig,
    logs: Path,
    *,
    seed: int,
    port: int,
    timeout_wait: int,
    limits: RestartLimits = RestartLimits(),  # noqa: B008 - frozen
    lives: Sequence[int] | None = None,
    states: Sequence[bytes] | None = None,
    listen: str = LOOPBACK,
) -> Iterator[tuple[Players, str]]:
    """Opens the run's players as a VecEnv, and closes them whatever happens.

    Args:
        config: The run.
        logs: Folder for the players' logs.
        seed: Player 0's; the others' follow from it.
        port: Player 0's, if it is launched here; the others' follow.
        timeout_wait: Seconds to wait for each message of a player.
        limits: How often one that failed may be started again.
        lives: How often each was started before, in earlier parts of a resumed run.
        states: Of each, the areas' state to go on with.
        listen: Where to listen for players, unless ``config.env`` says so.

    Yields:
        The environments, unwrapped, and the behavior's name.

    Raises:
        TrainerError: A player can't be started, or does not fit.
    """
    lives = [0] * config.num_envs if lives is None else lives

    def start(number: int, life: int) -> Player:
        player_seed = (seed + number * PLAYER_STRIDE + life * RESTART_STRIDE) % SEEDS
        state = PlayerState(states[number] if states is not None and life == lives[number] else None)
        return _open(config, logs, number, player_seed, port, timeout_wait, state, listen)

    first = place(config.env, port)[2]
    if first + config.num_envs - 1 > 65535:
        raise TrainerError(f"{config.num_envs} players from port {first} on need ports above 65535; begin lower.")
    players = Players(start, lives, limits, logs, can_be_launched(config.env))
    try:
        with player_errors(log_path(logs, 0)):
            yield players, players.behavior
    except UnityGymException as error:
        raise TrainerError(str(error)) from error
    finally:
        with uninterrupted():
            players.close()


def _open(
    config: RunConfig,
    logs: Path,
    number: int,
    seed: int,
    port: int,
    timeout_wait: int,
    state: PlayerState,
    listen: str,
) -> Player:
    statistics = StatsSideChannel()
    environment = open_environment(
        config.env,
        seed=seed,
        num_areas=config.num_areas,
        port=port,
        timeout_wait=timeout_wait,
        log_folder=logs,
        side_channels=[statistics, *channels(config, seed), state],
        number=number,
        env_args=config.env_args,
        listen=listen,
    )
    try:
        with player_errors(log_path(logs, number)):
            slots = (
                _one_area(config, environment, statistics)
                if config.through_gym
                else UnityVecEnv(environment, statistics)
            )
            return Player(environment, slots, state, *only_behavior(environment))
    except BaseException:
        environment.kill()
        raise


def _one_area(config: RunConfig, environment: Environment, statistics: StatsSideChannel) -> VecEnv:
    try:
        wrapper = UnityToGymWrapper(environment, action_space_seed=config.seed)
    except UnityGymException as error:
        behavior, _ = only_behavior(environment)  # which knows better what a scene has to change
        agents = max(map(len, environment.get_steps(behavior)))
        if agents > 1:
            raise TrainerError(
                f"The player has {agents} agents, but preset {config.preset} trains one, through UnityToGymWrapper; "
                "leave one agent in the scene, or take preset fast."
            ) from error
        raise TrainerError(str(error)) from error
    return DummyVecEnv([lambda: EpisodeStatistics(wrapper, statistics)])


def _open_all(start: Callable[[int, int], Player], lives: Sequence[int]) -> list[Player]:
    """Opens players side by side: a build may take long to start."""
    if len(lives) == 1:
        return [start(0, lives[0])]
    with ThreadPoolExecutor(len(lives)) as pool:
        futures = [pool.submit(start, number, life) for number, life in enumerate(lives)]
    failed = [error for future in futures if (error := future.exception()) is not None]
    players = [future.result() for future in futures if future.exception() is None]
    if failed:
        for player in players:
            player.environment.kill()
        raise failed[0]
    return players


def _keep_log(log: Path, restart: int) -> Path:
    """Renames the log of a player that died: its next life writes a new one."""
    kept = log.with_suffix(f".died-{restart}.log")
    if log.exists():
        log.replace(kept)
    return kept
