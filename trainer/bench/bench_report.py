"""The report of ``corridor bench`` as tables and as a plot."""

from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.table import Table

from trainer.bench.exchange_rates import OTHERS
from trainer.corridor import LEARNER_COLOUR, OPPONENT_COLOUR, WALL_COLOUR
from trainer.files import whole_file
from trainer.terminal import Terminal


def print_report(report: dict[str, Any], console: Terminal) -> None:
    """Prints everything that was measured."""
    table = Table("areas", "ours", "0.28.0", "official", "limit", "echo", box=None)
    for row in report["exchange"]:
        clients = [f"{row[name]:,.0f} ({row['ours'] / row[name]:.1f})" if row[name] else "-" for name in OTHERS]
        part = row["ours"] / row["areas"] / row["echo"]
        table.add_row(f"{row['areas']:,}", f"{row['ours']:,.0f}", *clients, f"{row['echo']:,.0f} ({part:.0%})")
    console.print(
        "Exchange, agent steps per second (in brackets: how many times as fast ours is). limit: the player against a "
        "trainer that answers at once, unread. echo: bare round trips per second with as many bytes (ours: exchanges)."
    )
    console.print(table, soft_wrap=False)
    for row in report["world"]:
        console.print(f"world in process, {row['areas']:>5,} areas: {row['steps_per_second']:>12,.0f} steps/s")
    for row in report["train"]:
        console.print(
            f"training, preset {row['preset']}, c = {row['c']:g}: {row['steps_per_second']:,.0f} steps/s, "
            f"{row['exchange_share']:.0%} of the time in the exchange"
        )
    limit = report["limit"]
    console.print(
        f"An update of the default preset takes {1e3 * limit['update_seconds']:.1f} ms; networks, "
        f"{limit['networks_to_products']:.1f} times their matrix products."
    )
    for name, seconds in limit["parts"].items():
        console.print(f"  {1e3 * seconds:6.2f} ms {seconds / limit['update_seconds']:4.0%}  {name}")
    for row in report["players"]:
        console.print(
            f"training, {row['num_envs']} x {row['num_areas']} areas: {row['steps_per_second']:,.0f} steps/s; "
            f"limit {row['limit']:,.0f}"
        )
    for name, seconds in report["startup_seconds"].items():
        console.print(f"{name} starts in {seconds:.2f} s")
    for name, memory in report["memory_mb"].items():
        console.print(f"after {name} agent steps: player {memory['player']} MB, trainer {memory['trainer']} MB")


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
