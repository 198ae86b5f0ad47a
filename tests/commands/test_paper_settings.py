"""trainer_type: paper: the corridor's runs said by a file, as the presets are and as a run records itself."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from conftest import corridor_here

from trainer.commands.train import Train
from trainer.main import main
from trainer.paper_settings import paper_sections, preset_file
from trainer.presets import PRESETS

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def typed(tmp_path, monkeypatch):
    """The run of a command line; ``FILE`` stands for a file with a text."""
    seen = []
    monkeypatch.setattr(Train, "run", lambda command, _: seen.append(command.run_config()) or 0)

    def one(text, *arguments):
        (tmp_path / "it.yaml").write_text(text)
        file = str(tmp_path / "it.yaml")
        assert main(["train", "--run-id", "it", *(file if each == "FILE" else each for each in arguments)]) == 0
        return seen.pop()

    return one


def refusal(capsys, text, tmp_path, *arguments):
    (tmp_path / "it.yaml").write_text(text)
    assert main(["train", str(tmp_path / "it.yaml"), "--run-id", "it", *arguments]) == 1
    return " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("preset", PRESETS)
def test_a_presets_file_is_the_preset(typed, preset):
    path = DOCS / "presets" / f"{preset}.yaml"
    assert path.read_text() == preset_file(preset), "run make docs"
    assert typed(path.read_text(), "FILE") == typed("", "--preset", preset)


@pytest.mark.parametrize(
    "arguments",
    [
        "--c 0.1 --seed 3 --penalty 0 --steps 777 --num-areas 5 --num-envs 2 --env-param opponent_speed=0.5",
        "--preset paper --c 0 --device cpu",
        "--algo ddpg --intrinsic rnd",
        "--algo trpo --from-sb3 policy.zip --env a/build --time-scale 3 --graphics --env-args -x 1",
    ],
)
def test_what_a_run_records_makes_the_same_run(typed, arguments):
    run = typed("", *arguments.split())
    again = typed(yaml.safe_dump(paper_sections(run, "Corridor?team=0"), sort_keys=False), "FILE")
    assert again == run
    assert again.preset_given, "which trains in lockstep whatever the player is"
    assert again.behavior == "Corridor"


@pytest.mark.slow
def test_a_run_trained_from_its_own_record_learns_the_same(tmp_path, free_port):
    results = ["--results-dir", str(tmp_path), "--base-port", str(free_port), "--eval-episodes", "1"]
    typed = ["--c", "0.1", "--seed", "5", "--num-areas", "4", "--steps", "200"]
    assert corridor_here("train", "--run-id", "first", *typed, *results).returncode == 0
    record = tmp_path / "first" / "configuration.yaml"
    assert corridor_here("train", record, "--run-id", "again", *results).returncode == 0
    first, again = (json.loads((tmp_path / name / "summary.json").read_text()) for name in ("first", "again"))
    assert again["policy_sha256"] == first["policy_sha256"]


def test_what_a_file_does_not_say_is_the_presets_and_flags_win(typed):
    text = """
behaviors:
  Corridor:
    trainer_type: paper
    preset: paper
    hyperparameters: {gamma: 0.9}
    curiosity: {c: 0.2, intrinsic: rnd}
    penalty: 2
    max_steps: 99
"""
    run, paper = typed(text, "FILE"), PRESETS["paper"]
    assert run.ppo == replace(paper.ppo, gamma=0.9)
    assert run.curiosity == replace(paper.curiosity, c=0.2, intrinsic="rnd")
    assert (run.through_gym, run.num_areas, run.penalty, run.steps) == (True, 1, 2.0, 99)
    run = typed(text, "FILE", "--c", "0.4", "--intrinsic", "icm", "--penalty", "1", "--steps", "7", "--algo", "a2c")
    assert run.curiosity == replace(paper.curiosity, c=0.4)
    assert (run.algo, run.penalty, run.steps, run.ppo.gamma) == ("a2c", 1.0, 7, 0.9)
    other = "default_settings: {trainer_type: paper, algorithm: a2c, own_hyperparameters: {n_steps: 9}}"
    run = typed(other, "FILE")
    assert (run.other.n_steps, run.behavior) == (9, None)


def test_what_cant_be_used_is_refused_with_its_line(capsys, tmp_path):
    head = "behaviors:\n  Corridor:\n    trainer_type: paper\n"
    only = "line 2: 'Corridor' has trainer_type paper, which trains the only behavior"
    cases = {
        "hyperparameters:\n      gama: 1\n": "line 5: hyperparameters has no 'gama'; the nearest name is gamma",
        "curiosity: {c: -1}\n": "it.yaml, line 4: The setting c is -1, but",
        "preset: fats\n": "it.yaml, line 4: The setting preset is 'fats', but one of fast, case-studies, threshold",
        "own_hyperparameters: {tau: 1}\n": "line 4: own_hyperparameters are of algorithms other than 'ppo'",
        "max_steps: x": "line 4: The setting max_steps is 'x', but",
        "penalty: 1\n  Other: {}\n": only,
        "penalty: 1\ndefault_settings: {}\n": only,
    }
    for text, said in cases.items():
        assert said in refusal(capsys, f"{head}    {text}", tmp_path)
    assert "--preset fast has no effect on behaviors that a file" in refusal(capsys, head, tmp_path, "--preset", "fast")
    through_gym = head + "    through_gym: true\n"
    assert "--num-areas is 2, but" in refusal(capsys, through_gym, tmp_path, "--num-areas", "2")


def test_settings_for_another_behavior_are_refused(tmp_path, free_port):
    (tmp_path / "it.yaml").write_text("behaviors:\n  Walker:\n    trainer_type: paper\n")
    told = corridor_here(
        "train", tmp_path / "it.yaml", "--run-id", "it", "--results-dir", tmp_path, "--base-port", free_port
    )
    said = "The file has settings for the behavior 'Walker', but the player's is 'Corridor'; rename it there."
    assert (told.returncode, said in " ".join(told.stderr.split())) == (1, True)
