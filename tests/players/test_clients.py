"""Our player under real clients, each in its own process: 0.28.0 as installed here, and Unity's published 1.1.0."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN, interpreter

CLIENT = Path(__file__).with_name("real_client.py")
# mlagents-envs 1.1.0's own pins. It says Python <= 3.10.12 and runs on later 3.10 ones, so it is installed by itself.
PINS = ("cloudpickle", "grpcio<=1.48.2", "Pillow", "protobuf<3.21", "pyyaml", "gym>=0.21", "pettingzoo==1.15.0")
MORE_PINS = ("numpy>=1.23.5,<1.24", "filelock>=3.4")

Outcomes = dict[str, dict[str, str]]


def outcomes(python: str, port: int) -> Outcomes:
    command = [python, str(CLIENT), str(BIN / "corridor-server"), str(port)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    lines = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]
    assert lines, run.stderr
    return {line["sentence"]: line for line in lines}


@pytest.fixture(scope="module")
def official_python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter with Unity's published client: ``OFFICIAL_PYTHON``, or one installed for these tests."""
    if given := os.environ.get("OFFICIAL_PYTHON"):
        return given
    python = interpreter("3.10")
    if python is None:
        pytest.skip("Unity's published client needs Python 3.10, and there is none on this machine")
    folder = tmp_path_factory.mktemp("official")
    pip = [str(folder / "bin" / "pip"), "install", "--quiet"]
    subprocess.run([python, "-m", "venv", folder], check=True)
    subprocess.run([*pip, "setuptools<81", "wheel"], check=True)
    subprocess.run([*pip, *PINS, *MORE_PINS], check=True)
    subprocess.run([*pip, "--no-deps", "--ignore-requires-python", "mlagents-envs==1.1.0"], check=True)
    return str(folder / "bin" / "python")


def test_the_player_under_0_28_0(free_port):
    failed = [line for line in outcomes(sys.executable, free_port).values() if line["verdict"] == "fail"]
    assert not failed, failed


@pytest.mark.slow
def test_the_player_under_unitys_published_client_and_both_see_the_same_numbers(official_python, free_port):
    official = outcomes(official_python, free_port)
    assert {line["verdict"] for line in official.values()} == {"pass"}, official
    trajectory = "areas_and_seed_are_the_trainers_and_equal_seeds_give_equal_episodes"
    assert outcomes(sys.executable, free_port)[trajectory]["detail"] == official[trajectory]["detail"]
