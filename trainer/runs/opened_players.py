"""Opening a run's players, which takes a while, and says so."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import TypeVar

from trainer.activity import doing
from trainer.config import RunConfig
from trainer.players.location import can_be_launched

Opened = TypeVar("Opened")


@contextmanager
def opened(players: AbstractContextManager[Opened], config: RunConfig) -> Iterator[Opened]:
    """Enters a context that opens players, and says so until they are open.

    Args:
        players: The context.
        config: Whose players they are.
    """
    with ExitStack() as stack:
        with doing(_what(config)):
            found = stack.enter_context(players)
        yield found


def _what(config: RunConfig) -> str:
    if config.env == "editor":
        return "Waiting for the Unity editor, where Play has to be pressed"
    if not can_be_launched(config.env):
        return f"Waiting for a player at {config.env}"
    return "Starting the player" if config.num_envs == 1 else f"Starting {config.num_envs} players"
