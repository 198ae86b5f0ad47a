"""``--from-sb3``: the weights of a Stable-Baselines3 policy, and nothing else of its file."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from asked import asked
from recorded_run import trained_run
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from corridor_server.corridor.gym_env import CorridorEnv
from trainer.errors import TrainerError
from trainer.learning.sb3_zip import load_sb3_policy
from trainer.learning.stages import build_stages
from trainer.main import main
from trainer.runs.checkpoint import read_checkpoint


def saved(path: Path, size: int = 64, **changes: torch.Tensor) -> PPO:
    """A model of Stable-Baselines3 with the presets' networks, saved."""
    model = PPO("MlpPolicy", make_vec_env(CorridorEnv, 2), policy_kwargs={"net_arch": [size, size]}, seed=5)
    model.policy.load_state_dict({**model.policy.state_dict(), **changes})
    model.save(path)
    return model


def ours():
    return build_stages(asked("any", c=0.0, num_areas=2).run_config(), make_vec_env(CorridorEnv, 2)).model


def test_the_policy_acts_as_the_one_that_was_saved(tmp_path):
    its, mine = saved(tmp_path / "model.zip"), ours()
    load_sb3_policy(tmp_path / "model.zip", mine)
    observations = np.random.default_rng(0).normal(size=(50, 13)).astype(np.float32)
    assert np.array_equal(
        mine.predict(observations, deterministic=True)[0], its.predict(observations, deterministic=True)[0]
    )


def test_a_run_begins_with_it_and_says_what_it_does_not_take(tmp_path, free_port, capsys):
    saved(tmp_path / "model.zip", log_std=torch.full((2,), -5.0))
    one_step = 1
    config = asked("r", num_areas=2, steps=one_step, from_sb3=tmp_path / "model.zip").run_config()
    folder = trained_run(config, tmp_path, free_port)
    assert "only the policy's weights are used" in " ".join(capsys.readouterr().out.split())
    assert folder.read_config() == config
    learned = read_checkpoint(folder.checkpoints).arrays["policy/log_std"]
    assert learned == pytest.approx(np.full(2, -5.0), abs=0.5)  # a random policy begins at -0.5


def test_a_bad_file_is_refused_before_anything_begins(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("no model")
    arguments = ["--run-id", "r", "--results-dir", str(tmp_path / "results"), "--from-sb3", str(tmp_path / "notes.txt")]
    assert main(["train", *arguments]) == 1
    assert "is not a model that Stable-Baselines3 saved" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "results").exists()


class Evil:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def replaced(tmp_path: Path, data: bytes) -> Path:
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as file:
        file.writestr("policy.pth", data)
    return tmp_path / "bad.zip"


def test_code_in_the_file_does_not_run(tmp_path):
    trap = tmp_path / "ran"
    path = replaced(tmp_path, pickle.dumps({"log_std": Evil(trap)}))
    torch.save({"log_std": Evil(trap)}, tmp_path / "evil.pth")
    for data in (path, replaced(tmp_path, (tmp_path / "evil.pth").read_bytes())):
        with pytest.raises(TrainerError, match="is not a model that Stable-Baselines3 saved"):
            load_sb3_policy(data, ours())
    assert not trap.exists()


def test_files_that_cant_be_used(tmp_path):
    with pytest.raises(TrainerError, match=r"none\.zip is not a model .* No such file"):
        load_sb3_policy(tmp_path / "none.zip", ours())
    (tmp_path / "text.zip").write_text("not a zip")
    with pytest.raises(TrainerError, match="text.zip is not a model .* not a zip file"):
        load_sb3_policy(tmp_path / "text.zip", ours())
    saved(tmp_path / "small.zip", size=32)
    with pytest.raises(TrainerError, match="small.zip is of another policy than this run's: .* size mismatch"):
        load_sb3_policy(tmp_path / "small.zip", ours())
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(TrainerError, match="is of another policy than this run's"):
        load_sb3_policy(replaced(tmp_path, (tmp_path / "list.pth").read_bytes()), ours())
    saved(tmp_path / "nan.zip", log_std=torch.tensor([0.0, torch.nan]))
    with pytest.raises(TrainerError, match=r"log_std in .*nan.zip has numbers that are NaN or infinite"):
        load_sb3_policy(tmp_path / "nan.zip", ours())
