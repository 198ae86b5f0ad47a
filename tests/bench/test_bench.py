"""``corridor bench`` writes the figures that it promises; how high they are is not a test's business."""

import ast
import dataclasses
import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from conftest import corridor_here

from trainer.bench import footprint, measure, training_rates
from trainer.bench.measure import run_bench
from trainer.bench.measuring_process import CLIENT_PROGRAM, ECHO_PROGRAM, MeasuringProcess
from trainer.bench.workload import Workload
from trainer.errors import TrainerError
from trainer.terminal import Terminal

SMALL = Workload(
    areas=(1, 8),
    rounds=1,
    seconds=0.05,
    train_steps={"fast": 2000, "paper": 128},
    train_rounds=1,
    players=((1, 8), (2, 4)),
    memory_areas=64,
    memory_steps={"1e6": 1000, "1e7": 2000},
    limit_updates=3,
)


@pytest.mark.parametrize("program", [CLIENT_PROGRAM, ECHO_PROGRAM], ids=lambda path: path.stem)
def test_a_program_runs_where_only_unitys_client_is_installed(program):
    """On Python 3.10, where nothing of ours has to be there."""
    tree = ast.parse(program.read_text(), feature_version=(3, 10))
    names = {each.name for node in ast.walk(tree) if isinstance(node, ast.Import) for each in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    roots = {name.partition(".")[0] for name in names}
    assert roots - set(sys.stdlib_module_names) <= {"numpy", "grpc", "mlagents_envs", "trainer"}


def test_no_file_beside_the_programs_hides_a_module_from_them():
    """Python puts their folder first on its path."""
    beside = {path.stem for path in CLIENT_PROGRAM.parent.glob("*.py")} - {"__init__"}
    assert {"client_program", "echo_program"} < beside
    assert [name for name in beside if importlib.util.find_spec(name) is not None] == []


def test_a_program_that_ends_at_once_is_named():
    with pytest.raises(TrainerError, match="echo_program.py nonsense ended before it measured anything; run it by"):
        MeasuringProcess(ECHO_PROGRAM, "nonsense")


@pytest.mark.slow
def test_every_figure_is_there(tmp_path, free_port, monkeypatch):
    def train_here(command, **_):
        python, dash, module, *arguments = command
        assert (python, dash, module) == (sys.executable, "-m", "trainer.main")
        return corridor_here(*arguments)

    monkeypatch.setattr(training_rates, "subprocess", SimpleNamespace(run=train_here))
    monkeypatch.setattr(footprint, "STARTS", 1)
    console = Terminal(record=True, width=160)
    run_bench(tmp_path / "speed.json", tmp_path / "speed.png", None, free_port, console, SMALL)
    report = json.loads((tmp_path / "speed.json").read_text())
    assert [row["areas"] for row in report["exchange"]] == [1, 8]
    for row in report["exchange"]:
        assert row["official"] is None
        assert min(row["ours"], row["mlagents_envs"], row["limit"], row["echo"]) > 0
    assert [row["areas"] for row in report["world"]] == [1, 8]
    assert [(row["c"], row["preset"]) for row in report["train"]] == [
        (0.3, "fast"),
        (0.0, "fast"),
        (0.3, "paper"),
    ]
    assert all(0.0 < row["exchange_share"] < 1.0 for row in report["train"])
    assert [(row["num_envs"], row["num_areas"]) for row in report["players"]] == [(1, 8), (2, 4)]
    assert all(min(row["limit"], row["steps_per_second"]) > 0 for row in report["players"])
    assert sum(report["limit"]["parts"].values()) == pytest.approx(report["limit"]["update_seconds"])
    assert report["startup_seconds"]["corridor-server"] > 0
    assert set(report["memory_mb"]) == {"1e6", "1e7"}
    assert report["machine"]["versions"]["mlagents-envs"] == "0.28.0"
    assert (tmp_path / "speed.png").stat().st_size > 1000
    said = console.export_text()
    for line in (
        "ours",
        "world in process,     8",
        "training, preset paper",
        "networks: matrix products alone",
        "training, 2 x 4 areas",
        "after 1e7 agent",
    ):
        assert line in said


def test_what_is_stopped_has_printed_and_kept_what_was_measured(tmp_path, monkeypatch):
    """Each row as soon as it is there: the second exchange is cut, as by Ctrl-C."""
    row = {"areas": 1, "ours": 10.0, "mlagents_envs": 5.0, "official": None, "limit": 20.0, "echo": 40.0}
    console, report = Terminal(record=True, width=80), tmp_path / "speed.json"

    def measure_one(areas, *_):
        if areas == 1:
            return row
        assert json.loads(report.read_text())["exchange"] == [row]
        assert "10        5 (2.0)              -         20 (0.5)       40 (25%)" in console.export_text(clear=False)
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "exchange_rates", measure_one)
    with pytest.raises(KeyboardInterrupt):
        run_bench(report, None, None, 1, console, SMALL)
    assert set(json.loads(report.read_text())) == {"machine", "exchange"}


def test_training_is_kept_after_every_round(monkeypatch, tmp_path):
    def train_nothing(command, **_):
        folder = Path(command[command.index("--results-dir") + 1]) / "bench"
        folder.mkdir(exist_ok=True)
        (folder / "summary.json").write_text('{"steps_per_second": 100.0, "exchange_share": 0.5}')
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(training_rates, "subprocess", SimpleNamespace(run=train_nothing))
    told: list[int] = []
    rounds = list(training_rates.preset_rates(1, dataclasses.replace(SMALL, train_rounds=2), told.append))
    assert [len(rows) for rows in rounds] == [3, 3]
    assert told == [1, 2, 3, 4, 5, 6]
