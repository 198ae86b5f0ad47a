"""Unity's own published clients read every scene of the stand-in, and receive what it sent."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN
from playing import BUILD, SPECS, Books, ledger

CLIENT = Path(__file__).with_name("read_by_client.py")


def refusals(python: str, port: int, folder: Path) -> dict[str, str]:
    """Plays all scenes; returns those that the client can't read, and why not."""
    environment = {**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}"}  # the build runs on the first python3 found
    command = [python, str(CLIENT), str(BUILD), str(port), str(folder), *SPECS]
    run = subprocess.run(command, capture_output=True, text=True, timeout=400, env=environment)
    read = [json.loads(line) for line in run.stdout.splitlines() if line.startswith('{"scene')]
    assert [each["scene"] for each in read] == SPECS, run.stderr
    for each in read:
        if "refusal" not in each:
            life, sent = ledger(folder / f"{each['scene']}.log")
            assert life["messages"] == 150
            received = {int(number): Books(**books).rounded() for number, books in each["books"].items()}
            assert received == {number: books.rounded() for number, books in sent.items()}, each["scene"]
    return {each["scene"]: each["refusal"] for each in read if "refusal" in each}


@pytest.mark.slow
def test_0_28_0_reads_every_scene_but_pictures_with_channels_first(free_port, tmp_path):
    refused = refusals(sys.executable, free_port, tmp_path)
    assert list(refused) == ["pictures"]
    assert "shape" in refused["pictures"] or "channels" in refused["pictures"]


@pytest.mark.slow
def test_1_1_0_reads_every_scene(official_python, free_port, tmp_path):
    assert refusals(official_python, free_port, tmp_path) == {}
