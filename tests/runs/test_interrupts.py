"""A signal ends any command cleanly, wherever it is; ``tests/faults/interrupts.py`` does it at many more moments."""

import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import unused_port

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from interrupts import Interrupt, commands, interrupted, interrupts, prepare


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a run that has been trained."""
    folder = tmp_path_factory.mktemp("results")
    prepare(folder, unused_port())
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", ["train", "evaluate", "replay", "study", "check", "bench", "watch"])
def test_a_signal_is_one_clean_end_with_130_no_traceback_and_nothing_left(results, tmp_path, name):
    ways = commands(results, unused_port())[name]
    for index, interrupt in enumerate(interrupts(2, random.Random(name), seconds=3.0)):
        end = interrupted(ways[index % len(ways)], interrupt, tmp_path)
        assert not end.faults, f"{interrupt}: {end}"


@pytest.mark.slow
def test_a_player_that_does_not_dial_is_not_waited_for(tmp_path):
    player = tmp_path / "player"
    player.write_text("#!/bin/sh\nexec sleep 600\n")
    player.chmod(0o755)
    train = ("train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", unused_port(), "--env", player)
    end = interrupted(list(map(str, train)), Interrupt(signal.SIGTERM, 6.0, None, False), tmp_path)
    assert not end.faults, end


NOBODY_IS_LEFT = """
import os, signal, sys
from trainer.signals import ended_by_signals, temporary_folder
with ended_by_signals():
    with temporary_folder() as folder:
        (folder / "file").write_text("x")
        print(folder, flush=True)
        for _ in range({signals}):
            os.kill(os.getpid(), signal.SIGINT)
"""


@pytest.mark.parametrize("signals", [0, 1, 2])
def test_no_end_leaves_a_temporary_folder_behind(signals):
    done = subprocess.run(
        [sys.executable, "-c", NOBODY_IS_LEFT.format(signals=signals)], capture_output=True, text=True
    )
    folder = Path(done.stdout.split()[0])
    assert (done.returncode, folder.exists()) == (130 if signals else 0, False), done.stderr
