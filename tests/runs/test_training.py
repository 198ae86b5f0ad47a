"""``corridor train`` and ``corridor evaluate``: real players and files, and a process where signals or deaths come."""

import csv
import json
import shutil
import signal
import subprocess
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml
from asked import asked
from conftest import WITH_ROWS, corridor_here, unused_port
from prepared import Prepared
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import DummyVecEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from trainer.errors import TrainerError
from trainer.learning.deferring import Deferring
from trainer.learning.normaliser import ObservationStatistics
from trainer.learning.stages import build_stages
from trainer.runs.logs import PROGRESS_COLUMNS

ROW_STEPS = 500  # as corridor_with_rows has it
SHORT = ("--steps", 4_000, "--num-areas", 16, "--eval-episodes", 20)
TIMING = {"steps_per_second", "wall_seconds"}


def train(run_id: str, results: Path, port: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    return corridor_here("train", "--run-id", run_id, "--results-dir", results, "--base-port", port, *arguments)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def processes(port: int) -> str:
    return subprocess.run(["pgrep", "-af", f"mlagents-port {port}"], capture_output=True, text=True).stdout


@pytest.fixture(autouse=True)
def _rows_in_short_runs(monkeypatch):
    monkeypatch.setattr("trainer.runs.callbacks.ROW_STEPS", ROW_STEPS)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the default preset, in a process of its own; most others are trained in that of the tests."""
    results = tmp_path_factory.mktemp("results")
    given = ["train", "--run-id", "short", "--results-dir", results, "--base-port", unused_port(), *SHORT]
    process = Prepared([WITH_ROWS, *given])
    assert process.wait(300) == 0, process.said()
    return results / "short"


def test_a_run_leaves_its_files(run):
    for name in ("configuration.yaml", "summary.json", "progress.csv", "learning_curve.png", "episode_paths.png"):
        assert (run / name).stat().st_size > 100, name
    assert list((run / "checkpoints").glob("step-*.safetensors"))
    assert (run / "run_logs" / "Player-0.log").exists()


def test_the_summary_has_the_contracts_keys(run):
    summary = json.loads((run / "summary.json").read_text())
    assert list(summary)[:14] == [
        "run_id", "env", "preset", "algo", "seed", "c", "penalty", "env_steps", "episodes", "wall_seconds",
        "steps_per_second", "steps_to_50_success", "steps_to_90_success", "evaluation",
    ]  # fmt: skip
    assert summary["env_steps"] >= 4_000
    evaluation = summary["evaluation"]
    assert list(evaluation) == [
        "episodes", "success_rate", "mean_return", "mean_episode_length", "opponent_contact_rate", "wall_contact_rate",
        "mean_success_length", "success_unknown",
    ]  # fmt: skip
    assert evaluation["episodes"] == 20
    assert (evaluation.pop("mean_success_length") is None) == (evaluation["success_rate"] == 0)
    assert all(isinstance(value, int | float) for value in evaluation.values())
    assert 0.0 < summary["exchange_share"] < 1.0


def test_the_configuration_is_enough_to_run_it_again(run):
    record = yaml.safe_load((run / "configuration.yaml").read_text())
    assert record["run"]["seed"] == 0
    assert record["run"]["curiosity"]["c"] == 0.3
    assert record["versions"]["mlagents-envs"] == "0.28.0"


def test_tensorboard_has_sb3s_and_ml_agents_tags(run):
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    tags = set(events.Tags()["scalars"])
    assert {
        "rollout/ep_rew_mean",
        "train/approx_kl",
        "Environment/Cumulative Reward",
        "Environment/Episode Length",
        "Policy/Extrinsic Reward",
        "Policy/Curiosity Reward",
        "Losses/Curiosity Forward Loss",
        "Losses/Curiosity Inverse Loss",
    } <= tags


def test_the_same_seed_gives_the_same_progress(run, free_port):
    results = run.parent
    again = train("again", results, free_port, *SHORT)
    assert again.returncode == 0, again.stderr
    first, second = rows(run / "progress.csv"), rows(results / "again" / "progress.csv")
    assert len(first) >= 4
    assert list(first[0]) == list(PROGRESS_COLUMNS)
    for one, other in zip(first, second, strict=True):
        assert {k: v for k, v in one.items() if k not in TIMING} == {k: v for k, v in other.items() if k not in TIMING}
    summaries = [json.loads((results / name / "summary.json").read_text()) for name in ("short", "again")]
    assert summaries[0]["evaluation"] == summaries[1]["evaluation"]


def test_another_seed_gives_another_run(run, free_port):
    results = run.parent
    other = train("other", results, free_port, "--steps", 4_000, "--num-areas", 16, "--seed", 7, "--eval-episodes", 1)
    assert other.returncode == 0, other.stderr
    first = {row["env_steps"]: row["mean_return"] for row in rows(run / "progress.csv")}
    second = {row["env_steps"]: row["mean_return"] for row in rows(results / "other" / "progress.csv")}
    both = [steps for steps in first.keys() & second.keys() if first[steps] and second[steps]]
    assert both
    assert all(first[steps] != second[steps] for steps in both)


def test_evaluate_repeats_the_evaluation(run, free_port):
    done = corridor_here("evaluate", "short", "--episodes", 20, "--results-dir", run.parent, "--base-port", free_port)
    assert done.returncode == 0, done.stderr
    evaluation = json.loads((run / "summary.json").read_text())["evaluation"]
    for name in ("success_rate", "mean_return", "mean_episode_length"):
        assert f"{evaluation[name]:g}" in done.stdout


def test_evaluate_plays_the_checkpoint_that_is_named(run, tmp_path, free_port):
    copy = shutil.copytree(run, tmp_path / "short")
    (newest,) = (copy / "checkpoints").glob("step-*.safetensors")
    newest.rename(newest.with_stem("step-0000000001"))
    newest.write_bytes(b"damaged")
    options = ("--episodes", 20, "--results-dir", tmp_path, "--base-port", free_port)
    assert "is damaged" in corridor_here("evaluate", "short", *options).stderr
    assert "there are: step-1, " in corridor_here("evaluate", "short", "--checkpoint", "step-2", *options).stderr
    done = corridor_here("evaluate", "short", "--checkpoint", "step-1", *options)
    assert done.returncode == 0, done.stderr
    assert f"{json.loads((run / 'summary.json').read_text())['evaluation']['mean_return']:g}" in done.stdout


def test_base_ppo_has_no_curiosity_and_case_study_b_no_failure_penalty(tmp_path, free_port):
    options = ("--c", 0, "--penalty", 0, "--steps", 4_000, "--num-areas", 8, "--eval-episodes", 1)
    done = train("base", tmp_path, free_port, *options)
    assert done.returncode == 0, done.stderr
    progress = rows(tmp_path / "base" / "progress.csv")
    assert {row["intrinsic_reward"] for row in progress} == {""}
    returns = [float(row["mean_return"]) for row in progress if row["mean_return"]]
    assert returns
    assert min(returns) > -1.5


def test_the_paper_preset_goes_through_the_gym_wrapper(tmp_path, free_port):
    done = train("paper", tmp_path, free_port, "--preset", "paper", "--steps", 256, "--eval-episodes", 1)
    assert done.returncode == 0, done.stderr
    record = yaml.safe_load((tmp_path / "paper" / "configuration.yaml").read_text())
    assert record["run"]["through_gym"] is True
    assert record["run"]["num_areas"] == 1
    summary = json.loads((tmp_path / "paper" / "summary.json").read_text())
    assert summary["evaluation"]["success_rate"] is not None


def test_ctrl_c_saves_and_leaves_nothing_behind_and_resume_goes_on(tmp_path, free_port):
    options = ["--run-id", "cut", "--results-dir", str(tmp_path), "--base-port", str(free_port), "--num-areas", "8"]
    process = Prepared([WITH_ROWS, "train", *options, "--steps", 5_000])
    progress = tmp_path / "cut" / "progress.csv"
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not (progress.exists() and len(rows(progress)) >= 1):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "go on with --resume" in output
    assert processes(free_port) == ""
    cut = json.loads((tmp_path / "cut" / "summary.json").read_text())
    assert 0 < cut["env_steps"] < 5_000
    assert cut["evaluation"] is None

    resumed = corridor_here("train", *options, "--steps", 5_000, "--eval-episodes", 1, "--resume")
    assert resumed.returncode == 0, resumed.stderr
    summary = json.loads((tmp_path / "cut" / "summary.json").read_text())
    assert summary["env_steps"] >= 5_000
    assert summary["episodes"] > cut["episodes"]
    steps = [float(row["env_steps"]) for row in rows(progress)]
    assert steps == sorted(set(steps))


def test_a_player_that_dies_ends_the_run_with_a_sentence_and_its_data(tmp_path, free_port):
    process = Prepared(
        [WITH_ROWS, "train", "--run-id", "dies", "--results-dir", tmp_path, "--base-port", free_port,
         "--num-areas", 8, "--max-lifetime-restarts", 0]
    )  # fmt: skip
    progress = tmp_path / "dies" / "progress.csv"
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not (progress.exists() and len(rows(progress)) >= 1):
        time.sleep(0.1)
    subprocess.run(["pkill", "-9", "-f", f"mlagents-port {free_port}"], check=True)
    errors, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Environment shut down with return code -9 (SIGKILL)." in errors
    assert "is not started again: --max-lifetime-restarts allows 0." in errors
    assert "Traceback" not in errors
    assert list((tmp_path / "dies" / "checkpoints").glob("step-*.safetensors"))
    assert rows(progress)


def stages_on(env_id: str, c: float):
    return build_stages(asked("any", c=c, num_areas=4).run_config(), make_vec_env(env_id, 4))


@pytest.mark.parametrize("c", [0.0, 0.3])
def test_environments_with_discrete_actions_train_too(c):
    stages = stages_on("CartPole-v1", c)
    stages.model.learn(128)
    assert type(stages.model) is PPO


def test_curiosity_on_branched_actions_says_what_to_do():
    class Branched(gymnasium.ActionWrapper):
        def __init__(self) -> None:
            super().__init__(gymnasium.make("CartPole-v1"))
            self.action_space = gymnasium.spaces.MultiDiscrete([2, 3])

    config = asked("any", num_areas=4).run_config()
    with pytest.raises(TrainerError, match=r"takes Box or Discrete actions.* --c 0"):
        build_stages(config, make_vec_env(Branched, 4))


class Telling(DummyVecEnv):
    """One environment that writes down what it is asked, and refuses NaN."""

    def __init__(self, told: list[str]) -> None:
        super().__init__([lambda: gymnasium.make("Pendulum-v1")])
        self.told = told

    def step_async(self, actions):
        if not np.isfinite(actions).all():
            raise TrainerError("no number")
        self.told.append("send")
        super().step_async(actions)

    def step_wait(self):
        self.told.append("wait")
        return super().step_wait()


def test_what_was_deferred_is_done_once_while_the_player_moves():
    told: list[str] = []
    stage = Deferring(Telling(told))
    stage.reset()
    stage.defer(lambda: told.append("save"))
    for _ in range(2):
        stage.step(np.zeros((1, 1), np.float32))
    assert told == ["send", "save", "wait", "send", "wait"]


def test_what_was_deferred_is_done_even_if_the_actions_cant_be_sent():
    told: list[str] = []
    stage = Deferring(Telling(told))
    stage.reset()
    stage.defer(lambda: told.append("save"))
    with pytest.raises(TrainerError, match="no number"):
        stage.step(np.full((1, 1), np.nan, np.float32))
    assert told == ["save"]


@pytest.mark.parametrize(("rows", "kind"), [(1, np.float32), (64, np.float32), (1000, np.float32), (64, np.float64)])
def test_the_normalisers_statistics_are_sb3s_to_the_bit(rows, kind):
    ours, theirs, generator = ObservationStatistics(shape=(13,)), RunningMeanStd(shape=(13,)), np.random.default_rng(0)
    for _ in range(20):
        observations = generator.normal(3.0, 2.0, (rows, 13)).astype(kind)
        ours.update(observations), theirs.update(observations)
        assert np.array_equal(ours.mean, theirs.mean)
        assert np.array_equal(ours.var, theirs.var)
        assert ours.count == theirs.count
