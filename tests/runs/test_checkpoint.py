"""Checkpoint files: whole or refused, with the last good one named; no code in them, and no bad numbers."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN
from safetensors.numpy import load, save

from trainer.errors import TrainerError
from trainer.runs import checkpoint as files
from trainer.runs.checkpoint import (
    Checkpoint,
    CheckpointWriter,
    DamagedCheckpoint,
    from_bytes,
    read_checkpoint,
    to_bytes,
)


def example(steps: int = 1) -> Checkpoint:
    generator = np.random.default_rng(steps)
    arrays = {
        "policy/weight": generator.standard_normal((7, 5)).astype(np.float32),
        "count": np.array(3.5),
        "empty": np.zeros(0),
        "bytes": np.frombuffer(b"area", np.uint8),
        "starts": np.array([True, False]),
    }
    return Checkpoint(
        arrays, {"text": 'quotes " and \\ and "sha256":"' + "a" * 64 + '"', "big": 2**127, "env_steps": steps}
    )


def written(folder: Path, *kept: int) -> None:
    writer = CheckpointWriter(folder)
    for steps in kept:
        writer.write(steps, to_bytes(example(steps)))
        writer.keep()


def test_what_is_read_is_what_was_written():
    read = from_bytes(to_bytes(example()))
    for name, array in example().arrays.items():
        assert read.arrays[name].dtype == array.dtype
        assert np.array_equal(read.arrays[name], array)
    assert {name: read.facts[name] for name in example().facts} == example().facts


def test_a_checkpoint_is_a_safetensors_file_that_others_read():
    data = to_bytes(example())
    assert np.array_equal(load(bytes(data))["policy/weight"], example().arrays["policy/weight"])
    length = struct.unpack("<Q", data[:8])[0]
    assert set(json.loads(data[8 : 8 + length])["__metadata__"]) == {"facts", "sha256"}


def test_a_thousand_changed_bytes_and_a_hundred_truncations_are_all_detected():
    data, generator = to_bytes(example()), np.random.default_rng(0)
    for _ in range(1000):
        damaged = bytearray(data)
        damaged[generator.integers(len(data))] ^= int(generator.integers(1, 256))
        with pytest.raises(DamagedCheckpoint):
            from_bytes(bytes(damaged))
    for length in generator.integers(0, len(data), 100):
        with pytest.raises(DamagedCheckpoint):
            from_bytes(data[:length])


def test_every_byte_of_the_header_counts():
    data = to_bytes(example())
    for at in range(8 + struct.unpack("<Q", data[:8])[0]):
        damaged = bytearray(data)
        damaged[at] ^= 0x20
        with pytest.raises(DamagedCheckpoint):
            from_bytes(bytes(damaged))


def test_of_a_damaged_checkpoint_the_last_good_one_is_offered(tmp_path):
    written(tmp_path, 100, 200, 300, 400)
    for name in ("step-0000000400", "step-0000000300"):
        path = tmp_path / f"{name}.safetensors"
        path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(TrainerError) as error:
        read_checkpoint(tmp_path)
    assert "step-0000000400.safetensors is damaged: its checksum" in str(error.value)
    assert "The last good one is step-0000000200.safetensors: delete step-0000000400" in str(error.value)


def test_without_a_good_one_that_is_said(tmp_path):
    written(tmp_path, 100)
    (tmp_path / "step-0000000100.safetensors").write_bytes(b"")
    with pytest.raises(TrainerError, match="There is no good one; train the run again with --force"):
        read_checkpoint(tmp_path)


def test_a_pickle_is_no_checkpoint_and_is_not_run(tmp_path):
    bomb = b"cposix\nsystem\n(S'touch " + str(tmp_path / "pwned").encode() + b"'\ntR."
    (tmp_path / "step-0000000001.safetensors").write_bytes(bomb)
    with pytest.raises(TrainerError, match="is damaged: it has no checksum"):
        read_checkpoint(tmp_path)
    assert not (tmp_path / "pwned").exists()


def test_corridor_has_nothing_that_unpickles():
    sources = [path.read_text() for path in Path(files.__file__).parents[1].rglob("*.py")]
    for word in ("import pickle", "cloudpickle", "allow_pickle=True", "joblib"):
        assert not [text for text in sources if word in text], word
    # Tensors and plain containers only; tests/learning/test_sb3_zip.py shows that code does not run.
    assert all(text.count("torch.load(") == text.count("weights_only=True") for text in sources)


def test_a_checkpoint_of_a_later_version_says_so(monkeypatch):
    monkeypatch.setattr(files, "FORMAT", 4)
    data = to_bytes(example())
    monkeypatch.undo()
    with pytest.raises(TrainerError, match="format 4 was made by a later version .* this one reads format 3"):
        from_bytes(data)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_checkpoint_never_contains_nan(bad):
    checkpoint = example()
    checkpoint.arrays["policy/weight"][2, 3] = bad
    with pytest.raises(TrainerError, match=rf"policy/weight\[2, 3\] became {bad}; the run has diverged"):
        to_bytes(checkpoint)


def test_one_rolling_checkpoint_and_the_newest_five_are_kept(tmp_path):
    written(tmp_path, *range(100, 900, 100))
    writer = CheckpointWriter(tmp_path)
    for steps in (910, 920, 930):
        writer.write(steps, to_bytes(example(steps)))
    names = sorted(path.name for path in tmp_path.iterdir())
    kept = [f"step-0000000{steps}.safetensors" for steps in range(400, 900, 100)]
    assert names == ["rollout-0000000930.safetensors", *kept]
    assert read_checkpoint(tmp_path).facts["env_steps"] == 930
    assert read_checkpoint(tmp_path, "step-500").facts["env_steps"] == 500
    with pytest.raises(TrainerError, match="There is no checkpoint 'step-7' .* step-400, step-500, .* rollout-930"):
        read_checkpoint(tmp_path, "step-7")


KILLED = """
import sys
from pathlib import Path
from test_checkpoint import example
from trainer.runs.checkpoint import CheckpointWriter, to_bytes
data = [to_bytes(example(steps)) for steps in range(5)]
writer = CheckpointWriter(Path(sys.argv[1]))
print("ready", flush=True)
for steps in range(10**6):
    writer.write(steps, data[steps % 5])
    if steps % 50 == 0:
        writer.keep()
"""


def test_a_writer_killed_at_any_moment_leaves_only_whole_files(tmp_path):
    for attempt in range(5):
        folder = tmp_path / str(attempt)
        command = [sys.executable, "-c", KILLED, str(folder)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            while not folder.is_dir() or len(list(folder.glob("*.safetensors"))) < 2:
                assert process.poll() is None
            process.kill()
        for path in folder.glob("*.safetensors"):
            from_bytes(path.read_bytes())
        read_checkpoint(folder)


def test_a_damaged_checkpoint_ends_the_command_with_the_offer(tmp_path):
    run = tmp_path / "r"
    options = ["--run-id", "r", "--results-dir", str(tmp_path)]
    from recorded_run import begun_run

    from trainer.commands.train import Train

    begun_run(Train("r").run_config(), tmp_path)
    written(run / "checkpoints", 100, 200)
    (run / "checkpoints" / "step-0000000200.safetensors").write_bytes(b"\0" * 1000)
    done = subprocess.run([str(BIN / "corridor"), "train", *options, "--resume"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "The last good one is step-0000000100.safetensors" in done.stderr
    assert "Traceback" not in done.stderr


def test_safetensors_of_others_are_no_checkpoints(tmp_path):
    (tmp_path / "step-0000000001.safetensors").write_bytes(save({"weight": np.zeros(3)}))
    with pytest.raises(TrainerError, match="it has no checksum"):
        read_checkpoint(tmp_path)
