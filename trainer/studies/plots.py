"""A study's figures. Each function takes finished runs and returns a figure; ``save`` writes it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from trainer.studies.bootstrap import band, interval
from trainer.studies.plan import DoseFigure
from trainer.studies.results import RunResult, curves, scores

# The paper's two rows: (letter, column of progress.csv, title, unit).
PANELS = (
    ("a", "mean_return", "Reward", "extrinsic return of the last 100 episodes"),
    ("b", "mean_episode_length", "Episode Length", "decisions in the last 100 episodes"),
)


def learning_curves(
    runs: Mapping[str, Sequence[RunResult]],
    colours: Mapping[str, str],
    labels: Mapping[str, str],
    column: str,
    title: str,
    unit: str,
    generator: np.random.Generator,
) -> Figure:
    """One line per arm: the interquartile mean over its runs, in a 95% bootstrap band; each run as a faint line.

    Args:
        runs: By arm name.
        colours: By arm name, in the legend's order.
        labels: By arm name.
        column: Of ``progress.csv``.
        title: What is shown.
        unit: The vertical axis.
        generator: For the bootstrap.
    """
    figure = new_figure(7.0, 3.9)
    axes = figure.add_subplot()
    longest = max((run.config.steps for arm in runs.values() for run in arm), default=1)
    factor, scale = (1e6, "millions") if longest >= 500_000 else (1e3, "thousands")
    for name, colour in colours.items():
        arm = runs.get(name, ())
        steps, values = curves(arm, column)
        if not len(steps):
            continue
        for value in values:
            axes.plot(steps / factor, value, color=colour, linewidth=0.5, alpha=0.25)
        middle, low, high = band(values, generator)
        axes.fill_between(steps / factor, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(steps / factor, middle, color=colour, linewidth=2.0, label=f"{labels[name]} ({len(arm)} runs)")
    axes.set_xlim(0, longest / factor)
    axes.set_title(title)
    axes.set_xlabel(f"agent steps ({scale})")
    axes.set_ylabel(unit)
    tidy(axes)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


def dose_response(runs: Mapping[str, Sequence[RunResult]], spec: DoseFigure, generator: np.random.Generator) -> Figure:
    """Success and episode length of the evaluation against a setting: interquartile means and 95% intervals.

    Args:
        runs: By arm name.
        spec: What to show.
        generator: For the bootstrap.
    """
    figure = new_figure(9.0, 3.9)
    for index, (measure, title) in enumerate((("success_rate", "success"), ("mean_episode_length", "episode length"))):
        axes = figure.add_subplot(1, 2, index + 1)
        for line, (label, points) in enumerate(spec.lines.items()):
            known = [(value, scores(runs[arm.name], measure)) for value, arm in points]
            found = [(value, interval(values, generator)) for value, values in known if len(values)]
            if found:
                at = [value for value, _ in found]
                middles = [estimate.value for _, estimate in found]
                spread = [[each.value - each.low for _, each in found], [each.high - each.value for _, each in found]]
                axes.errorbar(at, middles, spread, marker="o", capsize=3, color=f"C{line}", label=label)
            for value, values in known:
                axes.plot([value] * len(values), values, ".", color=f"C{line}", alpha=0.35)
        values_of_setting = sorted({value for points in spec.lines.values() for value, _ in points})
        axes.set_xticks(values_of_setting, [f"{value:g}" for value in values_of_setting], fontsize="small")
        if measure == "success_rate":
            axes.set_ylim(-0.03, 1.03)
        axes.set_title(title)
        axes.set_xlabel(spec.setting)
        axes.set_ylabel("share of episodes" if index == 0 else "decisions")
        tidy(axes)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, (width, height) in inches, that needs no display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes) -> None:
    """Takes away what says nothing."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)


def save(figure: Figure, path: Path) -> None:
    """Writes a PNG file."""
    figure.savefig(path, dpi=130)
