"""The report of ``corridor bench``: a line for each thing that was measured, and a plot."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from trainer.bench.exchange_rates import OTHERS
from trainer.corridor import LEARNER_COLOUR, OPPONENT_COLOUR, WALL_COLOUR
from trainer.files import whole_file

EXCHANGE_WIDTHS = (6, 11, 15, 15, 17, 15)
EXCHANGE_HEADS = ("areas", "ours", "0.28.0", "official", "limit", "echo")


def exchange_heading() -> str:
    """What stands above the rows of the exchange."""
    explained = (
        "Exchange, agent steps per second (in brackets: how many times as fast ours is). limit: the player against a "
        "trainer that answers at once, unread. echo: bare round trips per second with as many bytes (ours: exchanges)."
    )
    return f"{explained}\n{_row(EXCHANGE_HEADS)}"


def exchange_line(row: Mapping[str, Any]) -> str:
    """A row of the exchange."""
    clients = [f"{row[name]:,.0f} ({row['ours'] / row[name]:.1f})" if row[name] else "-" for name in OTHERS]
    part = row["ours"] / row["areas"] / row["echo"]
    return _row((f"{row['areas']:,}", f"{row['ours']:,.0f}", *clients, f"{row['echo']:,.0f} ({part:.0%})"))


def world_line(row: Mapping[str, Any]) -> str:
    """How fast the world in process is."""
    return f"world in process, {row['areas']:>5,} areas: {row['steps_per_second']:>12,.0f} steps/s"


def train_line(row: Mapping[str, Any]) -> str:
    """How fast training is."""
    return (
        f"training, preset {row['preset']}, c = {row['c']:g}: {row['steps_per_second']:,.0f} steps/s, "
        f"{row['exchange_share']:.0%} of the time in the exchange"
    )


def limit_heading(limit: Mapping[str, Any]) -> str:
    """What stands above the parts of an update's time."""
    return (
        f"an update of the default preset takes {1e3 * limit['update_seconds']:.1f} ms, and its networks "
        f"{limit['networks_to_products']:.1f} times their matrix products:"
    )


def limit_line(limit: Mapping[str, Any], name: str) -> str:
    """A part of an update's time."""
    seconds = limit["parts"][name]
    return f"  {1e3 * seconds:6.2f} ms {seconds / limit['update_seconds']:4.0%}  {name}"


def players_line(row: Mapping[str, Any]) -> str:
    """How fast training on several players is."""
    return (
        f"training, {row['num_envs']} x {row['num_areas']} areas: {row['steps_per_second']:,.0f} steps/s; "
        f"limit {row['limit']:,.0f}"
    )


def startup_line(name: str, seconds: float) -> str:
    """How long a command takes to start."""
    return f"{name} starts in {seconds:.2f} s"


def memory_line(name: str, memory: Mapping[str, float]) -> str:
    """How much memory the two processes have."""
    return f"after {name} agent steps: player {memory['player']} MB, trainer {memory['trainer']} MB"


def _row(cells: Sequence[str]) -> str:
    return "".join(cell.rjust(width) for cell, width in zip(cells, EXCHANGE_WIDTHS, strict=True))


def plot_report(report: dict[str, Any], path: Path) -> None:
    """Draws the rate of each client against the number of areas, to a PNG file."""
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    lines = [("ours", "this trainer"), ("mlagents_envs", "mlagents-envs 0.28.0"), ("official", "mlagents-envs 1.1.0")]
    for (name, label), colour in zip(lines, (LEARNER_COLOUR, OPPONENT_COLOUR, WALL_COLOUR), strict=True):
        points = [(row["areas"], row[name]) for row in report["exchange"] if row[name]]
        if points:
            axes.plot(*zip(*points, strict=True), marker="o", label=label, color=colour)
    world = [(row["areas"], row["steps_per_second"]) for row in report["world"]]
    axes.plot(*zip(*world, strict=True), linestyle=":", color="#3a8f5c", label="the world in process")
    axes.set(xscale="log", yscale="log", xlabel="areas in one player", ylabel="agent steps per second")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    with whole_file(path) as file:
        figure.savefig(file, dpi=110)
