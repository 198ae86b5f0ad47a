"""``corridor export`` of runs in lockstep: the policy as ML-Agents names it, equal to Stable-Baselines3's."""

import dataclasses
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
import yaml
from asked import asked
from conftest import corridor_here, unused_port
from exported import form, session
from mlagents_envs.base_env import ActionSpec
from scripted import spec
from stable_baselines3 import SAC

from trainer.errors import TrainerError
from trainer.learning.stages import Stages, build_stages
from trainer.runs.checkpoint import find_checkpoint
from trainer.runs.folder import RunFolder
from trainer.runs.onnx_file import _Nobody, policy_as_onnx
from trainer.runs.training import load_trained

BATCH = 4096


def stages_on(behavior, *, c: float = 0.0, mean: float = 0.0, variance: float = 1.0) -> Stages:
    """A policy with weights that matter, and statistics as after training."""
    stages = build_stages(asked("any", c=c, num_areas=4).run_config(), _Nobody(4, behavior))
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in stages.model.policy.parameters():
            parameter.copy_(0.5 * torch.randn(parameter.shape, generator=generator))
    statistics = stages.normaliser.obs_rms
    statistics.mean = np.full_like(statistics.mean, mean)
    statistics.var = np.full_like(statistics.var, variance)
    return stages


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = tmp_path_factory.mktemp("results")
    port = unused_port()
    options = ("--steps", 4000, "--num-areas", 16, "--eval-episodes", 1)
    done = corridor_here("train", "--run-id", "mine", "--results-dir", results, "--base-port", port, *options)
    assert done.returncode == 0, done.stderr
    return results / "mine"


@pytest.fixture(scope="module")
def exported(run: Path) -> Path:
    path = run / "Corridor.onnx"
    done = corridor_here("export", run, "--onnx", path)
    assert done.returncode == 0, done.stderr
    assert list(run.glob("*.tmp")) == []
    return path


def test_names_order_and_types_are_those_of_mlagents_learn(exported):
    model = session(exported)
    assert form(model.get_inputs()) == [("obs_0", ["batch", 13], "tensor(float)")]
    assert form(model.get_outputs()) == [
        ("version_number", [1], "tensor(float)"),
        ("memory_size", [1], "tensor(float)"),
        ("continuous_actions", ["batch", 2], "tensor(float)"),
        ("continuous_action_output_shape", [1], "tensor(float)"),
        ("deterministic_continuous_actions", ["batch", 2], "tensor(float)"),
    ]
    assert [(each.domain, each.version) for each in onnx.load(exported).opset_import] == [("", 9)]


def test_the_constants(exported):
    version, memory, _, size, _ = session(exported).run(None, {"obs_0": np.zeros((3, 13), np.float32)})
    assert (version.tolist(), memory.tolist(), size.tolist()) == ([3.0], [0.0], [2.0])


def test_a_batch_of_4096_gives_the_actions_of_stable_baselines3(run, exported):
    folder = RunFolder(run)
    stages = build_stages(folder.read_config(), _Nobody(16, spec([(13,)], ActionSpec.create_continuous(2))))
    load_trained(folder.read_config(), folder, stages)
    drawn = np.random.default_rng(0).standard_normal((BATCH, 13))
    observations = (3.0 * drawn).astype(np.float32)
    expected, _ = stages.model.predict(stages.normaliser.normalize_obs(observations), deterministic=True)
    found = session(exported).run(["deterministic_continuous_actions"], {"obs_0": observations})[0]
    assert expected.std() > 0.01
    assert np.abs(found - expected).max() <= 1e-5


def test_an_observation_that_hardly_varies_keeps_its_precision():
    behavior = spec([(6,)], ActionSpec.create_continuous(2))
    stages = stages_on(behavior, mean=5.0000001, variance=1e-8)
    observations = (5.0 + 1e-4 * np.random.default_rng(0).standard_normal((BATCH, 6))).astype(np.float32)
    expected, _ = stages.model.predict(stages.normaliser.normalize_obs(observations), deterministic=True)
    found = session(policy_as_onnx(stages, behavior)).run(None, {"obs_0": observations})[-1]
    assert np.abs(found - expected).max() <= 1e-5


def test_actions_are_clipped_and_samples_spread_as_the_policy_does():
    behavior = spec([(2,)], ActionSpec.create_continuous(2))
    stages = stages_on(behavior)
    policy = stages.model.policy
    with torch.no_grad():
        policy.action_net.weight.zero_()
        policy.action_net.bias.copy_(torch.tensor([0.2, 5.0]))
        policy.log_std.copy_(torch.tensor([0.1, 0.1]).log())
    _, _, sampled, _, best = session(policy_as_onnx(stages, behavior)).run(None, {"obs_0": np.zeros((BATCH, 2), "f")})
    assert np.allclose(best, [0.2, 1.0])
    assert sampled.min() >= -1.0
    assert sampled.max() <= 1.0
    assert sampled[:, 0].mean() == pytest.approx(0.2, abs=0.01)
    assert sampled[:, 0].std() == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("branches", [(3,), (3, 2, 4)])
def test_discrete_actions_and_several_observations(branches):
    behavior = spec([(4,), (3,)], ActionSpec.create_discrete(branches))
    stages = stages_on(behavior, mean=0.3, variance=2.0)
    model, choices = session(policy_as_onnx(stages, behavior)), sum(branches)
    assert [node.name for node in model.get_inputs()] == ["obs_0", "obs_1", "action_masks"]
    assert form(model.get_outputs())[2:] == [
        ("discrete_actions", ["batch", len(branches)], "tensor(int64)"),
        ("discrete_action_output_shape", [1, len(branches)], "tensor(float)"),
        ("deterministic_discrete_actions", ["batch", len(branches)], "tensor(int64)"),
    ]
    observations = np.random.default_rng(1).standard_normal((BATCH, 7)).astype(np.float32)
    feed = {"obs_0": observations[:, :4], "obs_1": observations[:, 4:], "action_masks": np.ones((BATCH, choices), "f")}
    _, _, sampled, sizes, best = model.run(None, feed)
    expected, _ = stages.model.predict(stages.normaliser.normalize_obs(observations), deterministic=True)
    assert np.array_equal(best, expected.reshape(BATCH, -1))
    assert len(np.unique(best[:, 0])) > 1
    assert sizes.tolist() == [list(map(float, branches))]
    assert [set(np.unique(column)) for column in sampled.T] == [set(range(size)) for size in branches]
    feed["action_masks"][:, 0] = 0.0
    _, _, sampled, _, best = model.run(None, feed)
    assert 0 not in best[:, 0]
    assert 0 not in sampled[:, 0]


def fails(run: Path, path: Path, says: str) -> None:
    done = corridor_here("export", run, "--onnx", path)
    message = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1, done.stderr
    assert message.startswith("error: ")
    assert says in message
    assert not path.exists()


def copied(run: Path, to: Path) -> tuple[Path, Path]:
    """A run's folder with its own copy of the newest checkpoint."""
    (to / "checkpoints").mkdir(parents=True)
    (to / "configuration.yaml").write_bytes((run / "configuration.yaml").read_bytes())
    source = find_checkpoint(run / "checkpoints")
    target = to / "checkpoints" / source.name
    target.write_bytes(source.read_bytes())
    return to, target


def test_a_broken_checkpoint_is_named(run, tmp_path):
    broken, checkpoint = copied(run, tmp_path / "broken")
    checkpoint.write_bytes(checkpoint.read_bytes()[:1000])
    fails(broken, tmp_path / "a.onnx", "is damaged: it")


def test_a_file_of_somebody_else_in_the_place_of_a_checkpoint(run, tmp_path):
    foreign, checkpoint = copied(run, tmp_path / "foreign")
    torch.save({"model": torch.zeros(3)}, checkpoint)
    fails(foreign, tmp_path / "a.onnx", "is damaged: it has no checksum")


def test_a_checkpoint_of_another_player_names_both_sizes(run, tmp_path):
    other, _ = copied(run, tmp_path / "other")
    record = yaml.safe_load((other / "configuration.yaml").read_text())
    record["behavior"]["observations"][0]["shape"] = [18]
    (other / "configuration.yaml").write_text(yaml.safe_dump(record))
    fails(other, tmp_path / "a.onnx", "is for observations of 13 floats, but the player's have 18")


def test_a_run_that_does_not_say_what_its_policy_observes(run, tmp_path):
    silent, _ = copied(run, tmp_path / "silent")
    record = yaml.safe_load((silent / "configuration.yaml").read_text())
    del record["behavior"]
    (silent / "configuration.yaml").write_text(yaml.safe_dump(record))
    fails(silent, tmp_path / "a.onnx", "does not say what the policy observes and does")


def test_a_folder_that_says_its_preset_observed_pictures(run, tmp_path):
    seeing, _ = copied(run, tmp_path / "seeing")
    record = yaml.safe_load((seeing / "configuration.yaml").read_text())
    record["behavior"]["observations"].append({"name": "CameraSensor", "shape": [84, 84, 3]})
    (seeing / "configuration.yaml").write_text(yaml.safe_dump(record))
    fails(seeing, tmp_path / "a.onnx", "observes shape (84, 84, 3), but policies with a preset observe vectors alone")


def test_a_file_that_cant_be_written(run, tmp_path):
    fails(run, tmp_path / "nowhere" / "a.onnx", "can't be written")


def test_a_policy_of_another_form_says_why():
    behavior = spec([(3,)], ActionSpec.create_continuous(1))
    stages = stages_on(behavior)
    model = SAC("MlpPolicy", _Nobody(1, behavior), buffer_size=10, learning_starts=1)
    with pytest.raises(
        TrainerError, match=r"A policy of SAC \(SACPolicy\) can't be exported; train with ppo, a2c or trpo"
    ):
        policy_as_onnx(dataclasses.replace(stages, model=model), behavior)
