"""A player that died or hung is started again here, as often as the limits allow."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from mlagents_envs.exception import UnityException

from trainer.config import RestartLimits
from trainer.errors import TrainerError
from trainer.players.failures import FAILURES, PlayerLogs, explain
from trainer.terminal import Terminal

Player = TypeVar("Player")


class Restarts:
    """Counts one player's restarts against the limits, and says on standard error why each is made.

    Args:
        number: Which player.
        limits: How often it may be started again.
        logs: Where it logs; one that died leaves its log as ``<name>.died-<restart>.log``.
        launched: Whether it is launched here; else it has to dial in again.
    """

    def __init__(self, number: int, limits: RestartLimits, logs: PlayerLogs, launched: bool) -> None:
        self._number = number
        self._limits = limits
        self._logs = logs
        self._launched = launched
        self._console = Terminal(stderr=True)
        self._times: list[float] = []

    @property
    def count(self) -> int:
        """How many restarts there were."""
        return len(self._times)

    def start_again(self, failure: UnityException, start: Callable[[], Player]) -> Player:
        """Starts the player as often as it takes to have one that plays.

        Args:
            failure: Of which the former one died.
            start: Starts it once; ``count`` already counts this time.

        Raises:
            TrainerError: It failed too often, or it can't be started.
        """
        while True:
            self._allow(failure)
            try:
                return start()
            except TrainerError as error:
                if not self._launched or not isinstance(error.__cause__, FAILURES):
                    raise
                failure = error.__cause__

    def _allow(self, failure: UnityException) -> None:
        """Counts a restart and says why it is made.

        Raises:
            TrainerError: The limits allow no more.
        """
        limits, now = self._limits, time.monotonic()
        reason = explain(failure) + self._logs.hint(self._keep_log())
        if limits.max_lifetime_restarts != -1 and self.count >= limits.max_lifetime_restarts:
            raise TrainerError(
                f"{reason} Player {self._number} is not started again: --max-lifetime-restarts allows "
                f"{limits.max_lifetime_restarts}."
            ) from failure
        recent = sum(now - each < limits.restarts_rate_limit_period_s for each in self._times)
        if limits.restarts_rate_limit_n != -1 and recent >= limits.restarts_rate_limit_n:
            raise TrainerError(
                f"{reason} Player {self._number} is not started again: --restarts-rate-limit-n allows "
                f"{limits.restarts_rate_limit_n} in {limits.restarts_rate_limit_period_s:g} s."
            ) from failure
        self._times.append(now)
        again = "It is started again" if self._launched else "Waiting for it to dial in again"
        self._console.print(
            f"Player {self._number}: {reason} {again} (restart {self.count}).",
        )

    def _keep_log(self) -> Path:
        """Renames the log of a player that died: its next life writes a new one."""
        log = self._logs.of(self._number)
        kept = log.with_suffix(f".died-{self.count + 1}.log")
        if log.exists():
            log.replace(kept)
        return kept
