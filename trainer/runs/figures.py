"""Pictures of a run, as files: its learning curve, and one evaluated episode's paths (Fig. 4(b))."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from corridor_server.corridor import observation as layout
from corridor_server.corridor.corridor_config import CorridorConfig
from trainer.corridor import LEARNER_COLOUR, OPPONENT_COLOUR, SWITCH_COLOUR, WALL_COLOUR
from trainer.files import whole_file
from trainer.runs.evaluation import Episode


def save_learning_curve(rows: Sequence[dict[str, float | None]], title: str, path: Path) -> None:
    """Draws return, success rate, episode length and intrinsic reward against agent steps.

    Args:
        rows: ``progress.csv``.
        title: What run it is.
        path: The PNG file.
    """
    panels = [
        ("mean_return", "return", LEARNER_COLOUR),
        ("success_rate", "success rate", SWITCH_COLOUR),
        ("mean_episode_length", "episode length (decisions)", WALL_COLOUR),
        ("intrinsic_reward", "intrinsic reward per step", OPPONENT_COLOUR),
    ]
    figure = _figure(9.0, 5.4)
    long = max((row["env_steps"] or 0.0 for row in rows), default=0.0) >= 1e6
    unit, units = (1e6, "millions") if long else (1e3, "thousands")
    for index, (column, label, colour) in enumerate(panels):
        axes = figure.add_subplot(2, 2, index + 1)
        points = [(row["env_steps"], row[column]) for row in rows if row[column] is not None]
        if points:
            steps, values = np.array(points, dtype=float).T
            axes.plot(steps / unit, values, color=colour, linewidth=1.4)
        else:
            axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color=WALL_COLOUR)
        if column == "success_rate":
            axes.set_ylim(-0.03, 1.03)
        axes.set_ylabel(label)
        axes.set_xlabel(f"agent steps ({units})")
        _tidy(axes)
    figure.suptitle(title)
    figure.subplots_adjust(top=0.92, hspace=0.32, wspace=0.36)
    _save(figure, path)


def save_episode_paths(episode: Episode, title: str, path: Path, corridor: CorridorConfig | None = None) -> None:
    """Draws learner's and opponents' paths from above; marks lie a second apart.

    Args:
        episode: Of the corridor: its observations are eq. 10's.
        title: What run it is.
        path: The PNG file.
        corridor: Geometry of the player, which the observation does not hold; the defaults if not given.
    """
    config = corridor or CorridorConfig()
    seen = episode.observations.astype(float)
    figure = _figure(9.0, 5.2)
    axes = figure.add_subplot()
    length, width = config.half_length, config.half_width
    axes.add_patch(Rectangle((-length, -width), 2 * length, 2 * width, fill=False, edgecolor=WALL_COLOUR, linewidth=2))
    axes.add_patch(_disc((config.switch_x, config.switch_z), config.switch_radius, SWITCH_COLOUR, 0.15))
    axes.annotate("switch", (config.switch_x, config.switch_z), color=SWITCH_COLOUR, ha="center", va="center")
    second = max(round(1.0 / config.decision_seconds), 1)
    opponents = layout.opponent_blocks(seen)[..., layout.OPPONENT_POSITION] * length
    for number in range(opponents.shape[1]):
        label = "opponent" if number == 0 else None
        _path(axes, opponents[:, number], OPPONENT_COLOUR, label, config.opponent_radius, second)
    learner = seen[:, layout.POSITION] * length
    _path(axes, learner, LEARNER_COLOUR, "learner", config.agent_radius, second)
    goal = seen[-1, layout.GOAL] * length
    axes.add_patch(_disc((goal[0], goal[1]), config.goal_radius, LEARNER_COLOUR, 0.2))
    axes.annotate("target", (goal[0], goal[1]), color=LEARNER_COLOUR, ha="center", va="center")
    on = np.flatnonzero(seen[:, layout.SWITCH] > 0.5)
    if len(on):
        axes.plot(
            *learner[on[0]], marker="*", markersize=15, color=SWITCH_COLOUR, label="switch turned on", linestyle="none"
        )
    axes.set_aspect("equal")
    axes.set_xlim(-length - 0.3, length + 0.3)
    axes.set_ylim(-width - 0.3, width + 0.3)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("z (m)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, frameon=False)
    end = {True: "target reached", False: "failed", None: "ended"}[episode.succeeded]
    total = episode.rewards.sum(dtype=np.float64)
    axes.set_title(f"{title}: {end} after {len(episode.rewards)} decisions, return {total:+.2f}")
    _save(figure, path)


def _path(axes: Axes, points: NDArray[np.float64], colour: str, label: str | None, radius: float, every: int) -> None:
    axes.plot(*points.T, color=colour, linewidth=1.6, label=label)
    axes.plot(*points[::every].T, color=colour, marker="o", markersize=3, linestyle="none")
    axes.add_patch(_disc(tuple(points[0]), radius, colour, 0.25))
    axes.add_patch(_disc(tuple(points[-1]), radius, colour, 0.95))


def _disc(centre: tuple[float, ...], radius: float, colour: str, opacity: float) -> Circle:
    return Circle((centre[0], centre[1]), radius, facecolor=colour, edgecolor=colour, alpha=opacity)


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))  # Matplotlib's layout engines would take as long again as all else
    FigureCanvasAgg(figure)
    return figure


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)


def _save(figure: Figure, path: Path) -> None:
    with whole_file(path) as file:
        figure.savefig(file, dpi=110, bbox_inches="tight")
