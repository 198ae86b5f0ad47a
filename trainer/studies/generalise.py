"""``corridor study generalise``: trained policies, without further training, on corridors that they never saw.

The changes reach the player as environment parameters; the number of opponents, which a connection can't change, by its
configuration file. A policy's observation holds one opponent, so with more it is shown the nearest: the one that eq. 9
counts.
"""

import csv
import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.table import Table
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from corridor_server.corridor import observation as layout
from trainer.activity import doing
from trainer.config import ConnectionOptions, RunConfig
from trainer.corridor import corridor_of
from trainer.drafts import Draft, written
from trainer.errors import TrainerError
from trainer.learning.stages import build_stages
from trainer.players.failures import PlayerLogs
from trainer.players.location import BUILTIN, can_be_launched
from trainer.players.opening import open_slots
from trainer.runs.evaluation import evaluate, summarise
from trainer.runs.folder import RunFolder
from trainer.runs.training import load_trained
from trainer.seeds import evaluation_seed
from trainer.signals import temporary_folder
from trainer.studies.bootstrap import Estimate, interval
from trainer.studies.claims import BOOTSTRAP_SEED
from trainer.studies.executors import free_port
from trainer.studies.plots import new_figure, save
from trainer.terminal import Terminal

AREAS = 64
SPEEDS = (0.5, 0.75, 1.0, 1.5, 2.0)
WIDTHS = (1.0, 0.8, 0.6)
SHIFTS = (-4.0, -2.0, 0.0, 2.0, 4.0)
SIDES = (1.0, 0.0, -1.0)
OPPONENTS = (1, 2, 3)
SPAWN = "agent_spawn_x"  # a range, whose two ends are parameters
MEASURES = ("success_rate", "opponent_contact_rate", "wall_contact_rate", "mean_return", "mean_episode_length")


@dataclass(frozen=True)
class Change:
    """How a corridor differs from the one that the policy was trained on.

    Attributes:
        row: Its row's label in a heat map.
        column: Its column's.
        parameters: Environment parameters.
        opponents: How many; None for as many as in training.
    """

    row: str
    column: str
    parameters: dict[str, float] = field(default_factory=dict)
    opponents: int | None = None


@dataclass(frozen=True)
class Panel:
    """A heat map: changes in rows and columns.

    Attributes:
        title: What changes.
        rows: What a row is.
        columns: What a column is.
        changes: Row by row.
    """

    title: str
    rows: str
    columns: str
    changes: list[list[Change]]


class NearestOpponent(VecEnvWrapper):
    """Shows the learner's own part of eq. 10 and the nearest opponent's, whatever the number of opponents.

    Args:
        venv: Environments with observations of 8 + 5K floats.

    Raises:
        TrainerError: Its observations have another form.
    """

    def __init__(self, venv: VecEnv) -> None:
        shape = venv.observation_space.shape or ()
        if len(shape) != 1 or not layout.is_size(shape[0]):
            raise TrainerError(f"corridor study generalise is for the corridor, not for observations of shape {shape}.")
        low, high = -np.inf, np.inf
        super().__init__(venv, observation_space=spaces.Box(low, high, (layout.size(1),), np.float32))

    def reset(self) -> VecEnvObs:
        """Begins an episode in every slot."""
        return nearest(np.asarray(self.venv.reset()))

    def step_wait(self) -> VecEnvStepReturn:
        """Also of the last observations of episodes that ended."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for slot in np.flatnonzero(dones):
            infos[slot]["terminal_observation"] = nearest(infos[slot]["terminal_observation"][None])[0]
        return nearest(np.asarray(observations)), rewards, dones, infos


def nearest(observations: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, 13) of (n, 8 + 5K): the learner's own floats, and those of the opponent whose distance is smallest."""
    opponents = layout.opponent_blocks(observations)
    chosen = opponents[np.arange(len(observations)), opponents[:, :, layout.OPPONENT_DISTANCE].argmin(axis=1)]
    return np.concatenate((observations[:, : layout.OWN_SIZE], chosen), axis=1)


def panels(config: RunConfig) -> list[Panel]:
    """What is tried with a run's policy; numbers relative to the corridor that it was trained on."""
    known = dataclasses.asdict(corridor_of(config.penalty, config.environment_parameters))
    known[f"{SPAWN}_min"], known[f"{SPAWN}_max"] = known.pop(SPAWN)

    def scaled(factor: float, *names: str) -> dict[str, float]:
        return {name: known[name] * factor for name in names}

    def moved(metres: float, *names: str) -> dict[str, float]:
        return {name: known[name] + metres for name in names}

    across = ("half_width", "spawn_z", "goal_z", "opponent_target_z", "switch_z")
    start = (f"{SPAWN}_min", f"{SPAWN}_max")
    found = [
        Panel(
            "Opponent's speed, corridor's width",
            "width",
            "opponent's speed",
            [
                [
                    Change(f"x{width:g}", f"x{speed:g}", scaled(width, *across) | scaled(speed, "opponent_speed"))
                    for speed in SPEEDS
                ]
                for width in WIDTHS
            ],
        ),
        Panel(
            "Place of the switch",
            "switch across (z)",
            "switch along (x), m",
            [
                [
                    Change(f"x{side:g}", f"{shift:+g}", moved(shift, "switch_x") | scaled(side, "switch_z"))
                    for shift in SHIFTS
                ]
                for side in SIDES
            ],
        ),
        Panel(
            "Start of the learner",
            "",
            "start along (x), m",
            [[Change("", f"{shift:+g}", moved(shift, *start)) for shift in SHIFTS]],
        ),
    ]
    if config.env == BUILTIN:
        found.append(
            Panel(
                "Number of opponents",
                "opponents",
                "opponents' speed",
                [
                    [Change(f"{count}", f"x{speed:g}", scaled(speed, "opponent_speed"), count) for speed in SPEEDS]
                    for count in OPPONENTS
                ],
            )
        )
    return found


def play(folder: RunFolder, config: RunConfig, change: Change, episodes: int, timeout_wait: int) -> dict[str, Any]:
    """Evaluates a run's policy in a changed corridor; the ``evaluation`` of ``summary.json``.

    Raises:
        TrainerError: There is no checkpoint, or the player failed.
    """
    parameters = {**config.environment_parameters, **change.parameters}
    changed = dataclasses.replace(config, environment_parameters=parameters, num_envs=1)
    if config.env == BUILTIN:
        changed = dataclasses.replace(changed, through_gym=False, num_areas=min(AREAS, episodes))
    with temporary_folder() as temporary:
        if change.opponents is not None:
            file = temporary / "corridor.json"
            file.write_text(json.dumps({"num_opponents": change.opponents}), encoding="utf-8")
            changed = dataclasses.replace(changed, env_args=[*config.env_args, "--config", str(file)])
        connection = ConnectionOptions(timeout_wait=timeout_wait)
        if can_be_launched(config.env):  # else it has a port of its own
            connection = dataclasses.replace(connection, base_port=free_port())
        logs = PlayerLogs(temporary, stay=False)
        with open_slots(changed, logs, connection, seed=evaluation_seed(config.seed)) as players:
            shown = NearestOpponent(players)
            stages = build_stages(changed, shown)
            load_trained(config, folder, stages)
            return summarise(evaluate(stages.model, stages.normaliser, shown, episodes))


@dataclass(frozen=True)
class Cell:
    """What all runs made of one change.

    Attributes:
        panel: The panel's title.
        change: The change.
        evaluations: One per run.
    """

    panel: str
    change: Change
    evaluations: list[dict[str, Any]]

    def estimate(self, measure: str) -> Estimate:
        """Over the runs."""
        values = [evaluation[measure] for evaluation in self.evaluations]
        return interval(values, np.random.default_rng(BOOTSTRAP_SEED))


def run_generalise(
    folders: Sequence[RunFolder],
    draft: Draft,
    target: Path,
    *,
    episodes: int,
    timeout_wait: int,
    command: str,
    console: Terminal,
) -> None:
    """Evaluates every run in every changed corridor, and writes ``report.md``, ``cells.csv`` and ``generalise.png``.

    Args:
        folders: The runs'.
        draft: Of the target.
        target: Where the files go.
        episodes: To play in each corridor.
        timeout_wait: Seconds to wait for a player.
        command: As typed, for the report.
        console: To show progress and the report.

    Raises:
        TrainerError: A run has no checkpoint or another observation.
    """
    configs = [folder.read_config() for folder in folders]
    tried = [panels(config) for config in configs]
    shown = [panel for panel in tried[0] if all(panel.title in [each.title for each in others] for others in tried)]
    cells: list[list[list[Cell]]] = []
    played, total = 0, len(folders) * sum(len(row) for panel in shown for row in panel.changes)
    with doing("Playing in changed corridors", total) as tell:
        for index, panel in enumerate(shown):
            cells.append([])
            for i, row in enumerate(panel.changes):
                cells[-1].append([])
                for j, change in enumerate(row):
                    evaluations = []
                    for folder, config, own in zip(folders, configs, tried, strict=True):
                        own_change = own[index].changes[i][j]
                        evaluations.append(play(folder, config, own_change, episodes, timeout_wait))
                        tell(played := played + 1)
                    cells[-1][-1].append(Cell(panel.title, change, evaluations))

    report = _report(shown, cells, [config.run_id for config in configs], episodes, command)
    with written(target):
        save(heat_maps(shown, cells), draft.path / "generalise.png")
        _write_cells(cells, draft.path / "cells.csv")
        (draft.path / "report.md").write_text(report, encoding="utf-8")
    draft.publish()
    _show(shown, cells, console)
    console.print(f"Report: {target / 'report.md'}")


def _show(shown: Sequence[Panel], cells: Sequence[Sequence[Sequence[Cell]]], console: Terminal) -> None:
    console.print("Shares of episodes: success, below it opponent contact, below that wall contact.")
    for panel, grid in zip(shown, cells, strict=True):
        table = Table(_corner(panel), *(cell.change.column for cell in grid[0]), title=panel.title, show_lines=True)
        for row in grid:
            table.add_row(row[0].change.row, *("\n".join(_shares(cell)) for cell in row))
        console.print(table, soft_wrap=False)


def heat_maps(shown: Sequence[Panel], cells: Sequence[Sequence[Sequence[Cell]]]) -> Figure:
    """Success above, opponent contact below; a column of maps for each panel."""
    figure = new_figure(4.1 * len(shown), 5.6)
    for index, (panel, grid) in enumerate(zip(shown, cells, strict=True)):
        for line, (measure, title, colours) in enumerate(
            (("success_rate", "success", "viridis"), ("opponent_contact_rate", "opponent contact", "magma_r"))
        ):
            axes = figure.add_subplot(2, len(shown), line * len(shown) + index + 1)
            _heat_map(axes, panel, grid, measure, colours)
            axes.set_title(f"{panel.title}\n{title}" if line == 0 else title, fontsize=10)
    return figure


def _heat_map(axes: Axes, panel: Panel, grid: Sequence[Sequence[Cell]], measure: str, colours: str) -> None:
    values = np.array([[cell.estimate(measure).value for cell in row] for row in grid])
    axes.imshow(values, vmin=0.0, vmax=1.0, cmap=colours, aspect="auto")
    dark = values < 0.55 if colours == "viridis" else values > 0.45
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            axes.text(j, i, f"{value:.2f}", ha="center", va="center", color="white" if dark[i, j] else "black")
    axes.set_xticks(range(len(grid[0])), [cell.change.column for cell in grid[0]])
    axes.set_yticks(range(len(grid)), [row[0].change.row for row in grid])
    axes.set_xlabel(panel.columns)
    axes.set_ylabel(panel.rows)


def _write_cells(cells: Sequence[Sequence[Sequence[Cell]]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["panel", "row", "column", "opponents", "parameters", "run", *MEASURES])
        for cell in (cell for grid in cells for row in grid for cell in row):
            change = cell.change
            fixed = [cell.panel, change.row, change.column, change.opponents or "", json.dumps(change.parameters)]
            for run, evaluation in enumerate(cell.evaluations):
                writer.writerow([*fixed, run, *(evaluation[measure] for measure in MEASURES)])


def _report(
    shown: Sequence[Panel],
    cells: Sequence[Sequence[Sequence[Cell]]],
    run_ids: Sequence[str],
    episodes: int,
    command: str,
) -> str:
    lines = [
        "# What the policy does in corridors that it never saw",
        "",
        f"`{command}`",
        "",
        f"Policies of {', '.join(run_ids)}, without further training; mean action, {episodes} episodes per cell",
        "and run. Numbers are relative to the corridor of training; x1 and +0 are that corridor. In a narrower one the",
        "ranges of start, target and switch across shrink with it. The switch's place is not in the observation, so a",
        "policy can only know where it was. With several opponents the policy, whose observation holds one, is shown",
        "the nearest.",
        "",
        "![Success and contact](generalise.png)",
        "",
    ]
    for panel, grid in zip(shown, cells, strict=True):
        head = [_corner(panel), *(cell.change.column for cell in grid[0])]
        lines += [f"## {panel.title}", "", "Success / opponent contact / wall contact, shares of episodes.", ""]
        lines += [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
        for row in grid:
            numbers = [" / ".join(_shares(cell)) for cell in row]
            lines.append(f"| {' | '.join([row[0].change.row, *numbers])} |")
        lines.append("")
    return "\n".join(lines)


def _corner(panel: Panel) -> str:
    return f"{panel.rows} \\ {panel.columns}" if panel.rows else panel.columns


def _shares(cell: Cell) -> list[str]:
    """Success, opponent contact and wall contact."""
    return [f"{cell.estimate(measure).value:.2f}" for measure in MEASURES[:3]]
