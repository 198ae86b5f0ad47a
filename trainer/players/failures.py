"""What goes wrong while a player is in use, and one sentence for each."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mlagents_envs.exception import (
    UnityCommunicationException,
    UnityCommunicatorStoppedException,
    UnityEnvironmentException,
    UnityException,
    UnityTimeOutException,
)

from trainer.errors import TrainerError

TAIL_LINES, TAIL_BYTES = 3, 500

# Of these mlagents-learn says that the player died or hangs.
FAILURES = (
    UnityCommunicationException,
    UnityCommunicatorStoppedException,
    UnityEnvironmentException,
    UnityTimeOutException,
)


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


@dataclass
class PlayerLogs:
    """Where launched players log.

    Attributes:
        folder: The logs' folder, which may be moved while they are written.
        stay: Whether they stay there, so that a message can refer to them.
    """

    folder: Path
    stay: bool = True

    def of(self, number: int) -> Path:
        """A player's log."""
        return self.folder / f"Player-{number}.log"

    def hint(self, log: Path) -> str:
        """Further sentences: where a log is, if it stays, and its last lines if it does not, or if it ends in an error.

        Nothing if there is none.
        """
        said = last_lines(log)
        if not self.stay:
            return said
        where = f" The player's log is {log}." if log.exists() else ""
        return where + (said if " ERROR " in said else "")


def last_lines(log: Path) -> str:
    """A further sentence with a log's last lines; nothing if there are none."""
    try:
        text = log.read_bytes()[-TAIL_BYTES:].decode(errors="replace")
    except OSError:
        return ""
    lines = [" ".join(line.split()) for line in text.splitlines() if line.strip()]
    return f" The player's log ends: {' | '.join(lines[-TAIL_LINES:])}" if lines else ""


@contextmanager
def player_errors(logs: PlayerLogs, number: int) -> Iterator[None]:
    """Turns what ``mlagents_envs`` raises while a player is in use into one sentence (``TrainerError``)."""
    try:
        yield
    except (UnityException, BadNumbers) as error:
        raise TrainerError(explain(error) + logs.hint(logs.of(number))) from error


def explain(error: UnityException | RuntimeError) -> str:
    """One sentence for what ``mlagents_envs`` raises while a player is in use."""
    match error:
        case UnityCommunicatorStoppedException():
            return "The player stopped in the middle of the run."
        case UnityTimeOutException():
            return f"{sentence(error)} The player hangs or is too slow."
        case _:
            return sentence(error)


def sentence(error: Exception) -> str:
    """An exception's text as one sentence."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if text.endswith((".", "!", "?")) else f"{text}."
