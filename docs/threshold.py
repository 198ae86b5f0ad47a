"""Draws threshold.png of threshold.csv: ``python docs/threshold.py``."""

import csv
from pathlib import Path
from typing import NamedTuple

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DOCS = Path(__file__).parent
KINDS = ((1, "with the -1", "#1f5fbf"), (0, "without it", "#d1352b"))


class Ending(NamedTuple):
    """A quick end of an episode, beside the safe way to the goal.

    Attributes:
        gamma: The discount factor.
        way: Decisions that the safe way takes.
        decisions: That the quick end takes.
        success: Its chance to be one.
    """

    gamma: float
    way: int
    decisions: int
    success: float = 0.0

    def threshold(self, penalty: float) -> float:
        """From which c x r_i at an episode's end on it is worth more than the safe way."""
        ratio = self.gamma ** (self.way - self.decisions)
        return (ratio + 1 + penalty - (2 + penalty) * self.success) / (1 - ratio)


# By where the goal is: what the panel is called, when r_i was taken, and the quick ends. At 5 m past the opponent or
# into it, and into a wall ten times; at 8 m to the opponent, with the discount factors that the runs had.
PANELS = {
    "5": ("goal at 5 m, gamma 0.96", "when training ended", (Ending(0.96, 40, 30, 0.25), Ending(0.96, 40, 20))),
    "8": ("goal at 8 m, gamma 0.90 to 0.92", "after 300,000 steps", (Ending(0.90, 46, 36), Ending(0.92, 46, 36))),
}


def main() -> None:
    """Success of every run against c x r_i at its episodes' ends, and the predicted thresholds."""
    rows = list(csv.DictReader((DOCS / "threshold.csv").open()))
    figure = Figure(figsize=(10.4, 4.0))
    FigureCanvasAgg(figure)
    for axes, (goal, (title, when, endings)) in zip(figure.subplots(1, 2, sharey=True), PANELS.items(), strict=True):
        for penalty, label, colour in KINDS:
            ends = [ending.threshold(penalty) for ending in endings]
            axes.axvspan(min(ends), max(ends), color=colour, alpha=0.15, linewidth=0, label=f"predicted, {label}")
            kind = [row for row in rows if row["goal"] == goal and float(row["penalty"]) == penalty]
            paid = [float(row["c"]) * float(row["r_i at ends"]) for row in kind]
            filled = colour if penalty else "none"
            succeeded = [float(row["success"]) for row in kind]
            axes.scatter(paid, succeeded, s=26, facecolors=filled, edgecolors=colour, label=f"runs {label}")
        axes.set(title=title, xlabel=f"c x r_i at an episode's end, {when}", ylim=(-0.03, 1.05))
        axes.set_xlim(left=0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    figure.axes[0].set_ylabel("success")
    figure.axes[0].legend(loc="lower left", frameon=False)
    figure.tight_layout()
    figure.savefig(DOCS / "threshold.png", dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main()
