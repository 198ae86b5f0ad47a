"""``corridor bench`` writes the figures that it promises; how high they are is not a test's business."""

import json

import pytest
from rich.console import Console

from trainer.bench import measure as bench


@pytest.mark.slow
def test_every_figure_is_there(tmp_path, free_port, monkeypatch):
    monkeypatch.setattr(bench, "AREAS", (1, 8))
    monkeypatch.setattr(bench, "ROUNDS", 1)
    monkeypatch.setattr(bench, "SECONDS", 0.05)
    monkeypatch.setattr(bench, "TRAIN_STEPS", {"fast": 4000, "paper": 300})
    monkeypatch.setattr(bench, "PLAYERS", ((1, 8), (2, 4)))
    monkeypatch.setattr(bench, "MEMORY_STEPS", {"1e6": 2000, "1e7": 4000})
    console = Console(record=True, width=160)
    bench.run_bench(tmp_path / "speed.json", tmp_path / "speed.png", None, free_port, console)
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
    assert report["startup_seconds"]["corridor-server"] > 0
    assert set(report["memory_mb"]) == {"1e6", "1e7"}
    assert report["machine"]["versions"]["mlagents-envs"] == "0.28.0"
    assert (tmp_path / "speed.png").stat().st_size > 1000
    assert "limit" in console.export_text()
