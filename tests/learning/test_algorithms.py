"""Every algorithm of section III-A trains on the same stages, and RND gives an intrinsic reward beside ICM."""

import dataclasses
import json

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3 import A2C, DDPG
from stable_baselines3.common.env_util import make_vec_env

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.hyperparameters import CuriosityConfig, DDPGConfig
from trainer.learning.rnd import RandomNetworkDistillation
from trainer.learning.stages import Stages, build_stages
from trainer.main import main
from trainer.presets import preset_run

BOX = spaces.Box(-1, 1, (2,), np.float32)


def config(algo="ppo", c=0.3, **options) -> RunConfig:
    return preset_run("any", "fast", c=c, seed=1, steps=1000, algo=algo, num_areas=4, **options)


def stages(env_id: str = "Pendulum-v1", **options) -> Stages:
    return build_stages(config(**options), make_vec_env(env_id, 4, seed=1))


@pytest.mark.parametrize("algo", ["ppo", "a2c", "trpo", "ddpg"])
@pytest.mark.parametrize("c", [0.0, 0.3])
def test_every_algorithm_trains_on_the_same_stages(algo, c):
    settings = config(algo, c)
    if algo == "ddpg":
        settings = dataclasses.replace(settings, other=DDPGConfig(learning_starts=100))
    built = build_stages(settings, make_vec_env("Pendulum-v1", 4, seed=1))
    before = {name: value.clone() for name, value in built.model.policy.state_dict().items()}
    built.model.learn(600)
    after = built.model.policy.state_dict()
    assert any((before[name] != after[name]).any() for name in before)
    if c:
        assert built.curiosity is not None
        assert built.curiosity.metrics["reward"] > 0


@pytest.mark.parametrize("algo", ["ppo", "a2c", "trpo", "ddpg"])
def test_its_configuration_is_read_as_it_was_written(algo):
    written = config(algo=algo, intrinsic="rnd")
    assert RunConfig.from_dict(json.loads(json.dumps(written.as_dict()))) == written


class Still(gymnasium.Env):
    """Pays nothing, ever."""

    observation_space, action_space = spaces.Box(-1, 1, (3,), np.float32), BOX

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.random(3, np.float32), {}

    def step(self, action):
        return self.np_random.random(3, np.float32), 0.0, False, False, {}


def test_what_ddpg_remembers_has_the_intrinsic_reward_in_it():
    built = build_stages(config("ddpg"), make_vec_env(Still, 4, seed=1))
    built.model.learn(400)
    assert isinstance(built.model, DDPG)
    assert built.model.replay_buffer is not None
    assert (built.model.replay_buffer.rewards[:100] > 0).all()


def test_curiosity_learns_with_every_update_of_a2c():
    built = stages(algo="a2c")
    assert isinstance(built.model, A2C)
    assert built.curiosity is not None
    built.model.learn(5 * 4)
    first = built.curiosity.metrics
    assert first
    built.model.learn(5 * 4)
    assert built.curiosity.metrics != first


def test_ddpg_takes_continuous_actions_only():
    with pytest.raises(TrainerError, match=r"DDPG takes continuous actions, not Discrete\(2\)"):
        stages("CartPole-v1", algo="ddpg")


def test_a_ddpg_run_can_be_evaluated_but_not_continued(tmp_path, free_port, capsys):
    options = ["--run-id", "d", "--algo", "ddpg", "--results-dir", str(tmp_path), "--base-port", str(free_port)]
    options += ["--steps", "2000", "--num-areas", "8", "--eval-episodes", "2"]
    assert main(["train", *options]) == 0
    summary = json.loads((tmp_path / "d" / "summary.json").read_text())
    assert summary["algo"] == "ddpg"
    evaluate = ["evaluate", "d", "--episodes", "2", "--results-dir", str(tmp_path), "--base-port", str(free_port)]
    assert main(evaluate) == 0
    assert f"{summary['evaluation']['mean_return']:g}" in capsys.readouterr().out
    assert main(["train", *options, "--resume"]) == 1
    assert "replay buffer is not kept" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_other_on_policy_runs_can_be_continued(tmp_path, free_port):
    options = ["--run-id", "r", "--algo", "trpo", "--results-dir", str(tmp_path), "--base-port", str(free_port)]
    options += ["--num-areas", "64", "--eval-episodes", "2"]
    assert main(["train", *options, "--steps", "2000"]) == 0
    assert main(["train", *options, "--steps", "4000", "--resume"]) == 0
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["env_steps"] >= 4_000


def distillation() -> RandomNetworkDistillation:
    settings = CuriosityConfig(feature_size=2, hidden_size=3, learning_rate=1e-2)
    return RandomNetworkDistillation(2, BOX, settings, np.random.default_rng(0))


def test_rnd_is_half_the_squared_error_for_the_next_observation():
    module = distillation()
    s, action, s_next = np.zeros((1, 2), np.float32), np.zeros((1, 2), np.float32), np.float32([[0.5, -1.0]])
    outputs = [
        network.weights[1] @ np.tanh(network.weights[0] @ s_next[0] + network.biases[0]) + network.biases[1]
        for network in (module.predictor, module.target)
    ]
    expected = 0.5 * np.sum((outputs[0] - outputs[1]) ** 2)
    assert module.intrinsic_reward(s, action, s_next)[0] == pytest.approx(expected, rel=1e-5)


def test_rnd_gets_used_to_what_it_sees_and_to_nothing_else():
    module = distillation()
    action, seen, unseen = (
        np.zeros((8, 2), np.float32),
        np.full((8, 2), 0.5, np.float32),
        np.full((8, 2), -3, np.float32),
    )
    fixed = module.target.weights[0].copy()
    before = [module.intrinsic_reward(seen, action, where)[0] for where in (seen, unseen)]
    losses = [module.learn(seen, action, seen)["rnd_loss"] for _ in range(300)]
    after = [module.intrinsic_reward(seen, action, where)[0] for where in (seen, unseen)]
    assert losses[0] == pytest.approx(before[0], rel=1e-5)
    assert after[0] < 1e-3 * before[0]
    assert after[1] > 0.2 * before[1]
    assert (module.target.weights[0] == fixed).all()


def test_rnd_takes_the_place_of_icm():
    built = stages(intrinsic="rnd")
    assert built.curiosity is not None
    assert isinstance(built.curiosity.module, RandomNetworkDistillation)
    built.model.learn(128)
    assert set(built.curiosity.metrics) == {"rnd_loss", "reward"}
