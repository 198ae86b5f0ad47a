"""What a player reports of each ended episode over the statistics channel, by the corridor's contract."""

from typing import Any

SUCCESS = "Corridor/Success"
OPPONENT_CONTACTS = "Corridor/Opponent Contacts"
WALL_CONTACTS = "Corridor/Wall Contacts"


def episode_info(statistics: dict[str, float]) -> dict[str, Any]:
    """An ended episode's part of a Stable-Baselines3 info; ``is_success`` only if the player reports success."""
    if not statistics:
        return {}
    info: dict[str, Any] = {"statistics": statistics}
    if SUCCESS in statistics:
        info["is_success"] = statistics[SUCCESS] > 0.5
    return info
