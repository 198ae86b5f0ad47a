"""The rows of ``corridor bench --peers``: printed one by one, and drawn."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from trainer.corridor import LEARNER_COLOUR, OPPONENT_COLOUR
from trainer.files import whole_file
from trainer.terminal import Terminal

NAME_WIDTH = 34
COUNTS = ("1", "2")  # of cores, as rows have them


def print_heading(console: Terminal) -> None:
    """Prints what the rows' columns are."""
    console.print(
        "PPO on the corridor, agent steps per second (in brackets: of those of this trainer in process, measured in "
        "turn), on one core and on two; cores that were busy; peak memory; and disk, with all that it needs."
    )
    columns = "".join(f"{f'{count} core' + 's' * (count == '2'):>18}{'busy':>6}{'MB':>7}" for count in COUNTS)
    console.print(f"{'':{NAME_WIDTH}}{columns}{'disk, MB':>10}")


def print_peer(row: dict[str, Any], console: Terminal) -> None:
    """Prints a row."""
    if "problem" in row:
        console.print(f"{row['name']:{NAME_WIDTH}}  -  {row['problem']}")
        return
    cells = ""
    for count in COUNTS:
        found = row["cores"].get(count)
        if found is None:
            cells += f"{'-':>18}{'-':>6}{'-':>7}"
        else:
            rate = f"{found['steps_per_second']:,.0f} ({found['to_ours']:.2f})"
            cells += f"{rate:>18}{found['cores_used']:>6.2f}{found['peak_mb']:>7,.0f}"
    size = "-" if row["install_mb"] is None else f"{row['install_mb']:,}"
    console.print(f"{row['name']:{NAME_WIDTH}}{cells}{size:>10}")


def plot_peers(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draws the rates of all that were measured, on one core and on two, to a PNG file."""
    measured = [row for row in rows if "cores" in row][::-1]
    figure = Figure(figsize=(7.0, 0.6 + 0.5 * len(measured)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for shift, count, colour in ((0.2, "1", OPPONENT_COLOUR), (-0.2, "2", LEARNER_COLOUR)):
        found = [(place + shift, row["cores"][count]) for place, row in enumerate(measured) if count in row["cores"]]
        rates = [cell["steps_per_second"] for _, cell in found]
        label = f"on {'one core' if count == '1' else 'two cores'}"
        axes.barh([place for place, _ in found], rates, height=0.4, color=colour, label=label)
    axes.set_yticks(range(len(measured)), [row["name"] for row in measured])
    axes.set(xlabel="agent steps per second")
    axes.grid(axis="x", alpha=0.25)
    axes.legend(frameon=False)
    with whole_file(path) as file:
        figure.savefig(file, dpi=110)
