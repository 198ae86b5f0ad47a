"""The paper's Fig. 4(b): a top view of one corridor as an RGB picture, drawn with NumPy alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor.arrays import Bools, Floats, Parameters
from corridor_server.corridor.colours import (
    BACKGROUND,
    FLOOR,
    LEARNER,
    OPPONENT,
    SWITCH_OFF,
    SWITCH_ON,
    WALL,
    Colour,
)
from corridor_server.corridor.world import State

WALL_THICKNESS = 0.3  # m


@dataclass(frozen=True)
class _Grid:
    """Pixel centres in metres, and how many metres a pixel covers."""

    x: Floats
    z: Floats
    pixel: float


def top_view(p: Parameters, state: State, area: int, width: int = 480, height: int = 264) -> NDArray[np.uint8]:
    """Draws one area.

    Args:
        p: Parameters, one value per area.
        state: Of all areas.
        area: Which one to draw.
        width: Of the picture, in pixels.
        height: Of the picture, in pixels.

    Returns:
        (height, width, 3) RGB; x runs to the right, z upwards. A ring is an outline of what is reached by touching
        it: the switch, grey until it is on, and both targets, which are squares.
    """
    half_length, half_width = float(p["half_length"][area]), float(p["half_width"][area])
    grid = _grid(half_length + 2 * WALL_THICKNESS, half_width + 2 * WALL_THICKNESS, width, height)
    picture = np.empty((height, width, 3))
    picture[:] = BACKGROUND
    outer = _box(grid, (0.0, 0.0), half_length + WALL_THICKNESS, half_width + WALL_THICKNESS)
    _paint(picture, grid, outer, WALL)
    _paint(picture, grid, _box(grid, (0.0, 0.0), half_length, half_width), FLOOR)

    switch = _disc(grid, (p["switch_x"][area], p["switch_z"][area]), p["switch_radius"][area])
    _paint(picture, grid, switch, SWITCH_ON if state.switch_on[area] else SWITCH_OFF)
    radius, opponent_radius = float(p["agent_radius"][area]), float(p["opponent_radius"][area])
    for target in state.opponent_target[area]:
        _paint(picture, grid, _box(grid, target, opponent_radius, opponent_radius), OPPONENT, 0.45)
    goal = state.goal[area]
    _paint(picture, grid, np.abs(_disc(grid, goal, p["goal_radius"][area])) - grid.pixel, LEARNER)
    _paint(picture, grid, _box(grid, goal, radius, radius), LEARNER, 0.45)
    for opponent in state.opponent_position[area]:
        _paint(picture, grid, _disc(grid, opponent, opponent_radius), OPPONENT)
    _paint(picture, grid, _disc(grid, state.position[area], radius), LEARNER)
    return picture.round().astype(np.uint8)


def _grid(half_x: float, half_z: float, width: int, height: int) -> _Grid:
    pixel = max(2 * half_x / width, 2 * half_z / height)
    x = np.arange(width, dtype=np.float64) + 0.5 - width / 2
    z = height / 2 - np.arange(height, dtype=np.float64) - 0.5
    return _Grid(pixel * x[None, :], pixel * z[:, None], pixel)


def _disc(grid: _Grid, centre: Floats | tuple[float, float], radius: float) -> Floats:
    """Signed distance from a disc's edge, in metres: negative inside."""
    distance: Floats = np.sqrt((grid.x - centre[0]) ** 2 + (grid.z - centre[1]) ** 2) - radius
    return distance


def _box(grid: _Grid, centre: Floats | tuple[float, float], half_x: float, half_z: float) -> Floats:
    distance: Floats = np.maximum(np.abs(grid.x - centre[0]) - half_x, np.abs(grid.z - centre[1]) - half_z)
    return distance


def _paint(picture: Floats, grid: _Grid, distance: Floats, colour: Colour, opacity: float = 1.0) -> None:
    """Blends a colour in where the distance is negative, with an edge one pixel wide."""
    cover = np.clip(0.5 - distance / grid.pixel, 0.0, 1.0)[..., None] * opacity
    touched: Bools = cover[..., 0] > 0
    picture[touched] += cover[touched] * (np.asarray(colour, dtype=float) - picture[touched])
