"""``corridor study`` as a user runs it: real processes, stopped and continued, with runs that fail."""

import csv
import dataclasses
import io
import json
import shlex
import signal
import subprocess
import time
from pathlib import Path

import pytest
from conftest import BIN
from recorded_run import begun_run

from trainer.commands.study import CuriosityRatio, Penalty, name_of, run_of
from trainer.commands.train import EnvironmentOptions
from trainer.main import main
from trainer.presets import PRESETS
from trainer.studies.conduct import run_study
from trainer.studies.executors import Attempt, LocalExecutor, Task
from trainer.studies.plan import (
    BASE,
    CASE_STUDIES,
    CURIOSITY_RATIO,
    NO_PENALTY,
    PENALTY,
    STUDIES,
    Arm,
    Study,
    corridor_world,
)
from trainer.studies.store import Store
from trainer.terminal import Terminal

ZOO = Path(__file__).parents[2] / "docs" / "zoo"
SHORT = ("--seeds", 1, "--steps", 12_000, "--eval-episodes", 4)


def study(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [str(BIN / "corridor"), "study", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=800)


def run_ids(folder: Path) -> list[str]:
    return sorted(
        path.parent.name for path in folder.glob("[!.]*/summary.json")
    )  # one that is copied begins with a dot


@pytest.fixture(scope="module")
def penalty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a penalty study that Ctrl-C ended after its first run, and the same command then finished."""
    results = tmp_path_factory.mktemp("results")
    options = ["penalty", *SHORT, "--results-dir", results, "--jobs", 1]
    process = subprocess.Popen(
        [str(BIN / "corridor"), "study", *map(str, options)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    folder = results / "penalty"
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline and not run_ids(folder):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 130
    assert "the same command goes on" in output
    before = run_ids(folder)
    assert 1 <= len(before) < 3
    made = {name: (folder / name / "summary.json").stat().st_mtime_ns for name in before}

    done = study(*options)
    assert done.returncode == 0, done.stderr
    assert f"{len(before)} of them finished before" in done.stdout
    assert made == {name: (folder / name / "summary.json").stat().st_mtime_ns for name in before}
    return folder


@pytest.mark.slow
def test_a_stopped_study_goes_on_and_has_every_run_once(penalty):
    assert run_ids(penalty) == ["c0-no-penalty-seed0", "c0.3-no-penalty-seed0", "c0.3-seed0"]


@pytest.mark.slow
def test_a_study_leaves_its_files(penalty):
    for name in ("runs.csv", "claims.json", "report.md", "figure6a.png", "figure6b.png"):
        assert (penalty / name).stat().st_size > 100, name
    assert not list(penalty.rglob("*.tmp"))


@pytest.mark.slow
def test_its_runs_are_ordinary_runs(penalty):
    for run_id in run_ids(penalty):
        for name in ("configuration.yaml", "progress.csv", "learning_curve.png", "run_logs/train.log"):
            assert (penalty / run_id / name).exists(), name
    summary = json.loads((penalty / "c0-no-penalty-seed0" / "summary.json").read_text())
    assert (summary["c"], summary["penalty"]) == (0.0, 0.0)


@pytest.mark.slow
def test_claims_json_has_the_contracts_keys(penalty):
    record = json.loads((penalty / "claims.json").read_text())
    assert [claim["id"] for claim in record["claims"]] == ["C5", "C6", "C7"]
    assert all(list(claim) == ["id", "statement", "measure", "holds", "evidence"] for claim in record["claims"])
    assert {claim["holds"] for claim in record["claims"]} == {None}  # one seed of 12,000 steps decides nothing
    assert "| not decided | Not decided: there are 1 of 4 seeds, 12,000 of" in (penalty / "report.md").read_text()
    assert (record["seeds"], record["steps"]) == (1, 12_000)
    assert record["command"].startswith("corridor study penalty --seeds 1")
    assert record["versions"]["torch"].startswith("2.13.0")
    assert record["runs"]["finished"] == 3


@pytest.mark.slow
def test_runs_csv_has_every_runs_curve(penalty):
    with (penalty / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["run_id"] for row in rows} == set(run_ids(penalty))
    for run_id in run_ids(penalty):
        with (penalty / run_id / "progress.csv").open(newline="") as file:
            assert len(list(csv.DictReader(file))) == sum(row["run_id"] == run_id for row in rows)


@pytest.mark.slow
def test_another_study_uses_the_runs_that_are_there(penalty):
    store = Store(str(penalty.parent))
    shared = [
        config for arm in CURIOSITY_RATIO.runs(corridor_world("case-studies", 12_000), [0]).values() for config in arm
    ]
    found = {config.run_id: store.find(config, "curiosity-ratio", 4) for config in shared}
    assert found == {"c0-seed0": None, "c0.1-seed0": None, "c0.3-seed0": f"{penalty}/c0.3-seed0", "c0.5-seed0": None}


@pytest.mark.slow
def test_a_run_with_other_settings_is_not_overwritten(penalty, capsys):
    assert main(["study", "penalty", "--seeds", "1", "--steps", "4000", "--results-dir", str(penalty.parent)]) == 1
    assert "not a run with this study's settings" in " ".join(capsys.readouterr().err.split())


def test_half_a_run_is_not_a_finished_one(tmp_path):
    config, store = BASE.run("fast", 3_000, 0), Store(str(tmp_path))
    folder = begun_run(config, tmp_path / "penalty")
    assert store.find(config, "penalty", 200) is None
    folder.write_summary({"evaluation": None})
    assert store.find(config, "penalty", 200) is None
    folder.write_summary({"evaluation": {"episodes": 20}})
    assert store.find(config, "penalty", 200) is None
    folder.write_summary({"evaluation": {"episodes": 200}})
    assert store.find(config, "penalty", 200) == str(folder.path)


class Broken(Arm):
    def run(self, preset, steps, seed):
        return dataclasses.replace(super().run(preset, steps, seed), env="there/is/no/player")


@pytest.mark.slow
def test_a_failing_run_is_reported_with_its_log_and_the_study_goes_on(tmp_path):
    arms = (Broken("broken", "broken", 0.3), BASE)
    output = io.StringIO()
    finished = run_study(
        Study("mixed", "Mixed", arms),
        LocalExecutor(1),
        Store(str(tmp_path)),
        world=corridor_world("fast", 1_000),
        seeds=[0],
        episodes=2,
        timeout_wait=30,
        command="corridor study mixed",
        console=Terminal(file=output, width=120),
    )
    assert not finished
    log = tmp_path / "mixed" / "broken-seed0" / "run_logs" / "train.log"
    shown = " ".join(output.getvalue().split())
    assert "failed: broken-seed0: There is no player there/is/no/player" in shown
    assert str(log) in shown
    assert "There is no player" in log.read_text()
    assert run_ids(tmp_path / "mixed") == ["c0-seed0"]
    assert "broken-seed0: There is no player" in (tmp_path / "mixed" / "report.md").read_text()


@pytest.mark.slow
def test_results_can_go_to_an_fsspec_url():
    executor, config = LocalExecutor(1), BASE.run("fast", 1_000, 0)
    place = "memory://corridor-test"
    updates = list(executor.run([Task(config, place, "penalty", 2, 30)]))
    outcomes = [outcome for update in updates for outcome in update.ended]
    assert [outcome.error for outcome in outcomes] == [None]
    store = Store(place)
    path = store.find(config, "penalty", 2)
    assert path is not None
    assert store.load(path).measure("mean_episode_length") > 0


@pytest.mark.slow
def test_a_run_ends_with_the_process_that_started_it(tmp_path):
    """What a worker sees of a killed study, or of a lost Ray node, is the end of its input."""
    attempt = Attempt(Task(BASE.run("fast", 10_000_000, 0), str(tmp_path), "penalty", 2, 30))
    deadline = time.monotonic() + 300
    while not attempt.steps() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert attempt.steps() > 0
    attempt._input.close()
    attempt.wait()
    attempt.discard()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_study_of_another_environment_has_its_returns_and_decides_no_claim(tmp_path):
    pole = ("--env", BIN / "corridor-server", "--env-args", "--gym", "CartPole-v1")
    done = study(
        "curiosity-ratio",
        ZOO / "cartpole.yaml",
        *SHORT[:2],
        "--steps",
        64,
        "--eval-episodes",
        2,
        "--results-dir",
        tmp_path,
        *pole,
    )
    assert done.returncode == 0, done.stderr
    report = (tmp_path / "curiosity-ratio" / "report.md").read_text()
    assert report.startswith("# Influence of the curiosity ratio: cartpole.yaml, corridor-server --gym CartPole-v1\n")
    assert "| arm | runs | return | episode length | minutes of learning |" in report
    assert "Mean return in the evaluation, by seed" in report
    assert shlex.join(map(str, pole[2:])) in report, "the command as it was typed"
    record = json.loads((tmp_path / "curiosity-ratio" / "claims.json").read_text())
    assert (record["claims"], record["preset"]) == ([], None)
    strengths = {
        arm: json.loads((tmp_path / "curiosity-ratio" / f"{arm}-seed0" / "summary.json").read_text())["c"]
        for arm in ("c0", "c0.1", "c0.3", "c0.5")
    }
    assert strengths == {"c0": 0, "c0.1": 0.1, "c0.3": 0.3, "c0.5": 0.5}


def test_a_file_of_the_paper_s_settings_is_a_study_s_corridor(tmp_path):
    settings = tmp_path / "gamma.yaml"
    settings.write_text("behaviors: {Corridor: {trainer_type: paper, hyperparameters: {gamma: 0.9}}}")
    made = run_of(Penalty(file=settings).trained(), NO_PENALTY, 3)
    assert (made.run_id, made.seed, made.penalty, made.curiosity.c, made.ppo.gamma) == (
        "c0.3-no-penalty-seed3",
        3,
        0,
        0.3,
        0.9,
    )


def test_what_a_files_runs_begin_with_is_kept(tmp_path):
    settings = tmp_path / "rnd.yaml"
    settings.write_text("behaviors: {Corridor: {trainer_type: paper, curiosity: {intrinsic: rnd}}}")
    made = run_of(Penalty(file=settings).trained(), NO_PENALTY, 3)
    assert (made.curiosity.intrinsic, made.preset_given) == ("rnd", True)


def test_a_changed_corridor_is_trained_by_the_studies_preset_and_named():
    train = Penalty(environment=EnvironmentOptions(env_param=("goal_x=8",))).trained()
    made = run_of(train, NO_PENALTY, 3)
    assert (made.preset, made.curiosity.scale, made.environment_parameters["goal_x"]) == ("case-studies", 3.0, 8.0)
    assert name_of(train) == "preset case-studies, goal_x=8"


def test_a_study_pays_for_the_curiosity_that_its_file_has():
    train = CuriosityRatio(
        file=ZOO / "mountaincar.yaml", environment=EnvironmentOptions(env=str(BIN / "corridor-server"))
    ).trained()
    by_c = {
        arm.c: run_of(train, arm, 0).settings_for("MountainCarContinuous-v0").reward_signals
        for arm in CURIOSITY_RATIO.arms
    }
    assert {c: None if each.rnd is None else each.rnd.strength for c, each in by_c.items()} == {
        0: None,
        0.1: 0.1,
        0.3: 0.3,
        0.5: 0.5,
    }
    assert all(each.curiosity is None for each in by_c.values())


def test_gamma_is_varied_only_from_the_one_that_the_figure_says(tmp_path, capsys):
    assert main(["study", "dose-response", "--preset", "threshold", "--results-dir", str(tmp_path)]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "gamma is 0.91 in preset threshold, but study dose-response compares 0.96 with others; take a preset" in said


def test_a_preset_can_have_a_corridor_of_its_own():
    own, usual = (PENALTY.runs(corridor_world(preset, 4_000), [0])["c0.3"][0] for preset in ("threshold", "fast"))
    changed = {"goal_x": 8.0, "half_width": 6.5, "opponent_target_z": 1.0}
    assert own.environment_parameters == usual.environment_parameters | changed
    assert set(own.preset_parameters) == set(own.environment_parameters)


def test_case_studies_train_what_both_need_once():
    names = [arm.name for arm in CASE_STUDIES.arms]
    assert len(names) == len(set(names)) == 6
    assert {arm.name for arm in CURIOSITY_RATIO.arms + PENALTY.arms} == set(names)


@pytest.mark.parametrize("each", STUDIES, ids=lambda each: each.name)
def test_arms_are_what_their_names_say(each):
    names = [arm.name for arm in each.arms]
    assert len(set(names)) == len(names)
    for arm in each.arms:
        config = arm.run("fast", 1_500_000, 7)
        assert config.run_id == f"{arm.name}-seed7"
        assert (config.seed, config.steps) == (7, 1_500_000)
        assert (config.penalty == 0) == ("no-penalty" in arm.name)
        assert config.algo == next((algo for algo in ("a2c", "trpo", "ddpg") if algo in arm.name), "ppo")
        assert config.curiosity.intrinsic == ("rnd" if "rnd" in arm.name else "icm")
        c, _, gamma = arm.name.removesuffix("-no-penalty").partition("-gamma")
        assert config.curiosity.c == float(c.rpartition("c")[2])
        assert config.ppo.gamma == (float(gamma) if gamma else PRESETS["fast"].ppo.gamma)


def test_figures_show_arms_that_the_study_has():
    for each in STUDIES:
        names = {arm.name for arm in each.arms}
        for figure in each.figures:
            assert set(figure.colours) <= names
        for dose in each.doses:
            assert {arm.name for line in dose.lines.values() for _, arm in line} <= names


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--seeds", "0"],
            "--seeds is 0, but a whole number from 1 to 1000 was expected; see corridor study curiosity-ratio --help.",
        ),
        (["--steps", "0"], "--steps is 0"),
        (["--jobs", "0"], "--jobs is 0"),
        (["--address", "auto"], "--address auto names a Ray cluster; add --executor ray, or leave it out."),
        (["--executor", "ray", "--jobs", "2"], "--jobs is for --executor local"),
        (["--results-dir", "/proc/nowhere"], "/proc/nowhere/curiosity-ratio can't be written"),
        (["--env", "editor"], "--env is editor, but a study starts its players itself"),
        (["--env", "there/is/none"], "There is no player there/is/none"),
        (
            [str(ZOO / "simple_tag.yaml"), "--env", str(BIN / "corridor-server")],
            "has 2 behaviors, but a study compares runs of one",
        ),
        (["--preset", "fast", str(ZOO / "cartpole.yaml")], "--preset fast has no effect on behaviors that a file"),
        (["--results-dir", "nothing://there"], "--results-dir nothing://there can't be used: Protocol not known"),
    ],
)
def test_bad_options_are_one_sentence_before_anything_starts(arguments, sentence, capsys):
    assert main(["study", "curiosity-ratio", *arguments]) == 1
    assert sentence in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--env", str(BIN / "corridor-server")],
            "study penalty changes what only the paper's corridor has; take study",
        ),
        (
            [str(ZOO / "cartpole.yaml")],
            "cartpole.yaml has no trainer_type paper, but study penalty changes what only that",
        ),
    ],
)
def test_only_c_is_studied_elsewhere(arguments, sentence, capsys):
    assert main(["study", "penalty", *arguments]) == 1
    assert sentence in " ".join(capsys.readouterr().err.split())
