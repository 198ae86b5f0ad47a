"""How long a peer is waited for."""

import time

# An agent that asks every twentieth fixed step, and waits for another to end first, has asked by then.
MESSAGES_WITHOUT_DECISION = 1000
LOOK_SECONDS = 0.2
LAST_LOOK_SECONDS = 0.5
PAUSE_SECONDS = 1.0  # a look that takes longer was not one: this process did not run


class Patience:
    """The time that a peer has, used up in looks at whether it has answered.

    Only time in which an answer would have been heard counts. A process that was paused (SIGSTOP, a machine that slept)
    heard nothing, so it looks once more before it gives up.

    Args:
        seconds: That the peer has.
    """

    def __init__(self, seconds: float) -> None:
        self._left = seconds
        self._paused = False
        self._looked = time.monotonic()

    def look(self) -> float:
        """How many seconds the next look may take."""
        return LAST_LOOK_SECONDS if self._paused else min(LOOK_SECONDS, max(self._left, 0.0))

    def is_over(self) -> bool:
        """Whether the time is used up; to be asked after every look."""
        now = time.monotonic()
        took, self._looked = now - self._looked, now
        self._left -= min(took, PAUSE_SECONDS)
        self._paused = took > PAUSE_SECONDS
        return self._left <= 0.0 and not self._paused
