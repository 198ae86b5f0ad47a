"""What docs/faults.md promises, once each; ``tests/faults/campaign.py`` does it over and over at random moments."""

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from asked import asked

from trainer.main import main
from trainer.runs.callbacks import StopOnSignal

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import SHORT, Run, close_folder, mount_small, stop_with, train_with_kills
from prepared_run import PreparedRun


@pytest.fixture(scope="module")
def uncut(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run that nothing happens to."""
    run = PreparedRun(tmp_path_factory.mktemp("uncut"), "uncut", 6420, *SHORT)
    assert run.finish() == 0, run.output
    assert len(run.rows()) >= 4
    return run


@pytest.mark.slow
def test_a_killed_trainer_resumed_gives_the_uncut_runs_weights_rows_and_curves(uncut, tmp_path, free_port):
    run = PreparedRun(tmp_path, "killed", free_port, *SHORT)
    moments = train_with_kills(run, 2, 3_000, random.Random(0))
    run.equals(uncut)
    assert run.summary()["restarts"] == run.summary()["resumes"] >= sum(step > 0 for step in moments) - 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])  # SIGTERM: with the paper's preset
def test_a_signal_stops_the_run_cleanly_and_the_rest_is_as_uncut(uncut, tmp_path, free_port, number):
    run = PreparedRun(tmp_path, "stopped", free_port, *SHORT)
    assert stop_with(run, number, 1_000, 0.01) == 130
    assert "go on with --resume" in run.output
    assert "Traceback" not in run.output
    run.leaves_nothing_behind()
    assert run.summary()["env_steps"] == run.steps()
    assert run.finish("--resume") == 0, run.output
    run.equals(uncut)


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk takes root")
def test_a_full_disk_ends_the_run_with_a_sentence_and_room_lets_it_go_on(uncut, tmp_path, free_port):
    disk = tmp_path / "disk"
    if not mount_small(disk, "200k"):
        pytest.skip("mounting is not allowed here")
    try:
        run = PreparedRun(disk, "full", free_port, *SHORT)
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
    run = PreparedRun(tmp_path, "closed", free_port, *SHORT)
    process = run.start()
    run.wait_for_steps(process, 1_000)
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

    from trainer.commands.train import Train
    from trainer.errors import TrainerError
    from trainer.runs.folder import RunFolder

    begun_run(Train("r").run_config(), tmp_path)
    longer = 2_000_000
    changed = asked("r", c=0.5, steps=longer).run_config()
    with pytest.raises(TrainerError) as error, RunFolder.claim(changed, tmp_path, resume=True, force=False):
        pass
    assert "curiosity.c 0.3 -> 0.5 (not allowed), steps 1500000 -> 2000000 (allowed)" in str(error.value)
    with RunFolder.claim(asked("r", steps=longer).run_config(), tmp_path, resume=True, force=False):
        pass


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
