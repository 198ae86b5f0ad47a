"""What a GPU computes: runs on it are as exact as on the CPU, and what they leave is used without one.

CI has no GPU. On a machine with one: ``pytest tests/runs/test_on_a_gpu.py``.
"""

import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from conftest import BIN, corridor_here

from corridor_server.protocol.agents import Behavior, Sensor
from trainer.learning.actor_critic import ActorCritic

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import stop_with
from prepared_run import PreparedRun

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")]
OPTIMA = Path(__file__).parents[1] / "scenes" / "known_optima.py"
PPO = {"batch_size": 32, "buffer_size": 128, "num_epoch": 2}
SAC = {"batch_size": 64, "buffer_size": 2000, "steps_per_update": 4, "save_replay_buffer": True}
CURIOUS = {"extrinsic": {}, "curiosity": {"strength": 0.02}}
NOVEL = {"extrinsic": {}, "rnd": {"strength": 0.02}}
RUNS = {
    "pictures": (["--gym", "minatar.gym:MinAtar/Breakout-v1"], {"hyperparameters": PPO, "reward_signals": NOVEL}),
    "masks": (["--gym", "Taxi-v4"], {"hyperparameters": PPO, "reward_signals": CURIOUS}),
    "sac": (["--gym", "Pendulum-v1"], {"trainer_type": "sac", "hyperparameters": SAC, "reward_signals": CURIOUS}),
}
GOAL_SIGNAL = 1
SENSORS = (
    Sensor.of("vector", (5,)),
    Sensor.of("picture", (36, 36, 3)),
    Sensor.of("others", (6, 4)),
    Sensor.of("goal", (3,))._replace(kind=GOAL_SIGNAL),
)


@pytest.fixture(autouse=True)
def _programs_on_the_path(monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")


def serve(folder, served):
    """A player of an environment."""
    player = folder / "player"
    player.write_text(f'#!/bin/sh\nexec {BIN / "corridor-server"} {" ".join(served)} "$@"\n')
    player.chmod(0o755)
    return player


def write(folder, settings, **more):
    path = folder / "settings.yaml"
    common = {"max_steps": 1600, "summary_freq": 400, "time_horizon": 16, "network_settings": {"hidden_units": 64}}
    path.write_text(yaml.safe_dump({"default_settings": {**common, **settings, **more}}))
    return path


@pytest.mark.parametrize("what", RUNS)
def test_a_run_ends_as_another_of_its_seed_that_was_killed_on_the_way(what, tmp_path, free_port):
    served, settings = RUNS[what]
    file = write(tmp_path, settings)
    options = (file, "--device", "cuda", "--num-areas", 4, "--eval-episodes", 2, "--env", serve(tmp_path, served))
    whole, cut = (PreparedRun(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGKILL, 600, 0.01) == -signal.SIGKILL
    assert cut.finish("--resume") == 0, cut.output
    mine, theirs = cut.summary(), whole.summary()
    assert mine["resumes"] == 1
    assert mine["behaviors"] == theirs["behaviors"], "policy_sha256, evaluation, steps and episodes of each"


def test_what_was_trained_there_goes_on_and_is_played_and_exported_without_one(tmp_path, free_port):
    served, settings = RUNS["pictures"]
    given = ("--results-dir", tmp_path, "--base-port", free_port, "--env", serve(tmp_path, served))
    run = ("--run-id", "r", "--num-areas", 4, "--eval-episodes", 2, *given)
    done = corridor_here("train", write(tmp_path, settings), "--device", "cuda", *run)
    assert done.returncode == 0, done.stderr
    longer = write(tmp_path, settings, max_steps=2400)
    done = corridor_here("train", longer, "--device", "cpu", "--resume", *run)
    assert done.returncode == 0, done.stderr
    assert "2,400" in done.stdout + done.stderr
    for command in (
        ("evaluate", "r", "--episodes", 2, *given),
        ("export", "r", "--onnx", tmp_path / "r.onnx", *given[:2]),
    ):
        done = corridor_here(*command)
        assert done.returncode == 0, done.stderr


def test_buffers_goals_and_hybrid_actions_learn_there(tmp_path, free_port):
    settings = {
        "hyperparameters": {"batch_size": 256, "buffer_size": 2048, "learning_rate": 2e-3, "beta": 1e-3},
        "network_settings": {"hidden_units": 64},
    }
    options = (write(tmp_path, settings, max_steps=40_000), "--device", "cuda", "--num-areas", 32, "--env", OPTIMA)
    given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--eval-episodes", 200)
    done = corridor_here("train", *options, *given)
    assert done.returncode == 0, done.stderr
    behaviors = yaml.safe_load((tmp_path / "r" / "summary.json").read_text())["behaviors"]
    returns = {name: each["evaluation"]["mean_return"] for name, each in behaviors.items()}
    assert len(returns) == 3
    assert min(returns.values()) > 0.7, returns


@pytest.mark.parametrize("encoder", ["simple", "nature_cnn", "resnet", "match3"])
def test_networks_compute_what_the_cpu_computes(encoder, monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)  # torch's default: 10 bits, in convolutions
    behavior = Behavior("any", SENSORS, 2, (3, 4))
    torch.manual_seed(3)
    here = ActorCritic(behavior, hidden_units=32, vis_encode_type=encoder)
    there = ActorCritic(behavior, hidden_units=32, vis_encode_type=encoder)
    there.load_state_dict(here.state_dict())
    there.to("cuda")
    rng = np.random.default_rng(0)
    observations = [torch.from_numpy(rng.random((64, *each.shape), np.float32)) for each in SENSORS]
    allowed = torch.from_numpy(rng.random((64, 7)) < 0.7)
    acted = here.act(observations, allowed)
    found = []
    for network, device in ((here, "cpu"), (there, "cuda")):
        values, log_probs, entropy = network.evaluate(
            [each.to(device) for each in observations],
            allowed.to(device),
            acted.continuous.to(device),
            acted.discrete.to(device),
        )
        (values.sum() + log_probs.sum() + entropy.sum()).backward()
        gradients = [each.grad.cpu() for each in network.parameters() if each.grad is not None]
        found.append([each.detach().cpu() for each in (values, log_probs, entropy)] + gradients)
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(other, one, rtol=1e-3, atol=1e-4)
    on_gpu = there.act([each.to("cuda") for each in observations], allowed.to("cuda"))
    chosen = torch.stack([on_gpu.discrete[:, 0], on_gpu.discrete[:, 1] + 3], dim=1).cpu()
    assert allowed.gather(1, chosen)[allowed[:, :3].any(1) & allowed[:, 3:].any(1)].all()
