"""A study on a real Ray cluster of two nodes on this machine, one of which is lost in the middle."""

import json
import subprocess
import time
from pathlib import Path

import pytest
from conftest import BIN
from ray.cluster_utils import Cluster

from trainer.main import main


@pytest.mark.slow
def test_a_study_survives_the_loss_of_a_node(tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_raylet_start_wait_time_s", "300")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        node = cluster.add_node(num_cpus=1)
        steps = 3_000
        command = ["study", "penalty", "--executor", "ray", "--address", cluster.address, "--seeds", "1", "--steps"]
        command += [str(steps), "--eval-episodes", "1", "--results-dir", str(tmp_path)]
        process = subprocess.Popen(
            [str(BIN / "corridor"), *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        raylet = node.all_processes["raylet"][0].process.pid
        deadline = time.monotonic() + 300
        while time.monotonic() < deadline and not runs_below(raylet):
            time.sleep(0.2)
        lost = runs_below(raylet)
        assert lost
        cluster.remove_node(node, allow_graceful=False)

        output, errors = process.communicate(timeout=800)
        assert process.returncode == 0, output + errors
        study = tmp_path / "penalty"
        summaries = [json.loads(path.read_text()) for path in study.glob("*/summary.json")]
        assert sorted(each["run_id"] for each in summaries) == [
            "c0-no-penalty-seed0",
            "c0.3-no-penalty-seed0",
            "c0.3-seed0",
        ]
        assert all(each["env_steps"] >= steps and each["evaluation"]["episodes"] == 1 for each in summaries)
        record = json.loads((study / "claims.json").read_text())
        assert record["runs"] == {"finished": 3, "trained_by_this_command": 3, "failed": []}
        assert sorted(path.name for path in study.iterdir() if path.is_dir()) == sorted(
            each["run_id"] for each in summaries
        )
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and any(is_alive(each) for each in lost):
            time.sleep(0.2)
        assert not any(is_alive(each) for each in lost)
    finally:
        cluster.shutdown()


def children(process: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(process)], capture_output=True, text=True).stdout
    return [int(each) for each in found.split()]


def runs_below(process: int) -> list[int]:
    """Process ids of the study's workers that this process's children started."""
    return [
        run
        for worker in children(process)
        for run in children(worker)
        if "trainer.studies.worker" in Path(f"/proc/{run}/cmdline").read_text()
    ]


def is_alive(process: int) -> bool:
    status = Path(f"/proc/{process}/status")
    return status.exists() and "State:\tZ" not in status.read_text()


def test_an_unreachable_address_is_one_sentence_before_anything_starts(tmp_path, free_port, capsys):
    address = f"127.0.0.1:{free_port}"
    options = ["--executor", "ray", "--address", address, "--results-dir", str(tmp_path)]
    assert main(["study", "penalty", *options]) == 1
    assert f"No Ray cluster answers at --address {address}" in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())
