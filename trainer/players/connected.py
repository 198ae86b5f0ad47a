"""A player that has shaken hands, and what reaches it beside actions; several are opened side by side."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar

from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel

from trainer.players.area_state import PlayerState
from trainer.players.environment import Environment
from trainer.players.statistics_channel import Statistics


@dataclass(frozen=True)
class Connected:
    """One player.

    Attributes:
        environment: Its environment, reset once.
        statistics: What it reports.
        parameters: The channel of its environment parameters.
        state: What its areas are doing, as far as it says.
        seed: Its own.
    """

    environment: Environment
    statistics: Statistics
    parameters: EnvironmentParametersChannel
    state: PlayerState
    seed: int


class _Opened(Protocol):
    @property
    def environment(self) -> Environment: ...


Player = TypeVar("Player", bound=_Opened)


def open_all(start: Callable[[int, int], Player], lives: Sequence[int]) -> list[Player]:
    """Opens players side by side: a build may take long to start.

    Args:
        start: Opens player k for its n-th life.
        lives: Of each player.
    """
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
