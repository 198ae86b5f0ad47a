"""Players that die, hang, lose their connection or their trainer, and where the trainer listens for them."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import SHORT, cut_connection, hurt_player, send
from prepared_run import PreparedRun


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(send(signal.SIGKILL), id="dies"),
        pytest.param(send(signal.SIGSTOP), id="hangs"),
        pytest.param(
            cut_connection,
            id="is cut off",
            marks=pytest.mark.skipif(os.geteuid() != 0, reason="reaching into another process takes root"),
        ),
    ],
)
def test_a_player_that_dies_hangs_or_loses_its_connection_is_started_again(tmp_path, free_port, fault):
    # Times out after 10 s: on a busy machine, a player may well be silent for some.
    run = PreparedRun(tmp_path, "hurt", free_port, *SHORT, "--timeout-wait", 10)
    assert hurt_player(run, fault, 1_000, 0.01) == 0, run.output
    run.leaves_nothing_behind()
    assert run.summary()["player_restarts"] >= 1
    assert run.summary()["env_steps"] >= 3_000


@pytest.mark.parametrize("listen", ["localhost", "0.0.0.0"])
def test_the_trainer_listens_on_loopback_unless_told_otherwise_and_then_warns(tmp_path, free_port, listen):
    run = PreparedRun(tmp_path, "listens", free_port, *SHORT, *(["--listen", listen] if listen != "localhost" else []))
    process, listening = run.start(), ""
    while not listening and process.poll() is None:
        listening = subprocess.run(["ss", "-Hltn", f"sport = :{free_port}"], capture_output=True, text=True).stdout
    process.send_signal(signal.SIGINT)
    assert run.wait(process) == 130, run.output
    places = {line.split()[3].rpartition(":")[0] for line in listening.splitlines()}
    assert places
    assert (places <= {"127.0.0.1", "[::ffff:127.0.0.1]", "[::1]"}) == (listen == "localhost"), listening
    assert ("no authentication" in run.output) == (listen != "localhost")
    run.leaves_nothing_behind()


STARTS_A_PLAYER_AND_ENDS = """
import os, subprocess, sys
program, port, log = sys.argv[1:]
subprocess.Popen([program, "--mlagents-port", port, "--parent", str(os.getpid()), "-logFile", log])
"""


def test_a_player_whose_trainer_is_gone_before_it_connects_ends(tmp_path, free_port):
    log = tmp_path / "log"
    arguments = [str(BIN / "corridor-server"), str(free_port), str(log)]
    subprocess.run([sys.executable, "-c", STARTS_A_PLAYER_AND_ENDS, *arguments], check=True, timeout=60)
    PreparedRun(tmp_path, "none", free_port).leaves_nothing_behind()
    assert "which started this player, is gone" in log.read_text()
