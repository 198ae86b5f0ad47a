"""What docs/faults.md promises, once each; ``tests/faults/campaign.py`` does it over and over at random moments."""

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN

from trainer.main import main
from trainer.runs.callbacks import StopOnSignal

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import Run, close_folder, cut_connection, hurt_player, mount_small, send, stop_with, train_with_kills

SHORT = ("--num-areas", 8, "--steps", 8_000, "--eval-episodes", 4, "--timeout-wait", 120)


@pytest.fixture(scope="module")
def uncut(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run that nothing happens to."""
    run = Run(tmp_path_factory.mktemp("uncut"), "uncut", 6420, *SHORT)
    assert run.finish() == 0, run.output
    return run


@pytest.mark.slow
def test_a_killed_trainer_resumed_gives_the_uncut_runs_weights_rows_and_curves(uncut, tmp_path, free_port):
    run = Run(tmp_path, "killed", free_port, *SHORT)
    moments = train_with_kills(run, 2, 8_000, random.Random(0))
    run.equals(uncut)
    assert run.summary()["restarts"] == run.summary()["resumes"] >= sum(step > 0 for step in moments) - 1


@pytest.mark.slow
def test_two_players_and_samplers_resume_bit_for_bit_too(tmp_path, free_port):
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        "environment_parameters:\n  opponent_speed:\n    sampler_type: gaussian\n"
        "    sampler_parameters: {mean: 1, st_dev: 0.3}\n"
    )
    options = ("--num-envs", 2, "--num-areas", 4, "--steps", 4_000, "--eval-episodes", 4, "--config", settings)
    whole, cut = (Run(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGINT, 1_000, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)


@pytest.mark.slow
def test_the_papers_preset_resumes_bit_for_bit_too(tmp_path, free_port):
    options = ("--preset", "paper", "--steps", 1_000, "--eval-episodes", 1)
    whole, cut = (Run(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGTERM, 256, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)


@pytest.mark.slow
def test_unitys_decision_timing_resumes_bit_for_bit_too(tmp_path, free_port):
    """An episode is an idle step and 64 decisions: the last one, and the RESET after it, end every rollout of 256."""
    player = tmp_path / "player"
    player.write_text(f'#!/bin/sh\nexec {BIN / "corridor-server"} --decision-timing unity "$@"\n')
    player.chmod(0o755)
    options = ("--env", player, "--env-param", "max_episode_steps=65", "failure_return=-1000")
    options += ("--preset", "paper", "--steps", 1_000, "--eval-episodes", 1)
    whole, cut = (Run(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGTERM, 256, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)
    assert whole.summary()["episodes"] == 16


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_the_run_cleanly_and_the_rest_is_as_uncut(uncut, tmp_path, free_port, number):
    run = Run(tmp_path, "stopped", free_port, *SHORT)
    assert stop_with(run, number, 2_000, 0.01) == 130
    assert "go on with --resume" in run.output
    assert "Traceback" not in run.output
    run.leaves_nothing_behind()
    assert run.summary()["env_steps"] == run.steps()
    assert run.finish("--resume") == 0, run.output
    run.equals(uncut)


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
    run = Run(
        tmp_path, "hurt", free_port, "--num-areas", 8, "--steps", 8_000, "--eval-episodes", 4, "--timeout-wait", 10
    )
    assert hurt_player(run, fault, 2_000, 0.01) == 0, run.output
    run.leaves_nothing_behind()
    assert run.summary()["player_restarts"] >= 1
    assert run.summary()["env_steps"] >= 8_000


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk takes root")
def test_a_full_disk_ends_the_run_with_a_sentence_and_room_lets_it_go_on(uncut, tmp_path, free_port):
    disk = tmp_path / "disk"
    if not mount_small(disk, "300k"):
        pytest.skip("mounting is not allowed here")
    try:
        run = Run(disk, "full", free_port, *SHORT)
        assert run.finish() == 1
        assert "can't be written (No space left on device)" in run.output
        assert "Traceback" not in run.output
        run.leaves_nothing_behind()
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        assert run.finish("--resume") == 0, run.output
        run.equals(uncut)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting takes root")
def test_a_results_folder_that_becomes_read_only_ends_the_run_with_a_sentence(uncut, tmp_path, free_port):
    run = Run(tmp_path, "closed", free_port, *SHORT)
    process = run.start()
    run.wait_for_steps(process, 2_000)
    with close_folder(run.folder / "checkpoints") as closed:
        if not closed:
            process.kill()
            run.wait(process)
            pytest.skip("mounting is not allowed here")
        assert run.wait(process) == 1
    assert "can't be written (Read-only file system)" in run.output
    assert "Traceback" not in run.output
    run.leaves_nothing_behind()
    assert run.finish("--resume") == 0, run.output
    run.equals(uncut)


def test_changed_settings_are_listed_with_what_is_allowed(tmp_path):
    from recorded_run import begun_run

    from trainer.commands.shared_options import TrainingOptions
    from trainer.commands.train import Train
    from trainer.errors import TrainerError
    from trainer.runs.folder import RunFolder

    begun_run(Train("r").run_config(), tmp_path)
    longer = TrainingOptions(steps=2_000_000)
    changed = Train("r", c=0.5, training=longer).run_config()
    with pytest.raises(TrainerError) as error, RunFolder.claim(changed, tmp_path, resume=True, force=False):
        pass
    assert "curiosity.c 0.3 -> 0.5 (not allowed), steps 1500000 -> 2000000 (allowed)" in str(error.value)
    with RunFolder.claim(Train("r", training=longer).run_config(), tmp_path, resume=True, force=False):
        pass


@pytest.mark.parametrize("listen", ["localhost", "0.0.0.0"])
def test_the_trainer_listens_on_loopback_unless_told_otherwise_and_then_warns(tmp_path, free_port, listen):
    run = Run(tmp_path, "listens", free_port, *SHORT, *(["--listen", listen] if listen != "localhost" else []))
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
    Run(tmp_path, "none", free_port).leaves_nothing_behind()
    assert "which started this player, is gone" in log.read_text()


def test_a_summary_names_the_final_policy(uncut):
    digest = json.loads((uncut.folder / "summary.json").read_text())["policy_sha256"]
    assert len(digest) == 64
    assert int(digest, 16)


def test_a_stop_at_a_rollouts_last_step_is_not_taken_for_an_update(tmp_path, free_port, monkeypatch):
    """8 areas x 16 steps: the third rollout ends at step 384, but nothing has been learned from it."""
    step = StopOnSignal._on_step

    def stop_at_384(self):
        self._signals.received = self.num_timesteps == 384
        return step(self)

    monkeypatch.setattr(StopOnSignal, "_on_step", stop_at_384)
    options = ["--run-id", "r", "--results-dir", str(tmp_path), "--base-port", str(free_port), "--num-areas", "8"]
    assert main(["train", *options, "--steps", "1000"]) == 130
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["env_steps"] == 256
