"""The built-in player, and this trainer's own client of it."""

from collections.abc import Iterator
from contextlib import contextmanager

from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel

from trainer.players.location import BUILTIN, launch_path, place
from trainer.players.opening import open_environment
from trainer.signals import temporary_folder


def player_path() -> str:
    """The built-in player's program."""
    return launch_path(place(BUILTIN, 0)[0] or "")


@contextmanager
def our_client(areas: int, port: int) -> Iterator[tuple[UnityEnvironment, StatsSideChannel]]:
    """This trainer's environment on the built-in player, after its first reset, and the channel of its statistics."""
    channel = StatsSideChannel()
    with temporary_folder() as logs:
        environment = open_environment(
            BUILTIN,
            seed=1,
            num_areas=areas,
            port=port,
            timeout_wait=30,
            log_folder=logs,
            side_channels=[channel],
        )
        environment.reset()
        try:
            yield environment, channel
        finally:
            environment.close()
