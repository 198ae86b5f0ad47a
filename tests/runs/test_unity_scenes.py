"""``corridor train`` on scenes as Unity has them: other areas than asked for, step limits, behaviors of any name."""

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from asked import asked
from conftest import BIN
from raw_player import events, write_player
from recorded_run import begun_run

from trainer.config import RunConfig
from trainer.main import main
from trainer.runs.callbacks import CountEpisodes
from trainer.runs.counters import Counters
from trainer.runs.evaluation import Episode, summarise
from trainer.runs.folder import RunFolder
from trainer.runs.progress import Snapshot


@pytest.fixture
def train(tmp_path, free_port, capsys, monkeypatch) -> Callable[..., str]:
    """Trains the run ``r`` on a player; what was printed."""
    monkeypatch.setenv("COLUMNS", "200")

    def train(player: Path, *arguments: object) -> str:
        given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--eval-episodes", 6)
        assert main(["train", *map(str, (*given, "--env", player, *arguments))]) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    return train


def record(folder: Path) -> dict:
    return yaml.safe_load((folder / "r" / "configuration.yaml").read_text())


def test_a_scene_that_ignores_num_areas_trains_says_so_resumes_and_exports(train, tmp_path):
    player, _ = write_player(tmp_path)
    done = train(player, "--num-areas", 64, "--steps", 200)
    said = "Areas asked for: 64 per player (--num-areas); agents that came, and are trained with: 1; a scene makes"
    assert [said in line for line in done.splitlines()].count(True) == 1
    assert (record(tmp_path)["run"]["num_areas"], record(tmp_path)["agents_per_player"]) == (64, 1)
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert summary["env_steps"] == 200, "of the one agent that came"
    train(player, "--num-areas", 64, "--steps", 400, "--resume")
    assert record(tmp_path)["agents_per_player"] == 1
    assert main(["export", str(tmp_path / "r"), "--onnx", str(tmp_path / "raw.onnx")]) == 0


@pytest.mark.parametrize(("preset", "own"), [("fast", {}), ("paper", {}), ("threshold", {"half_width": 6.5})])
def test_a_build_with_a_corridor_is_told_the_presets_before_training_begins(train, tmp_path, preset, own):
    player, log = write_player(tmp_path, behavior="Corridor?team=0", size=13)
    given = ("--env-param", "gravity=2", "goal_x=6", "--penalty", 0.5, "--preset", preset)
    areas = () if preset == "paper" else ("--num-areas", 1)
    train(player, *given, *areas, "--steps", 40)
    told = events(log, "reset")
    assert told[0] == {"gravity": 2.0, "goal_x": 6.0}
    assert {"failure_penalty": 0.5, "agent_speed": 3.0, "goal_radius": 2.0, **own}.items() <= told[1].items()
    assert "goal_x" not in told[1]


def test_any_other_behavior_is_told_only_what_was_given(train, tmp_path):
    player, log = write_player(tmp_path, agents=2)
    done = train(player, "--env-param", "gravity=2", "--num-areas", 2, "--steps", 40)
    assert "Areas asked for" not in done, "as many came"
    told = [each for each in events(log, "reset") if each]
    assert told == [{"gravity": 2.0}] * 2, "at the first reset, in training and in evaluation"


def test_random_network_distillation_without_a_strength_is_refused(tmp_path, free_port, capsys):
    player, _ = write_player(tmp_path)
    given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--env", player, "--steps", 40)
    assert main(["train", *map(str, given), "--intrinsic", "rnd"]) == 1
    assert "--intrinsic rnd has no effect on " in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


def test_a_corridor_that_a_file_lists_has_its_penalty(tmp_path, free_port):
    (tmp_path / "it.yaml").write_text("behaviors: {Corridor: {max_steps: 64, hyperparameters: {batch_size: 8}}}")
    given = ("--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--num-areas", 2)
    assert main(["train", str(tmp_path / "it.yaml"), *map(str, given), "--penalty", "0", "--eval-episodes", "1"]) == 0


@pytest.mark.slow
def test_the_file_in_the_docs_trains_without_unity(train, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "mlagents.md").read_text()
    text = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)[0]
    (tmp_path / "it.yaml").write_text(text)
    train(BIN / "corridor-server", tmp_path / "it.yaml", "--steps", 1_500, "--env-args", "--gym", "Pendulum-v1")
    settings = record(tmp_path)["behaviors"]["Pendulum-v1"]
    assert (settings["max_steps"], settings["hyperparameters"]["buffer_size"]) == (1_500, 1024)
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert summary["behaviors"]["Pendulum-v1"]["updates"] == 2


def test_success_is_of_all_episodes_or_unknown(train, tmp_path):
    """Two of three episodes are cut by a step limit and report nothing: 100% of the rest is no rate."""
    player, _ = write_player(tmp_path, success=(1.0, None, None))
    done = train(player, "--preset", "fast", "--num-areas", 1, "--steps", 200)
    assert "success unknown for " in done
    assert "100%" not in done
    assert "unknown for 4 of 6" in done
    with (tmp_path / "r" / "progress.csv").open(newline="") as file:
        assert {row["success_rate"] for row in csv.DictReader(file)} <= {""}
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert (summary["evaluation"]["success_rate"], summary["evaluation"]["success_unknown"]) == (None, 4)
    assert summary["steps_to_50_success"] is None


def test_success_that_every_episode_reports_is_a_rate(train, tmp_path):
    player, _ = write_player(tmp_path, success=(1.0, 1.0, 0.0))
    done = train(player, "--preset", "fast", "--num-areas", 1, "--steps", 200)
    assert "success 67%" in done
    evaluation = json.loads((tmp_path / "r" / "summary.json").read_text())["evaluation"]
    assert (evaluation["success_rate"], evaluation["success_unknown"]) == (pytest.approx(2 / 3), 0)


def test_a_run_of_before_these_settings_were_recorded_is_the_same_and_resumes(tmp_path):
    config = asked("r", env="Other.x86_64").run_config()
    folder = begun_run(config, tmp_path)
    written = yaml.safe_load(folder.configuration.read_text())
    del written["run"]["preset_parameters"], written["run"]["graphics"]
    written["run"]["engine"]["time_scale"] = 0.5
    folder.configuration.write_text(yaml.safe_dump(written))
    again = asked("r", env="Other.x86_64", graphics=True).run_config()
    with RunFolder.claim(again, tmp_path, resume=True, force=False):
        pass
    del written["run"]["engine"]
    assert RunConfig.from_dict(written["run"]) == config, "a study goes on with the runs that it has"


def counted(*successes: bool | None) -> CountEpisodes:
    episodes = CountEpisodes(Counters())
    for success in successes:
        info = {"episode": {"r": 1.0, "l": 5}} | ({} if success is None else {"is_success": success})
        episodes.locals = {"infos": [info]}
        episodes._on_step()
        assert "is_success" not in info, "Stable-Baselines3 would log the rate of those that report"
    return episodes


def test_the_last_episodes_have_a_rate_once_all_of_them_report():
    assert "success" not in counted(True, None, False).means()
    assert counted(True, None, False).unknown() == (1, 3)
    assert counted(True, False).means()["success"] == 0.5
    assert counted(None, *[True] * 100).means()["success"] == 1.0, "the unknown one has left the window"


def test_what_the_window_keeps_of_unknown_episodes_is_a_number():
    state = counted(True, None).state_dict()
    assert np.isfinite(state["success"]).all()
    again = CountEpisodes(Counters())
    again.load_state_dict(state)
    assert again.unknown() == (1, 2)


@pytest.mark.parametrize(
    ("rate", "unknown", "text"),
    [(0.5, 0, "success 50%"), (None, 3, "success unknown for 3 of 9"), (None, 9, "success -"), (None, 0, "success -")],
)
def test_the_display_has_a_rate_or_says_of_how_many_it_is_unknown(rate, unknown, text):
    assert Snapshot(1, 0.0, rate, 5.0, None, unknown, 9).parts()["success"] == text


def test_a_summary_of_nothing_reported_has_no_rates():
    episode = Episode(np.zeros((2, 3), np.float32), np.zeros((1, 2)), np.ones(1, np.float32), True, 0, {})
    summary = summarise([episode, episode])
    assert (summary["success_rate"], summary["success_unknown"], summary["wall_contact_rate"]) == (None, 2, None)
    assert math.isclose(summary["mean_return"], 1.0)
