"""What a player plays: agents that ask for decisions, get rewards and end."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from corridor_server.protocol.samplers import Value
from corridor_server.shared.given import shown

logger = logging.getLogger(__name__)

MOST_NUMBERS = 2**22  # of one sensor: a message has 256 MiB
MOST_CHOICES = 10_000  # of an action: numbers, and choices of all branches together

Moment = Mapping[str, Agents]
Statistics = Mapping[str, NDArray[np.float64]]


class SimulationError(Exception):
    """The simulation can't be played, or not any further; the message is for the user."""


class NotRestored(Exception):
    """A saved state can't be taken up, and nothing has changed; the message says why."""


class Stopped(KeyboardInterrupt):
    """A signal asked the player to stop; in an environment's code nobody takes it for an error of theirs."""


def failed(what: str, error: BaseException) -> SimulationError:
    """What is said of an author's code that raised: one sentence with the error's own words."""
    said = " ".join(str(error).split())[:300]
    if isinstance(error, EOFError) and not said:  # of the pipe to a copy's process
        said = "its process ended"
    return SimulationError(f"{what} ({type(error).__name__}{': ' if said else ''}{said}).")


def number_of(reward: object) -> float:
    """A reward that an author's code gave; some say [1.0].

    Raises:
        ValueError: It is no number.
    """
    value = np.asarray(reward)
    if value.dtype.kind not in "fiub" or value.size != 1:
        raise ValueError(f"a reward is {shown(reward)}, but a number was expected")
    return float(value.reshape(()))


@contextmanager
def blaming(what: str, *but: type[Exception]) -> Iterator[None]:
    """Says of an author's code within it that it failed, also of code that would end the process.

    Args:
        what: The sentence's beginning.
        but: What the code may raise.
    """
    try:
        yield
    except (SimulationError, Stopped):
        raise
    except but:
        raise
    except BaseException as error:  # whatever an author's code raises
        raise failed(what, error) from error


def try_to_close(name: str, close: Callable[[], object]) -> bool:
    """Closes what an author wrote; returns whether that went well. If not, the session was no worse for it."""
    try:
        close()
    except Stopped:
        raise
    except BaseException as error:  # whatever an author's code raises
        logger.warning("%s", failed(f"{name} failed when it was closed", error))
        return False
    return True


class Simulation(ABC):
    """Episodes that begin anew by themselves, for a player to serve.

    A moment is what happened up to the next time that anybody asks for an action: the agents of each behavior by the
    behavior's full name. In it an agent stands at most twice, first as one whose episode ended (``done``) and then as
    one that asks; those that ended stand before those that ask. An agent's id is its own for its life, over all its
    episodes, and no other agent's of the simulation; ids count from 0.

    Agents need not ask in step, and behaviors may come later: an agent that is in no moment is waiting or away.
    """

    is_checked = False  # whether what it gives was checked; the player checks what any other gives
    restored = False  # whether it stands where a saved state was put back, and has not moved since
    acts_when_idle = True  # whether agents act with zeros when nobody decides, as Unity's; not those that take turns

    @property
    @abstractmethod
    def behaviors(self) -> Mapping[str, Behavior]:
        """The behaviors by their full names, such as ``Corridor?team=0``: all that a moment has had so far."""

    @abstractmethod
    def reset(self) -> Moment:
        """Begins an episode everywhere, with at least one agent that asks and none that ended.

        A trainer may ask for it at any time. An episode that began by itself when the last one ended, and has not moved
        yet, is best kept: resetting after an end, as Gymnasium's loop does, then skips none.
        """

    @abstractmethod
    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Applies an action to each agent of the last moment that asked, and goes on until the next moment.

        Args:
            actions: Of each behavior that had agents that asked, in their order. Finite; choices are within their
                branches; continuous ones may lie outside [-1, 1].

        Returns:
            The moment, in which somebody asks or ended. And numbers for the statistics channel, one per ended episode,
            by name.

        Raises:
            SimulationError: It can't go on.
        """

    def set_parameter(self, name: str, value: Value) -> None:
        """Sets an environment parameter, from the next episode on.

        Raises:
            ValueError: There is none of this name, or it can't have this value.
        """
        raise ValueError(f"{name!r} is set by the trainer, but this simulation has no environment parameters.")

    def snapshot(self) -> NDArray[np.void] | None:
        """All that decides what happens from here on, as rows of any form; None if that can't be had."""
        return None

    def forgo_snapshots(self) -> None:  # noqa: B027 - most keep nothing for them
        """Is told before the first reset that the trainer will ask for no snapshots: nothing has to be kept for any."""

    def restore(self, rows: NDArray[np.void]) -> None:
        """Takes up what ``snapshot`` gave.

        Raises:
            NotRestored: It can't: new episodes begin.
        """
        raise NotImplementedError

    def close(self) -> None:  # noqa: B027 - most have nothing to end
        """Ends it."""
