"""What goes wrong while a player is in use, and one sentence for each."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mlagents_envs.exception import (
    UnityCommunicationException,
    UnityCommunicatorStoppedException,
    UnityEnvironmentException,
    UnityException,
    UnityTimeOutException,
)

from trainer.errors import TrainerError

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


@contextmanager
def player_errors(log: Path | None = None) -> Iterator[None]:
    """Turns what ``mlagents_envs`` raises while a player is in use into one sentence (``TrainerError``)."""
    try:
        yield
    except (UnityException, BadNumbers) as error:
        raise TrainerError(explain(error, log)) from error


def explain(error: UnityException | RuntimeError, log: Path | None = None) -> str:
    """One sentence for what ``mlagents_envs`` raises while a player is in use, and where its log is."""
    match error:
        case UnityCommunicatorStoppedException():
            text = "The player stopped in the middle of the run."
        case UnityTimeOutException():
            text = f"{sentence(error)} The player hangs or is too slow."
        case _:
            text = sentence(error)
    return text + log_hint(log)


def log_path(log_folder: Path, number: int) -> Path:
    """Where a launched player logs."""
    return log_folder / f"Player-{number}.log"


def sentence(error: Exception) -> str:
    """An exception's text as one sentence."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if text.endswith((".", "!", "?")) else f"{text}."


def log_hint(log: Path | None) -> str:
    """A further sentence that says where a log is, if there is one."""
    return f" The player's log is {log}." if log is not None and log.exists() else ""
