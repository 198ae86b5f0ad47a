"""``corridor replay`` as a user runs it."""

import json
import re

import imageio.v3 as imageio
import numpy as np
import pytest
from conftest import corridor_here
from PIL import Image
from recorded_run import recorded_run

from corridor_server.corridor.gym_env import CorridorEnv
from trainer.commands.train import Train
from trainer.errors import TrainerError
from trainer.runs.evaluation import Episode
from trainer.runs.folder import RunFolder
from trainer.runs.trajectories import Trajectories, load_trajectories
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.document import page


def page_data(text: str) -> dict:
    return json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text)[1])


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> RunFolder:
    """A real run, as short as a run can be, and evaluated on 12 episodes."""
    results = tmp_path_factory.mktemp("results")
    options = ["--results-dir", results, "--base-port", 5745, "--num-areas", 8, "--num-envs", 2]
    options += ["--env-param", "opponent_speed=1.3", "max_episode_steps=60", "--penalty", 0.3]
    done = corridor_here("train", "--run-id", "r", *options, "--steps", 3000, "--eval-episodes", 12)
    assert done.returncode == 0, done.stderr
    return RunFolder(results / "r")


def test_a_replay_is_a_page_a_gif_and_a_film_of_the_evaluation(trained):
    done = corridor_here("replay", "r", "--results-dir", trained.path.parent)
    assert done.returncode == 0, done.stderr
    recorded = load_trajectories(trained.trajectories)
    html = (trained.path / "replay.html").read_text()
    data = page_data(html)
    assert data["scene"] == json.loads(json.dumps(run_scene(trained.read_config(), recorded)))
    assert data["scene"]["notes"] == []  # lived through again in process, bit for bit
    summary = json.loads(trained.summary.read_text())
    returns = [record["return"] for record in data["scene"]["episodes"]]
    assert np.mean(returns) == pytest.approx(summary["evaluation"]["mean_return"], abs=1e-12)
    lengths = [record["length"] for record in data["scene"]["episodes"]]
    assert np.mean(lengths) == summary["evaluation"]["mean_episode_length"]

    shown = min(data["scene"]["episodes"], key=lambda record: (record["outcome"] != "goal", record["closest"]))
    gif = Image.open(trained.path / "replay.gif")
    assert gif.n_frames > 2
    seconds = 0
    for frame in range(gif.n_frames):
        gif.seek(frame)
        seconds += gif.info["duration"] / 1000
    assert seconds == pytest.approx(0.1 * (shown["length"] + 1) + 1.5, abs=0.11)
    film = imageio.immeta(trained.path / "replay.mp4", plugin="FFMPEG")
    assert film["duration"] == pytest.approx(0.1 * shown["length"] + 1.5, abs=0.2)
    assert film["size"] == gif.size


def test_a_checkpoint_is_played_by_name(trained):
    steps = json.loads(trained.summary.read_text())["env_steps"]
    before = trained.trajectories.read_bytes()
    options = ["--results-dir", trained.path.parent, "--base-port", 5745, "--episodes", 5]
    done = corridor_here("replay", "r", "--checkpoint", f"step-{steps}", *options)
    assert done.returncode == 0, done.stderr
    scene = page_data((trained.path / f"replay-step-{steps}.html").read_text())["scene"]
    assert scene["env_steps"] == steps
    assert len(scene["episodes"]) == 5
    assert trained.trajectories.read_bytes() == before  # the run's own evaluation stays
    done = corridor_here("replay", "r", "--checkpoint", "step-77", *options)
    assert done.returncode == 1
    assert f"step-{steps}" in done.stderr


def test_the_networks_values_and_rewards_are_recorded_and_a_checkpoint_gives_them_again(trained):
    """From memory after training, and from the checkpoint's curiosity module and critic."""
    before = trained.trajectories.read_bytes()
    recorded = load_trajectories(trained.trajectories).episodes
    options = ["--results-dir", trained.path.parent, "--base-port", 5745, "--episodes", 12]
    try:
        assert corridor_here("evaluate", "r", *options).returncode == 0
        again = load_trajectories(trained.trajectories).episodes
    finally:
        trained.trajectories.write_bytes(before)
    for one, other in zip(recorded, again, strict=True):
        assert len(one.values) == len(one.observations)
        assert len(one.intrinsic_rewards) == len(one.rewards)
        assert (one.intrinsic_rewards > 0).all()
        assert np.ptp(one.values) > 0
        assert np.array_equal(one.values, other.values)
        assert np.array_equal(one.intrinsic_rewards, other.intrinsic_rewards)


def test_a_run_without_evaluation_is_played(trained):
    trained.trajectories.rename(trained.path / "kept.npz")
    try:
        done = corridor_here("replay", "r", "--results-dir", trained.path.parent, "--base-port", 5745, "--episodes", 3)
        assert done.returncode == 0, done.stderr
        assert "This run has no evaluation" in done.stdout
        assert page_data((trained.path / "replay.html").read_text())["scene"]["env_steps"] >= 3000
    finally:
        (trained.path / "kept.npz").rename(trained.trajectories)


def test_nothing_to_show_is_one_sentence(tmp_path):
    empty = recorded_run(tmp_path, "empty", evaluated=False)
    broken = recorded_run(tmp_path, "broken")
    broken.trajectories.write_bytes(broken.trajectories.read_bytes()[:5000])
    for arguments, sentence in [
        (("replay", "nobody"), "No run 'nobody'"),
        (("replay", "empty"), f"{empty.checkpoints} holds no checkpoint"),
        (("replay", "broken"), f"{broken.trajectories} is broken"),
        (("replay", "broken", "--episodes", 0), "--episodes is 0"),
    ]:
        done = corridor_here(*arguments, "--results-dir", tmp_path)
        assert done.returncode == 1
        assert sentence in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1


def test_a_page_of_20_of_the_longest_episodes_is_below_a_megabyte_and_a_half():
    """Of noise, as far as a corridor lets there be any: it doesn't compress."""
    rng = np.random.default_rng(0)
    episodes = []
    for area in range(20):
        env = CorridorEnv(area=area, failure_return=-1e6, goal_radius=0.0, max_episode_steps=1000)
        observations, rewards = [env.reset(seed=1)[0]], []
        actions = rng.uniform(-1, 1, (1000, 2)).astype(np.float32)
        for action in actions:
            observation, reward, *_ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
        noise = rng.normal(size=1001).astype(np.float32)
        statistics = {"Corridor/Success": 0.0}
        episodes.append(
            Episode(
                np.array(observations), actions, np.array(rewards, np.float32), True, area, statistics, noise, noise[1:]
            )
        )
    scene = run_scene(Train(run_id="x").run_config(), Trajectories("Corridor", None, 0, episodes))
    assert all(record["length"] == 1000 and "value" in record["columns"] for record in scene["episodes"])
    assert len(page({"mode": "replay", "scene": scene}).encode()) < 1_500_000


def test_the_page_asks_for_nothing_and_a_name_cant_leave_its_place():
    html = page({"mode": "watch", "token": "t", "results": "</script><script>alert(1)</script>"})
    assert page_data(html)["results"] == "</script><script>alert(1)</script>"
    assert html.count("<script") == 2
    assert not re.search(r'(?:src|href)="(?!data:)', html)


def test_a_checkpoints_name_may_be_short(tmp_path):
    from trainer.runs.checkpoint import find_checkpoint

    for steps in (500, 1000):
        (tmp_path / f"step-{steps:010d}.safetensors").touch()
    for name in ("step-500", "500", "step-0000000500", "step-0000000500.safetensors"):
        assert find_checkpoint(tmp_path, name).name == "step-0000000500.safetensors"
    assert find_checkpoint(tmp_path).name == "step-0000001000.safetensors"
    with pytest.raises(TrainerError, match="there are: step-500, step-1000"):
        find_checkpoint(tmp_path, "step-750")
