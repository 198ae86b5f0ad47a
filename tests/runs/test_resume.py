"""Numbers that go bad stop a run and stay out of its checkpoints; checkpoints of other runs are refused."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from asked import asked
from recorded_run import trained_run
from stable_baselines3.common.env_util import make_vec_env

from trainer.errors import TrainerError
from trainer.learning.lean_ppo import LeanPPO
from trainer.learning.stages import build_stages
from trainer.runs.checkpoint import Checkpoint, checkpoints, from_bytes, read_checkpoint, to_bytes
from trainer.runs.folder import RunFolder
from trainer.runs.logs import ProgressFile
from trainer.runs.run_state import restore_trained


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (lambda model: model.policy.log_std.data.fill_(np.nan), r"policy/log_std\[0\] became nan"),
        (lambda model: model.logger.record("train/value_loss", np.inf), "train/value_loss became inf"),
    ],
)
def test_weights_or_losses_that_go_bad_stop_the_run_and_the_update_before_is_kept(
    tmp_path, free_port, monkeypatch, harm, says
):
    learn, updates = LeanPPO.train, []

    def third_time_unlucky(model):
        learn(model)
        updates.append(model.num_timesteps)
        if len(updates) == 3:
            harm(model)

    monkeypatch.setattr(LeanPPO, "train", third_time_unlucky)
    config = asked("r", num_areas=8, steps=4_000).run_config()
    folder = RunFolder(tmp_path / "r")
    with pytest.raises(TrainerError, match=f"After the update at step 384: {says}"):
        trained_run(config, tmp_path, free_port)
    assert [path.name for path in checkpoints(folder.checkpoints)] == ["step-0000000256.safetensors"]
    assert read_checkpoint(folder.checkpoints).facts["env_steps"] == 256


def checkpoint(**facts: object) -> Checkpoint:
    return Checkpoint({"normaliser/mean": np.zeros(18)}, {"config": {"algo": "ppo"}, **facts})


def test_a_checkpoint_for_another_observation_size_says_so():
    stages = build_stages(asked("any", num_areas=4).run_config(), make_vec_env("Pendulum-v1", 4))
    with pytest.raises(TrainerError, match="is for observations of 18 floats, but the player's have 3"):
        restore_trained(checkpoint(), stages, "ppo")


def test_a_checkpoint_of_another_algorithm_says_so():
    stages = build_stages(asked("any", num_areas=4).run_config(), make_vec_env("Pendulum-v1", 4))
    with pytest.raises(TrainerError, match="is of a run with --algo trpo, but this one has ppo"):
        restore_trained(checkpoint(config={"algo": "trpo"}), stages, "ppo")


def in_format_1(checkpoint: Checkpoint) -> Checkpoint:
    """A checkpoint as it was before its parts had their plain values, and the running episodes, to themselves."""
    arrays = {}
    before = {
        "progress/": "sb3_window/",
        "last_step/": "last/",
        "players/state_": "player_state/",
        "players/": "player/",
    }
    for name, array in checkpoint.arrays.items():
        start = next((start for start in before if name.startswith(start)), "")
        arrays[before.get(start, "") + name.removeprefix(start)] = array
    arrays["curiosity/episode_sums"] = arrays.pop("curiosity_episodes/sums")
    del arrays["curiosity_episodes/observations"]
    facts = dict(checkpoint.facts)
    parts = facts.pop("parts")
    del facts["format"]
    facts |= {name: parts["progress"][name] for name in ("env_steps", "updates", "logged")}
    facts |= {"numpy_random": parts["random"]["numpy_rest"], "lives": parts["players"]["lives"]}
    return Checkpoint(arrays, {**facts, "curiosity": parts["curiosity"]})


@pytest.mark.slow
def test_a_checkpoint_of_the_first_format_goes_on_to_the_bit(tmp_path, free_port, monkeypatch):
    def train_to(results: Path, steps: int, resumed: bool) -> RunFolder:
        config = asked("r", num_areas=8, steps=steps).run_config()
        return trained_run(config, results, free_port, resume=resumed)

    final = []
    train_to(tmp_path / "today", 256, resumed=False)
    shutil.copytree(tmp_path / "today", tmp_path / "before")
    for name in ("today", "before"):
        newest = checkpoints(tmp_path / name / "r" / "checkpoints")[-1]
        if name == "before":
            old = in_format_1(from_bytes(newest.read_bytes()))
            with monkeypatch.context() as patch:
                patch.setattr("trainer.runs.checkpoint.FORMAT", 1)
                newest.write_bytes(to_bytes(old))
        final.append(read_checkpoint(train_to(tmp_path / name, 512, resumed=True).checkpoints))
    today, before = final
    assert today.arrays.keys() == before.arrays.keys()
    assert [name for name, array in today.arrays.items() if not np.array_equal(array, before.arrays[name])] == []


def test_rows_after_the_checkpoint_and_rows_that_a_full_disk_cut_are_dropped(tmp_path):
    path = tmp_path / "progress.csv"
    whole = ProgressFile(path, 0)
    for steps in (10, 20, 30):
        whole.write({"time/total_timesteps": steps, "time/fps": 7}, {})
    whole.close()
    text = path.read_bytes()
    path.write_bytes(text[:-12])
    ProgressFile(path, 20).close()
    assert path.read_bytes() == b"".join(text.splitlines(keepends=True)[:3])
    path.write_bytes(text)
    resumed = ProgressFile(path, 20)
    resumed.write({"time/total_timesteps": 30, "time/fps": 7}, {})
    resumed.close()
    assert path.read_bytes() == text
