"""Help and refusals come at once: what takes seconds to import waits until a command begins its work."""

import json
import subprocess
import sys

import pytest

from trainer.presets import preset_run
from trainer.runs.folder import RunFolder

SLOW = {
    "grpc",
    "gymnasium",
    "imageio",
    "matplotlib",
    "mlagents_envs.environment",
    "onnx",
    "ray",
    "stable_baselines3",
    "tensorboard",
    "torch",
}
COMMANDS = ("train", "evaluate", "study", "export", "replay", "watch", "check", "bench")
STUDIES = ("curiosity-ratio", "penalty", "case-studies", "algorithms", "dose-response", "generalise")
HELP = [
    ["--help"],
    *([name, "--help"] for name in COMMANDS),
    *(["study", name, "--help"] for name in STUDIES),
]
MISTYPED = [
    [],
    ["trian"],
    *([name, "--stepz", "3"] for name in COMMANDS),
    ["train", "--c", "banana"],
    ["train", "--algo", "dqn"],
]
# With results/run, a run without a checkpoint, and results/study.
REFUSED = [
    (["train"], "The run has no name"),
    (["train", "--run-id", "new", "--steps", "0"], "--steps is 0"),
    (["train", "--run-id", "run"], "The run 'run' exists"),
    (["train", "--run-id", "run", "--resume", "--c", "0.1"], "was begun with other settings: curiosity.c 0.3 -> 0.1"),
    (["train", "--run-id", "new", "--resume"], "There is no run 'new'"),
    (["train", "missing.yaml"], "missing.yaml can't be read"),
    (["train", "wrong.yaml", "--run-id", "new"], "wrong.yaml, line 1: There is no section 'behaviours'"),
    (["train", "--run-id", "new", "--env", "./nobody"], "There is no player ./nobody"),
    (["train", "--run-id", "new", "--env", "editor", "--base-port", "6000"], "--base-port 6000 has no effect"),
    (["train", "--run-id", "new", "--graphics"], "--graphics is for builds"),
    (["train", "--run-id", "new", "--env-param", "goal=1"], "'goal' is not an environment parameter"),
    (["train", "--run-id", "new", "--num-areas", "70000"], "--num-areas is 70000"),
    (["train", "--run-id", "new", "--from-sb3", "wrong.yaml"], "wrong.yaml is not a model"),
    (["evaluate", "nothing"], "No run 'nothing'"),
    (["evaluate", "run", "--checkpoint", "step-1"], "holds no checkpoint"),
    (["evaluate", "nothing", "--env-args", "-x"], "--env-args is for corridor train, study and check"),
    (["export", "nothing", "--onnx", "x.onnx"], "No run 'nothing'"),
    (["export", "run", "--onnx", "x.onnx"], "holds no checkpoint"),
    (["export", "run", "--onnx", "nowhere/x.onnx"], "can't be written"),
    (["replay", "nothing"], "No run 'nothing'"),
    (["replay", "run"], "holds no checkpoint"),
    (["replay", "study", "--checkpoint", "step-1"], "--checkpoint step-1 is a run's"),
    (["study", "penalty", "--seeds", "0"], "--seeds is 0"),
    (["study", "penalty", "--results-dir", "nowhere://x"], "--results-dir nowhere://x can't be used"),
    (["study", "generalise", "nothing"], "No run 'nothing'"),
    (["study", "generalise", "run"], "holds no checkpoint"),
    (["check", "--env", "./nobody"], "There is no player ./nobody"),
    (["check", "--env", "editor", "--env-args", "-x"], "--env-args is for players that are launched"),
    (["bench", "--json", "nowhere/x.json"], "can't be written"),
    (["watch", "--port", "70000"], "--port is 70000"),
]
PROGRAM = """
import contextlib, io, json, sys
from trainer.main import main
for arguments in json.load(sys.stdin):
    said, ended = io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            ended = main(arguments)
        except SystemExit as end:
            ended = end.code
    print(json.dumps([ended, said.getvalue(), sorted(sys.modules)]))
"""


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """Runs commands one after the other in a process that has imported nothing else."""
    place = tmp_path_factory.mktemp("start")
    run = RunFolder(place / "results" / "run")
    run.path.mkdir(parents=True)
    run.record(preset_run("run", "fast", c=0.3, seed=0, steps=1000), {"name": "Corridor?team=0"}, 128)
    (place / "results" / "study").mkdir()
    (place / "results" / "study" / "claims.json").touch()
    (place / "wrong.yaml").write_text("behaviours: {}\n")

    def start(commands):
        asked = json.dumps(commands)
        process = [sys.executable, "-c", PROGRAM]
        done = subprocess.run(process, input=asked, capture_output=True, text=True, cwd=place, timeout=120)
        assert done.returncode == 0, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    return start


def test_every_help_comes_without_what_takes_long_to_import(started):
    for arguments, (code, said, imported) in zip(HELP, started(HELP), strict=True):
        assert (code, said.split()[0]) == (0, "usage:"), arguments
        assert {"numpy", *SLOW} & set(imported) == set(), arguments


def test_so_does_what_is_said_of_mistyped_options_and_values(started):
    for arguments, (code, _, imported) in zip(MISTYPED, started(MISTYPED), strict=True):
        assert code == 2, arguments
        assert {"numpy", *SLOW} & set(imported) == set(), arguments


def test_so_does_every_refusal_that_needs_nothing_but_files(started):
    commands = [arguments for arguments, _ in REFUSED]
    for (arguments, says), (code, said, imported) in zip(REFUSED, started(commands), strict=True):
        assert code == 1, arguments
        assert said.startswith("error: "), arguments
        assert says in said, arguments
        assert SLOW & set(imported) == set(), arguments


def test_a_command_reads_no_other_commands_module(started):
    ((_, _, imported),) = started([["watch", "--help"]])
    assert {name for name in imported if name.startswith("trainer.commands.")} == {
        "trainer.commands.shared_options",
        "trainer.commands.typed_values",
        "trainer.commands.watch",
    }


def test_a_run_begins_without_what_draws_its_pictures_at_the_end():
    program = "import sys, trainer.runs.run, trainer.runs.scene_run; print('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "False\n"
