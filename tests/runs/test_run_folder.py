"""Who may write to a run's folder, and when: one command at a time, and nothing before it is true."""

import errno
import fcntl
import random
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from asked import asked
from conftest import unused_port
from recorded_run import begun_run, recorded_run, settings, trained_run

from trainer.drafts import beside, only_writer
from trainer.errors import TrainerError
from trainer.files import write_whole
from trainer.main import main
from trainer.runs.checkpoint import Checkpoint, CheckpointWriter, checkpoints, read_checkpoint, to_bytes
from trainer.runs.folder import RunFolder
from trainer.viewer.live import play_checkpoint

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import Run
from two_writers import check, interleave


def contents(folder: Path) -> dict[Path, bytes | None]:
    """Every file and folder in a folder; None for a folder."""
    return {path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def said(capsys: pytest.CaptureFixture[str]) -> str:
    return " ".join(capsys.readouterr().err.split())


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[Callable[[Path], "subprocess.Popen[str]"]]:
    """Starts a process that holds a folder until it is killed."""
    started = []

    def hold(folder: Path) -> "subprocess.Popen[str]":
        program = (
            "import sys; from pathlib import Path; from trainer.drafts import only_writer\n"
            "with only_writer(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
        )
        command = [sys.executable, "-c", program, str(folder)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        return process

    yield hold
    for process in started:
        process.kill()
        process.communicate()


# one writer


@pytest.mark.slow
def test_while_a_run_is_trained_other_writers_are_refused_and_readers_go_on(tmp_path, free_port, capsys, request):
    run = Run(tmp_path, "mine", free_port, "--num-areas", 8, "--steps", 10_000_000)
    process = run.start()
    request.addfinalizer(process.kill)
    run.wait_for_steps(process, 1)
    where = ("--results-dir", str(tmp_path), "--base-port", str(free_port + 1))
    for command in (
        ("train", "--run-id", "mine", "--force", "--seed", "1"),
        ("train", "--run-id", "mine", "--resume", "--num-areas", "8", "--steps", "10000000"),
        ("train", "--run-id", "mine"),
        ("evaluate", "mine"),
        ("replay", "mine"),
    ):
        assert main([*command, *where]) == 1, command
        assert f"Another corridor command is writing to {run.folder}" in said(capsys)
    assert main(["export", "mine", "--results-dir", str(tmp_path), "--onnx", str(tmp_path / "mine.onnx")]) == 0
    process.send_signal(signal.SIGINT)
    assert run.wait(process) == 130, run.output
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "mine.onnx"}


def test_a_folder_is_held_until_its_holder_ends_even_by_a_kill(tmp_path, holder):
    process = holder(tmp_path / "mine")
    with pytest.raises(TrainerError, match="Another corridor command is writing"), only_writer(tmp_path / "mine"):
        pass
    process.kill()
    process.wait()
    with only_writer(tmp_path / "mine") as draft:
        assert list(draft.path.iterdir()) == []
    assert list(tmp_path.iterdir()) == []


def test_a_folder_stays_held_while_another_takes_its_place(tmp_path):
    config = settings("mine")
    begun_run(config, tmp_path)
    with RunFolder.claim(config, tmp_path, resume=False, force=True) as (folder, draft):
        draft.publish()
        with pytest.raises(TrainerError, match="Another"), RunFolder.claim(config, tmp_path, resume=False, force=True):
            pass
    assert folder.path.is_dir()


def test_a_study_and_a_replay_of_it_hold_its_folder_too(tmp_path, holder, capsys):
    (tmp_path / "penalty").mkdir()
    (tmp_path / "penalty" / "claims.json").write_text("{}")
    holder(tmp_path / "penalty")
    for command in (["study", "penalty"], ["replay", "penalty"]):
        assert main([*command, "--results-dir", str(tmp_path)]) == 1
        assert "Another corridor command is writing" in said(capsys)


def test_a_file_system_without_locks_is_warned_of_once_and_written_to(tmp_path, monkeypatch, capsys):
    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with only_writer(tmp_path / "mine") as draft:
        (draft.path / "file").write_text("written")
        draft.publish()
    assert (tmp_path / "mine" / "file").read_text() == "written"
    assert "can't be locked (Operation not supported); see to it that no other command writes" in said(capsys)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run that was trained and evaluated."""
    config = asked("mine", num_areas=8, steps=200).run_config()
    return trained_run(config, tmp_path_factory.mktemp("finished"), unused_port())


@pytest.fixture
def mine(finished, tmp_path) -> RunFolder:
    """A copy of it, in a results folder of its own."""
    return RunFolder(Path(shutil.copytree(finished.path, tmp_path / "results" / "mine")))


def test_a_checkpoint_of_another_run_is_not_played_exported_or_gone_on_with(mine, capsys):
    newest = read_checkpoint(mine.checkpoints)
    others = {**newest.facts, "config": {**newest.facts["config"], "seed": 5, "steps": 300}}
    CheckpointWriter(mine.checkpoints).write(301_056, to_bytes(Checkpoint(newest.arrays, others)))
    before = contents(mine.path)
    for command in (
        ("evaluate", "mine"),
        ("replay", "mine", "--checkpoint", "rollout-301056"),
        ("export", "mine", "--onnx", str(mine.path.parent / "mine.onnx")),
        ("train", "--run-id", "mine", "--resume", "--num-areas", "8", "--steps", "200"),
    ):
        assert main([*command, "--results-dir", str(mine.path.parent)]) == 1
        assert "is another run's: it has seed 5 instead of 0; delete it" in said(capsys)
    with pytest.raises(TrainerError, match="is another run's"):
        play_checkpoint(mine.path, "rollout-0000301056")
    assert contents(mine.path.parent) == {mine.path: None} | before


# nothing before it is true


def test_a_first_start_that_fails_leaves_nothing_and_says_what_the_player_last_said(tmp_path, free_port, capsys):
    player = tmp_path / "player"
    player.write_text('#!/bin/sh\nwhile [ "$1" != -logFile ]; do shift; done\necho "no licence" >"$2"; exit 3\n')
    player.chmod(0o755)
    results = tmp_path / "some" / "results"
    train = ["train", "--run-id", "mine", "--results-dir", str(results), "--base-port", str(free_port)]
    with socket.create_server(("127.0.0.1", free_port)):
        assert main(train) == 1
        assert f"Port {free_port} on localhost is in use" in said(capsys)
    assert main([*train, "--env", str(player)]) == 1
    assert "return code 3. The player's log ends: no licence" in said(capsys)
    assert list(tmp_path.iterdir()) == [player]


def test_a_command_that_fails_before_its_player_is_open_leaves_the_folder_as_it_was(mine, free_port, capsys):
    before = contents(mine.path.parent)
    where = ["--results-dir", str(mine.path.parent), "--base-port", str(free_port)]
    with socket.create_server(("127.0.0.1", free_port)):
        for command in (
            ["train", "--run-id", "mine", "--resume", "--num-areas", "8", "--steps", "400"],
            ["train", "--run-id", "mine", "--force", "--seed", "1"],
            ["evaluate", "mine"],
            ["replay", "mine", "--checkpoint", checkpoints(mine.checkpoints)[-1].stem],
        ):
            assert main([*command, *where]) == 1
            assert "is in use" in said(capsys)
            assert contents(mine.path.parent) == before


def test_a_resume_whose_player_does_not_fit_leaves_the_folder_as_it_was(mine, tmp_path, free_port, capsys):
    crowded = tmp_path / "crowded.json"
    crowded.write_text('{"num_opponents": 2}')
    newest = read_checkpoint(mine.checkpoints)
    arrays = {name: array for name, array in newest.arrays.items() if name != "players/state_0"}  # new episodes begin
    checkpoints(mine.checkpoints)[-1].write_bytes(to_bytes(Checkpoint(arrays, newest.facts)))
    before = contents(mine.path.parent)
    train = ["train", "--run-id", "mine", "--results-dir", str(mine.path.parent), "--base-port", str(free_port)]
    options = ["--resume", "--num-areas", "8", "--steps", "400", "--env-args", "--config", str(crowded)]
    assert main([*train, *options]) == 1
    assert "is for observations of 13 floats, but the player's have 18" in said(capsys)
    assert contents(mine.path.parent) == before


KILLED_AFTER = """
import os, signal, sys
from pathlib import Path
from trainer.drafts import only_writer
left, rename = int(sys.argv[2]), Path.rename
def rename_and_die(path, target):
    global left
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
    left -= 1
    return rename(path, target)
with only_writer(Path(sys.argv[1]), replace=True) as draft:
    (draft.path / "configuration.yaml").write_text("new")
    (draft.path / "notes").write_text("new")
    Path.rename = rename_and_die
    draft.publish()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize(("renames", "left"), [(0, "old"), (1, "old"), (2, "new")])
def test_a_kill_while_a_folder_replaces_another_leaves_one_or_the_other(tmp_path, renames, left):
    old = tmp_path / "mine"
    old.mkdir()
    (old / "configuration.yaml").write_text("old")
    (old / "checkpoint").write_text("old")
    done = subprocess.run([sys.executable, "-c", KILLED_AFTER, str(old), str(renames)])
    assert done.returncode == -signal.SIGKILL
    found = RunFolder.find("mine", tmp_path)
    assert {path.read_text() for path in found.path.iterdir()} == {left}
    with only_writer(found.path):
        pass
    assert list(tmp_path.iterdir()) == [old]


# nothing is left behind


def test_a_replay_that_fails_half_way_leaves_no_page(tmp_path, monkeypatch, capsys):
    run = recorded_run(tmp_path)
    before = contents(tmp_path)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("trainer.viewer.replay_files.save_animations", full)
    assert main(["replay", run.path.name, "--results-dir", str(tmp_path)]) == 1
    assert "No space left on device" in said(capsys)
    assert contents(tmp_path) == before


def test_a_generalisation_that_fails_leaves_no_folder(mine, monkeypatch, capsys):
    def no_player(*_: object) -> None:
        raise TrainerError("No player.")

    monkeypatch.setattr("trainer.studies.generalise.play", no_player)
    assert main(["study", "generalise", "mine", "--results-dir", str(mine.path.parent)]) == 1
    assert list(mine.path.parent.iterdir()) == [mine.path]


def test_a_file_that_cant_be_written_leaves_nothing_and_no_other_file_is_touched(tmp_path):
    (tmp_path / "policy.onnx").mkdir()
    (tmp_path / "policy.onnx.tmp").write_text("somebody's")
    with pytest.raises(OSError, match="directory"):
        write_whole(tmp_path / "policy.onnx", b"data")
    assert {path.name for path in tmp_path.iterdir()} == {"policy.onnx", "policy.onnx.tmp"}
    assert (tmp_path / "policy.onnx.tmp").read_text() == "somebody's"


def test_what_a_killed_writer_left_goes_with_the_next_one(tmp_path):
    run = begun_run(settings("mine"), tmp_path)
    before = contents(tmp_path)
    beside(run.path, "new").mkdir()
    (run.path / ".~new").mkdir()
    (run.path / ".summary.json~77").write_text("{")
    (tmp_path / ".mine~lock").touch()
    with only_writer(run.path):
        pass
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_two_writers_at_random_moments_leave_one_run_and_play_its_policy(tmp_path, free_port):
    """A few of the interleavings of ``tests/faults/two_writers.py``."""
    ended = interleave(tmp_path, free_port, random.Random(3), commands=1)
    check(tmp_path, ended)
