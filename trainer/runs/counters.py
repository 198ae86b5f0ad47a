"""What a run has done so far."""

from dataclasses import dataclass


@dataclass
class Counters:
    """What a run has done so far, resumed parts included.

    Attributes:
        env_steps: Agent steps.
        episodes: Ended episodes.
        wall_seconds: Time spent learning.
        exchange_seconds: Of it, time spent exchanging messages with the players.
        steps_to_50_success: Agent steps at which half of the last 100 episodes had succeeded, or None.
        steps_to_90_success: The same for nine tenths.
        restarts: How often a player was started again because it had died or hung.
        resumes: How often the run was resumed.
    """

    env_steps: int = 0
    episodes: int = 0
    wall_seconds: float = 0.0
    exchange_seconds: float = 0.0
    steps_to_50_success: int | None = None
    steps_to_90_success: int | None = None
    restarts: int = 0
    resumes: int = 0
