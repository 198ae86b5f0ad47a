"""Draws threshold.png of threshold.csv: ``python docs/threshold.py``."""

import csv
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DOCS = Path(__file__).parent
GAMMA, ROUND = 0.96, 40  # the preset's, and how many decisions the safe way has
ENDINGS = ((30, 0.25), (20, 0.0))  # decisions, and chance of success: past the opponent, and into a wall ten times
KINDS = ((1, "with the -1", "#1f5fbf"), (0, "without it", "#d1352b"))


def threshold(decisions: int, success: float, penalty: float) -> float:
    """From which c x r_i at an episode's end on this ending is worth more than the way round."""
    ratio = GAMMA ** (ROUND - decisions)
    return (ratio + 1 + penalty - (2 + penalty) * success) / (1 - ratio)


def main() -> None:
    """Success of every run against c x r_i at its episodes' ends, and the predicted thresholds."""
    rows = list(csv.DictReader((DOCS / "threshold.csv").open()))
    figure = Figure(figsize=(7.2, 4.0))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for penalty, label, colour in KINDS:
        ends = [threshold(decisions, success, penalty) for decisions, success in ENDINGS]
        axes.axvspan(min(ends), max(ends), color=colour, alpha=0.15, linewidth=0, label=f"predicted, {label}")
        kind = [row for row in rows if float(row["penalty"]) == penalty]
        paid = [float(row["c"]) * float(row["r_i at ends"]) for row in kind]
        filled = colour if penalty else "none"
        succeeded = [float(row["success"]) for row in kind]
        axes.scatter(paid, succeeded, s=26, facecolors=filled, edgecolors=colour, label=f"runs {label}")
    axes.set(xlabel="c x r_i at an episode's end, when training ended", ylabel="success", ylim=(-0.03, 1.05))
    axes.set_xlim(left=0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower left", frameon=False)
    figure.savefig(DOCS / "threshold.png", dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main()
