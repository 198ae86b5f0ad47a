"""An episode as moving pictures, GIF and MP4: the paper's Fig. 4(b) with what the reward sees."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from corridor_server.corridor import observation as layout
from corridor_server.corridor.colours import (
    BACKGROUND,
    FLOOR,
    LEARNER,
    OPPONENT,
    SWITCH_OFF,
    SWITCH_ON,
    TEXT,
    WALL,
    Colour,
)
from corridor_server.corridor.drawing import WALL_THICKNESS
from trainer.activity import doing
from trainer.runs.evaluation import Episode
from trainer.runs.trajectories import Trajectories

Point = tuple[float, float]

WIDTH = 640  # pixels
LINE = 34  # pixels for the line of numbers
FINER = 2  # drawn this much larger, then reduced: smooth edges
BETWEEN = 3  # MP4 frames per decision; a GIF has one
HOLD_SECONDS = 1.5  # on the last frame


def save_animations(trajectories: Trajectories, scene: dict[str, Any], gif: Path, mp4: Path) -> None:
    """Draws the most telling episode of a scene: a success with the closest call, if there is a success.

    Args:
        trajectories: The evaluation.
        scene: Of ``run_scene``.
        gif: File for the GIF, at the corridor's own pace, a frame per decision.
        mp4: File for the MP4, three frames per decision.
    """
    shown = min(scene["episodes"], key=lambda record: (record["outcome"] != "goal", record["closest"]))
    episode = trajectories.episodes[shown["number"]]
    seconds = scene["corridor"]["decision_seconds"]
    hold = round(HOLD_SECONDS / seconds)
    with doing("Drawing the GIF's pictures", len(episode.observations)) as tell:
        frames = list(_counted(_frames(episode, shown, scene["corridor"], 1), tell))
    palette = frames[len(frames) // 2].quantize(96)
    # One palette for all frames, and no dithering: what stands still costs nothing.
    still = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in [*frames, *frames[-1:] * hold]]
    still[0].save(gif, save_all=True, append_images=still[1:], duration=round(1000 * seconds), loop=0, optimize=True)
    with doing("Drawing the MP4's pictures", BETWEEN * len(episode.rewards) + 1) as tell:
        pictures = _counted(_frames(episode, shown, scene["corridor"], BETWEEN), tell)
        video = [np.asarray(frame) for frame in pictures]
    video += video[-1:] * (hold * BETWEEN)
    imageio.imwrite(mp4, np.stack(video), plugin="FFMPEG", fps=BETWEEN / seconds, quality=7, macro_block_size=2)


def _counted(frames: Iterator[Image.Image], tell: Callable[[int], None]) -> Iterator[Image.Image]:
    for number, frame in enumerate(frames, 1):
        tell(number)
        yield frame


class _Canvas:
    """Pillow, in metres: x to the right, z upwards."""

    def __init__(self, corridor: dict[str, Any]) -> None:
        self._half = corridor["half_length"] + 2 * WALL_THICKNESS, corridor["half_width"] + 2 * WALL_THICKNESS
        self.scale = FINER * WIDTH / (2 * self._half[0])
        self.size = FINER * WIDTH, 2 * round(self.scale * self._half[1] / FINER) * FINER + FINER * LINE
        self.image = Image.new("RGB", self.size, BACKGROUND)

    def copy(self) -> "_Canvas":
        other = object.__new__(_Canvas)
        other._half, other.scale, other.size = self._half, self.scale, self.size
        other.image = self.image.copy()
        return other

    def _to_pixels(self, point: Point) -> Point:
        return (point[0] + self._half[0]) * self.scale, (self._half[1] - point[1]) * self.scale

    def box(self, centre: Point, half_x: float, half_z: float, colour: Colour, opacity: float = 1.0) -> None:
        left, top = self._to_pixels((centre[0] - half_x, centre[1] + half_z))
        right, bottom = self._to_pixels((centre[0] + half_x, centre[1] - half_z))
        shape = Image.new("L", (round(right - left), round(bottom - top)), round(255 * opacity))
        self.image.paste(colour, (round(left), round(top)), shape)

    def disc(self, centre: Point, radius: float, colour: Colour, opacity: float = 1.0, rim: float = 0.0) -> None:
        x, y = self._to_pixels(centre)
        r = radius * self.scale
        if opacity:
            shape = Image.new("L", (round(2 * r) + 1,) * 2, 0)
            ImageDraw.Draw(shape).ellipse((0, 0, 2 * r, 2 * r), fill=round(255 * opacity))
            self.image.paste(colour, (round(x - r), round(y - r)), shape)
        if rim:
            around = (x - r, y - r, x + r, y + r)
            ImageDraw.Draw(self.image).ellipse(around, outline=colour, width=round(rim * FINER))

    def path(self, points: list[Point], colour: Colour) -> None:
        if len(points) > 1:
            pixels = [self._to_pixels(point) for point in points]
            ImageDraw.Draw(self.image).line(pixels, fill=colour, width=2 * FINER, joint="curve")

    def text(self, text: str) -> None:
        font = ImageFont.load_default(15 * FINER)
        middle = self.size[1] - FINER * LINE / 2 - FINER * 3
        ImageDraw.Draw(self.image).text((14 * FINER, middle), text, fill=TEXT, font=font, anchor="lm")


def _frames(episode: Episode, record: dict[str, Any], corridor: dict[str, Any], between: int) -> Iterator[Image.Image]:
    """Pictures of an episode, ``between`` of them for each decision; positions between two states are interpolated."""
    seen = episode.observations.astype(np.float64)
    scale = corridor["half_length"]
    opponents = layout.opponent_blocks(seen)[..., layout.OPPONENT_POSITION].swapaxes(0, 1)
    agents = [seen[:, layout.POSITION] * scale, *(opponents * scale)]
    floor = _background(record, corridor)
    total = 0.0
    for row in range(len(seen)):
        total += float(episode.rewards[row - 1]) if row else 0.0
        for part in range(between if row + 1 < len(seen) else 1):
            canvas = floor.copy()
            paths = [_until(path, row, part / between) for path in agents]
            _draw(canvas, seen[row], paths, corridor)
            seconds = (row + part / between) * corridor["decision_seconds"]
            canvas.text(_line(seconds, episode, row, total, record["outcome"]))
            yield canvas.image.reduce(FINER)


def _background(record: dict[str, Any], corridor: dict[str, Any]) -> _Canvas:
    canvas = _Canvas(corridor)
    length, width = corridor["half_length"], corridor["half_width"]
    canvas.box((0.0, 0.0), length + WALL_THICKNESS, width + WALL_THICKNESS, WALL)
    canvas.box((0.0, 0.0), length, width, FLOOR)
    for target in record["opponent_targets"] or []:
        canvas.box(target, corridor["opponent_radius"], corridor["opponent_radius"], OPPONENT, 0.45)
    canvas.box(record["goal"], corridor["agent_radius"], corridor["agent_radius"], LEARNER, 0.45)
    canvas.disc(record["goal"], corridor["goal_radius"], LEARNER, 0.0, rim=1.5)
    return canvas


def _draw(canvas: _Canvas, state: NDArray[np.float64], paths: list[list[Point]], corridor: dict[str, Any]) -> None:
    if corridor["switch"]:
        place, on = corridor["switch"], state[layout.SWITCH] > 0.5
        canvas.disc((place["x"], place["z"]), place["radius"], SWITCH_ON if on else SWITCH_OFF, 0.9 if on else 0.6)
        canvas.disc((place["x"], place["z"]), place["radius"], SWITCH_ON, 0.0, rim=2)
    near = corridor["near_distance"] * corridor["half_length"]
    for path, opponent in zip(paths[1:], layout.opponent_blocks(state), strict=True):
        inside = opponent[layout.OPPONENT_DISTANCE] < corridor["near_distance"]
        canvas.disc(path[-1], near, OPPONENT, 0.3 if inside else 0.1)
        canvas.path(path, OPPONENT)
        canvas.disc(path[-1], corridor["opponent_radius"], OPPONENT)
    canvas.path(paths[0], LEARNER)
    canvas.disc(paths[0][-1], corridor["agent_radius"], LEARNER)


def _until(path: NDArray[np.float64], row: int, part: float) -> list[Point]:
    """The path's points up to a row, and the one that lies ``part`` of the way to the next."""
    end = path[row] + part * (path[min(row + 1, len(path) - 1)] - path[row])
    return [(float(x), float(z)) for x, z in [*path[: row + 1], end]]


def _line(seconds: float, episode: Episode, row: int, total: float, outcome: str) -> str:
    state = episode.observations[row]
    nearest = layout.opponent_blocks(state)[:, layout.OPPONENT_DISTANCE].min()
    switch = "on" if state[layout.SWITCH] > 0.5 else "off"
    text = f"{seconds:5.1f} s     return {total:+.2f}     d_opp {nearest:.2f}     switch {switch}"
    if row == len(episode.rewards):
        end = {"goal": "target reached", "failed": "failed", "truncated": "cut by the step limit", "ended": "ended"}
        text += f"     {end[outcome]}"
    return text
