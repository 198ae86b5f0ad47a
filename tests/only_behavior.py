"""A simulation that has the corridor's behavior alone: its agents without the behavior's name around them."""

from collections.abc import Mapping

import numpy as np

from corridor_server.corridor.areas import Areas
from corridor_server.protocol.agents import ActionBatch, Agents

BEHAVIOR = "Corridor?team=0"


def only(moment: Mapping[str, Agents]) -> Agents:
    """The agents of a moment in which no other behavior may be."""
    assert list(moment) == [BEHAVIOR]
    return moment[BEHAVIOR]


def acting(actions: np.ndarray) -> dict[str, ActionBatch]:
    """What the corridor's agents shall do, (n, 2)."""
    return {BEHAVIOR: ActionBatch(actions, np.empty((len(actions), 0), np.int32))}


def begin(areas: Areas) -> Agents:
    """Resets the areas."""
    return only(areas.reset())


def act(areas: Areas, actions: np.ndarray) -> tuple[Agents, Mapping[str, np.ndarray]]:
    """Steps the areas, with an action each."""
    moment, statistics = areas.step(acting(actions))
    return only(moment), statistics
