"""Our player under real clients, each in its own process: 0.28.0 as installed here, and Unity's published 1.1.0."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN, unused_port

CLIENT = Path(__file__).with_name("real_client.py")

Outcomes = dict[str, dict[str, str]]


def outcomes(python: str, port: int) -> Outcomes:
    command = [python, str(CLIENT), str(BIN / "corridor-server"), str(port)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    lines = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]
    assert lines, run.stderr
    return {line["sentence"]: line for line in lines}


@pytest.fixture(scope="module")
def under_0_28_0() -> Outcomes:
    return outcomes(sys.executable, unused_port())


@pytest.mark.slow
def test_the_player_under_0_28_0(under_0_28_0):
    failed = [line for line in under_0_28_0.values() if line["verdict"] == "fail"]
    assert not failed, failed


@pytest.mark.slow
def test_the_player_under_unitys_published_client_and_both_see_the_same_numbers(
    official_python, under_0_28_0, free_port
):
    official = outcomes(official_python, free_port)
    assert {line["verdict"] for line in official.values()} == {"pass"}, official
    trajectory = "areas_and_seed_are_the_trainers_and_equal_seeds_give_equal_episodes"
    assert under_0_28_0[trajectory]["detail"] == official[trajectory]["detail"]
