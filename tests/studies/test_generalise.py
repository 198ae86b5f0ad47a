"""``corridor study generalise``: which corridors are tried, what the policy is shown, and the command as a whole."""

import csv
import dataclasses

import numpy as np
import pytest

from corridor_server.corridor.corridor_config import CorridorConfig
from trainer.corridor import CORRIDOR
from trainer.main import main
from trainer.presets import preset_run
from trainer.runs.folder import RunFolder
from trainer.studies import generalise
from trainer.studies.generalise import Change, nearest, panels, play


def config(**parameters):
    return preset_run("any", "fast", c=0.0, seed=0, steps=1, environment_parameters=parameters)


def change(title, row, column, **parameters):
    panel = next(panel for panel in panels(config(**parameters)) if panel.title == title)
    found = [each for line in panel.changes for each in line if (each.row, each.column) == (row, column)]
    assert len(found) == 1
    return found[0].parameters


def test_the_nearest_opponent_is_shown():
    own = np.arange(8, dtype=np.float32)
    far, near = np.float32([1, 2, 0.9, 3, 4]), np.float32([5, 6, 0.3, 7, 8])
    observations = np.array([np.concatenate((own, far, near)), np.concatenate((own, near, far))])
    assert nearest(observations).tolist() == [[*own, *near]] * 2


def test_a_single_opponent_is_shown_as_it_is():
    observations = np.random.default_rng(0).random((4, 13), np.float32)
    assert (nearest(observations) == observations).all()


def test_changes_are_relative_to_the_presets_corridor():
    default = CorridorConfig()
    low, high = CORRIDOR["agent_spawn_x_min"] - 2, CORRIDOR["agent_spawn_x_max"] - 2
    assert change("Start of the learner", "", "-2") == {"agent_spawn_x_min": low, "agent_spawn_x_max": high}
    moved = change("Place of the switch", "x-1", "+4")
    assert moved == {"switch_x": default.switch_x + 4, "switch_z": -default.switch_z}


def test_changes_are_relative_to_the_corridor_of_training():
    narrow = change("Opponent's speed, corridor's width", "x0.6", "x2", opponent_speed=3.0, half_width=4.0)
    assert (narrow["opponent_speed"], narrow["half_width"]) == (6.0, pytest.approx(2.4))
    start = change("Start of the learner", "", "+2", agent_spawn_x=-8.0, agent_spawn_x_max=-7.0)
    assert start == {"agent_spawn_x_min": -6.0, "agent_spawn_x_max": -5.0}


def test_a_narrower_corridor_has_everything_inside():
    default = CorridorConfig()
    narrow = dataclasses.replace(default, **change("Opponent's speed, corridor's width", "x0.6", "x1"))
    for length in (narrow.spawn_z + narrow.agent_radius, narrow.goal_z, narrow.opponent_target_z, narrow.switch_z):
        assert length < narrow.half_width + 0.5 * default.agent_radius


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    results = tmp_path_factory.mktemp("results")
    options = ["--run-id", "mine", "--steps", "1000", "--num-areas", "8", "--eval-episodes", "4"]
    assert main(["train", *options, "--base-port", "7641", "--results-dir", str(results)]) == 0
    return RunFolder.find("mine", results)


def test_an_unchanged_corridor_gives_what_the_evaluation_gave(run):
    """The same seed, episodes and policy; only the number of areas differs, which decides who plays which episode."""
    same = [play(run, run.read_config(), Change("", "", {}, opponents), 4, 30) for opponents in (None, 1)]
    assert same[0] == same[1]


def test_changes_reach_the_player(run):
    """A goal that cannot be missed, and a switch that is on wherever one is."""
    easy = {"goal_radius": 100.0, "switch_radius": 100.0}
    assert play(run, run.read_config(), Change("", "", easy), 4, 30)["success_rate"] == 1.0
    assert play(run, run.read_config(), Change("", "", easy, 3), 4, 30)["mean_episode_length"] == 1.0


@pytest.mark.slow
def test_the_command_leaves_a_report_a_table_and_a_heat_map(run, capsys, monkeypatch):
    for changes, fewer in (("SPEEDS", (1.0, 2.0)), ("WIDTHS", (0.6,)), ("SHIFTS", (0.0,)), ("SIDES", (1.0, -1.0))):
        monkeypatch.setattr(generalise, changes, fewer)
    assert main(["study", "generalise", "mine", "--episodes", "1", "--results-dir", str(run.path.parent)]) == 0
    folder = run.path.parent / "generalise"
    assert (folder / "generalise.png").stat().st_size > 10_000
    with (folder / "cells.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 + 2 + 1 + 6
    assert {row["opponents"] for row in rows} == {"", "1", "2", "3"}
    assert "## Number of opponents" in (folder / "report.md").read_text()
    said = capsys.readouterr().out
    assert "Number of opponents" in said
    assert "┃ opponents" in said  # a table, not the file's source
    assert "| --" not in said
    assert "|---" not in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "Which run's policy?"),
        (["nobody"], "No run 'nobody'"),
        (["nobody", "--episodes", "0"], "--episodes is 0"),
    ],
)
def test_bad_options_are_one_sentence(arguments, sentence, tmp_path, capsys):
    assert main(["study", "generalise", *arguments, "--results-dir", str(tmp_path)]) == 1
    assert sentence in " ".join(capsys.readouterr().err.split())
