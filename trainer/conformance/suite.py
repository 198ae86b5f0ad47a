"""What every topic of the kit shares: its two levels, starting a player, and no sentence that passes unjudged."""

import functools
import inspect
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from trainer.conformance.raw_trainer import RawTrainer
from trainer.conformance.session import Session
from trainer.conformance.verdicts import NotApplicable, Tally

Sentence = TypeVar("Sentence", bound=Callable[..., None])
_STRICT, _NEEDED = "_strict", "_needed"


def strict(test: Sentence) -> Sentence:
    """Marks a sentence as strict: corridor-server promises it, Unity's own runtime does not keep it."""
    setattr(test, _STRICT, True)
    return test


def is_strict(test: Callable[..., None]) -> bool:
    """Whether a sentence is strict; the others are the protocol's."""
    return hasattr(inspect.unwrap(test), _STRICT)


def needs(what: str) -> Callable[[Sentence], Sentence]:
    """Says of a sentence what a player must have sent for it to come to a judgement; without, it is not applicable."""

    def mark(test: Sentence) -> Sentence:
        setattr(test, _NEEDED, what)
        return test

    return mark


def _judging(test: Callable[..., None]) -> Callable[..., None]:
    """A sentence that is not applicable at a level that was not asked for, or if it came to no judgement."""

    @functools.wraps(test)
    def sentence(self: "Conformance") -> None:
        if is_strict(test) and not self.strict:
            raise NotApplicable("strict, and only the protocol was asked for")
        before = Tally.judgements
        test(self)
        if Tally.judgements == before:
            needed = getattr(test, _NEEDED, "message that this is about")
            raise NotApplicable(f"the player sent no {needed}, so nothing was judged")

    return sentence


class Conformance:
    """One topic. A subclass says how its player is started.

    Attributes:
        arguments: More arguments for the player.
        timeout: Seconds to wait for each of its messages.
        port: Where the trainer listens; 0 takes a free port.
        host: Where the trainer listens.
        strict: Hold the player against the strict sentences too.
    """

    arguments: tuple[str, ...] = ()
    timeout: float = 20.0
    port: int = 0
    host: str = "localhost"
    strict: bool = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if cls.__module__.startswith(f"{__package__}."):  # an author's own tests judge as they like
            for name, test in list(vars(cls).items()):
                if name.startswith("test_"):
                    setattr(cls, name, _judging(test))

    def start_player(self, port: int, *arguments: str) -> "subprocess.Popen[bytes] | None":
        """Starts the player so that it dials ``localhost:port``.

        Args:
            port: Where the trainer listens.
            *arguments: More arguments for the player.

        Returns:
            Its process; None for a player that somebody else starts.
        """
        raise NotImplementedError

    @contextmanager
    def connected(self, *arguments: str) -> Iterator[Session]:
        """A player that was started, before its first message is read. It is killed at the end, if it has not ended."""
        with RawTrainer(self.timeout, self.port, self.host) as trainer:
            process = self.start_player(trainer.port, *self.arguments, *arguments)
            try:
                yield Session(trainer, process)
            finally:
                trainer.cut()
                if process is not None and process.poll() is None:
                    process.kill()
                if process is not None:
                    process.wait()

    @contextmanager
    def playing(
        self, *arguments: str, seed: int = 0, num_areas: int = 1, side_channel: bytes = b""
    ) -> Iterator[Session]:
        """A player after handshake and first RESET, whose answer may be a message in which nobody decides yet."""
        with self.connected(*arguments) as session:
            session.trainer.handshake(seed, num_areas)
            session.reset(side_channel)
            yield session
