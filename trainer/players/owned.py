"""The environment that a wrapper is handed, and owns: what it tells of pictures, and when it is closed."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from mlagents_envs.base_env import BaseEnv
from mlagents_envs.exception import UnityEnvironmentException

from trainer.players.environment import Environment

CLOSED = "The environment is closed, and its player with it; open another one with open_environment()."


@contextmanager
def closed_if_refused(environment: BaseEnv) -> Iterator[None]:
    """Closes the environment, which frees its port, if what is made of it can't be."""
    try:
        yield
    except BaseException:
        if isinstance(environment, Environment):
            environment.kill()
        else:
            with suppress(UnityEnvironmentException):  # it was closed before
                environment.close()
        raise


def compressed_pictures(environment: BaseEnv, behavior: str) -> frozenset[int]:
    """Which observations of a behavior come as PNG files, so that their values are from 0 to 1.

    The protocol tells no bounds, and pictures as floats may have any. Of an environment that isn't ours, none is known.
    """
    known = environment.compressed if isinstance(environment, Environment) else ()
    return frozenset(index for name, index in known if name == behavior)
