"""corridor train CONFIG.yaml: a flag wins over the file, and the file over the preset."""

import re
import sys
from pathlib import Path

import pytest
import yaml
from asked import asked
from conftest import corridor_here

sys.path.insert(0, str(Path(__file__).parent))
from yaml_files import HALLWAY, PYRAMIDS, RECORDED, WALL_JUMP

from corridor_server.protocol.side_channels import read_environment_parameter
from trainer.behavior_settings import BehaviorSettings
from trainer.commands.train import Train
from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.learning.device import check_device
from trainer.main import main
from trainer.players.settings import channels
from trainer.runs.folder import RunFolder


@pytest.fixture
def typed(tmp_path, monkeypatch):
    """What becomes of a command line: the command and its run. ``FILE`` stands for a file with a text."""
    seen = []
    monkeypatch.setattr(Train, "run", lambda command, _: seen.append((command, command.run_config())) or 0)

    def one(text: str, *arguments: object) -> tuple[Train, RunConfig]:
        (tmp_path / "it.yaml").write_text(text)
        file = str(tmp_path / "it.yaml")
        assert main(["train", *(file if each == "FILE" else str(each) for each in arguments)]) == 0
        return seen.pop()

    return one


def test_every_section_of_a_file_is_heard(typed):
    command, run = typed(RECORDED + "  # no more\n", "FILE")
    assert (run.run_id, run.env, run.num_envs, run.num_areas) == ("basic", "builds/Basic", 2, 1)
    assert (run.steps, run.seed, run.device, run.graphics) == (500_000, 0, "auto", False)
    assert run.engine.time_scale == 20.0
    assert run.settings_for("Basic?team=0").hyperparameters.batch_size == 32
    assert command.connection.base_port == 5006
    assert command.resumes_or_overwrites() == (False, True)
    sections = """
env_settings: {env_args: [-x], seed: 3, timeout_wait: 9, max_lifetime_restarts: -1, restarts_rate_limit_n: 2,
  restarts_rate_limit_period_s: 1.5}
checkpoint_settings: {run_id: r, results_dir: elsewhere, resume: true}
torch_settings: {device: cpu}
"""
    command, run = typed(sections, "FILE")
    restarts, connection = command.restarts, command.connection
    assert (run.seed, run.env_args, run.device) == (3, ["-x"], "cpu")
    assert (restarts.max_lifetime_restarts, restarts.restarts_rate_limit_n) == (-1, 2)
    assert (restarts.restarts_rate_limit_period_s, connection.timeout_wait) == (1.5, 9)
    assert command.results_dir == Path("elsewhere")
    assert command.resumes_or_overwrites() == (True, False)


def test_a_flag_wins_over_the_file_even_at_its_own_default(typed):
    flags = "--run-id mine --env builtin --num-envs 1 --num-areas 3 --seed 4 --base-port 5005 --results-dir results"
    others = "--device cpu --timeout-wait 60 --max-lifetime-restarts 10 --time-scale 30 --resume --steps 700"
    command, run = typed(RECORDED, "FILE", *flags.split(), *others.split(), "--env-param", "goal_x=5", "gravity=1")
    assert (run.run_id, run.env, run.num_envs, run.num_areas, run.seed) == ("mine", "builtin", 1, 3, 4)
    assert (run.device, run.engine.time_scale, run.engine.width) == ("cpu", 30.0, 84)
    assert command.connection.base_port == 5005
    assert command.resumes_or_overwrites() == (True, False), "--resume stands over the file's force: true"
    assert (run.steps, run.settings_for("Basic").max_steps) == (700, 700)


@pytest.fixture(autouse=True)
def corridor_with_any_parameter(monkeypatch):
    """Files for other environments are tried on our corridor, which would refuse their parameters."""
    monkeypatch.setattr("trainer.run_options.check_parameter", lambda name, value: None)


def test_what_follows_env_args_wins_over_the_files(typed):
    text = "env_settings: {env_args: [-x], env_path: Other.x86_64}"
    assert typed(text, "FILE", "--run-id", "r", "--env-args", "-y", "--seed")[1].env_args == ["-y", "--seed"]
    assert typed(text, "FILE", "--run-id", "r")[1].env_args == ["-x"]


def test_the_file_wins_over_the_preset(typed):
    text = "env_settings: {num_areas: 1}\nenvironment_parameters: {goal_x: 7}"
    _, run = typed(text, "FILE", "--run-id", "r")
    assert (run.num_areas, run.environment_parameters["goal_x"]) == (1, 7)
    assert (run.preset, run.preset_given) == ("fast", False)
    _, run = typed(text, "FILE", "--run-id", "r", "--preset", "fast")
    assert (run.preset, run.preset_given) == ("fast", True)


def test_steps_are_typed_or_those_of_the_longest_behavior_or_the_papers(typed):
    assert typed(WALL_JUMP, "FILE", "--run-id", "r")[1].steps == 20_000_000
    assert typed("default_settings: {max_steps: 9}", "FILE", "--run-id", "r")[1].steps == 9
    assert typed("", "FILE", "--run-id", "r")[1].steps == 1_500_000
    _, run = typed("default_settings: {max_steps: 9}", "FILE", "--run-id", "r", "--steps", 5)
    assert run.settings_for("Any").max_steps == 5


@pytest.mark.parametrize(
    ("signals", "typed_too", "found"),
    [
        ("{extrinsic: {}}", "--c 0.3", {"extrinsic": 1, "curiosity": 0.3}),
        ("{extrinsic: {}}", "--c 0.3 --intrinsic rnd", {"extrinsic": 1, "rnd": 0.3}),
        ("{extrinsic: {}, rnd: {strength: 0.1}}", "--c 0.3", {"extrinsic": 1, "rnd": 0.3}),
        ("{curiosity: {strength: 0.1}}", "--c 0.3", {"curiosity": 0.3}),
        ("{curiosity: {strength: 0.1}}", "--c 0.3 --intrinsic rnd", {"rnd": 0.3}),
        ("{curiosity: {strength: 0.1}, rnd: {strength: 0.2}}", "--c 0.3", {"curiosity": 0.3, "rnd": 0.2}),
        ("{extrinsic: {strength: 2}, curiosity: {}, rnd: {}}", "--c 0", {"extrinsic": 2}),
        ("{extrinsic: {}, rnd: {strength: 0.1}}", "", {"extrinsic": 1, "rnd": 0.1}),
    ],
)
def test_c_is_the_strength_of_the_intrinsic_reward_that_the_file_has(typed, signals, typed_too, found):
    _, run = typed(f"default_settings: {{reward_signals: {signals}}}", "FILE", "--run-id", "r", *typed_too.split())
    made = run.settings_for("Any").reward_signals
    each = {name: getattr(made, name) for name in ("extrinsic", "curiosity", "rnd")}
    assert {name: signal.strength for name, signal in each.items() if signal is not None} == found


def test_graphics_are_for_builds_that_are_launched(typed):
    text = "engine_settings: {no_graphics: false}"
    assert typed(text, "FILE", "--run-id", "r", "--env", "Other.x86_64")[1].graphics
    assert not typed(text, "FILE", "--run-id", "r", "--env", "Other.x86_64", "--no-graphics")[1].graphics
    assert not typed(text, "FILE", "--run-id", "r")[1].graphics
    assert not typed(text, "FILE", "--run-id", "r", "--env", "editor")[1].graphics


def test_config_is_another_name_for_the_file(typed):
    assert typed(PYRAMIDS, "--config", "FILE", "--run-id", "r")[1] == typed(PYRAMIDS, "FILE", "--run-id", "r")[1]
    assert typed("", "--config", "FILE", "--run-id", "r")[1] == Train("r").run_config()


@pytest.mark.parametrize(
    ("text", "arguments", "says"),
    [
        ("", "FILE --config FILE --run-id r", ".*it.yaml and --config .*it.yaml are two files; give one of them."),
        ("", "FILE", "The run has no name; give it one with --run-id."),
        ("checkpoint_settings: {run_id: a/b}", "FILE", "The run id 'a/b' can't name a folder"),
        (HALLWAY, "FILE --run-id r", ".*it.yaml, line 12: network_settings has memory, which is not supported:"),
        ("env_settings: {num_envs: 2}", "FILE --run-id r --env editor", "--num-envs is 2, but the Unity editor is one"),
        ("env_settings: {num_areas: 2}", "FILE --run-id r --preset paper", "--num-areas is 2, but preset paper trains"),
        ("env_settings: {env_args: [-x]}", "FILE --run-id r --env editor", "--env-args is for players that are launch"),
        ("environment_parameters:\n  failure_penalty: 0", "FILE --run-id r", ".*yaml, line 2: The .* set by --penalty"),
        (
            "default_settings: {reward_signals: {curiosity: {}}}",
            "FILE --run-id r --env Any.x86_64 --c 0",
            "--c 0 takes out the only reward that the file has; add extrinsic to its reward_signals.",
        ),
        ("checkpoint_settings: {resume: true, force: true}", "FILE --run-id r", "--resume continues a run and --force"),
        ("checkpoint_settings: {resume: true}", "FILE --run-id r --algo ddpg", "--resume can't continue --algo ddpg"),
        ("checkpoint_settings: {resume: true}", "FILE --run-id r", "There is no run 'r' in results to resume"),
    ],
)
def test_what_cant_be_asked_for(tmp_path, monkeypatch, text, arguments, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "it.yaml").write_text(text)
    run = corridor_here("train", *(str(tmp_path / "it.yaml") if each == "FILE" else each for each in arguments.split()))
    assert run.returncode == 1
    assert re.match(f"error: {says}", run.stderr)
    assert not (tmp_path / "results").exists()


def test_a_parameter_that_our_corridor_lacks_is_named_with_its_line(tmp_path, monkeypatch):
    monkeypatch.undo()
    (tmp_path / "it.yaml").write_text(
        "environment_parameters:\n  goal_z: 1\n  goal_y:\n    curriculum: [{name: a, value: 1}]\n"
    )
    run = corridor_here("train", tmp_path / "it.yaml", "--run-id", "r")
    assert re.match("error: .*it.yaml, line 3: 'goal_y' is not an environment parameter of the corridor", run.stderr)


def test_cuda_is_refused_when_the_run_starts_where_pytorch_sees_none(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    run = corridor_here("train", "--run-id", "r", "--device", "cuda")
    assert (run.returncode, run.stderr) == (
        1,
        "error: --device is cuda, but PyTorch sees no GPU here; take auto or cpu.\n",
    )
    check_device("auto")
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    check_device("cuda")


def test_players_are_told_the_first_lesson(typed):
    _, run = typed(WALL_JUMP, "FILE", "--run-id", "r", "--env", "Other.x86_64")
    told = dict(read_environment_parameter(bytes(each)) for each in channels(run, 7)[1].message_queue)
    assert told["small_wall_height"] == 1.5
    assert (told["big_wall_height"].low, told["big_wall_height"].high) == (0.0, 4.0)


def recorded(run, tmp_path, **changes):
    folder = RunFolder(tmp_path / run.run_id)
    folder.path.mkdir(exist_ok=True)
    folder.record(run, {"name": "Corridor?team=0"}, 1)
    if changes:
        record = yaml.safe_load(folder.configuration.read_text())
        record["run"].update(changes)
        folder.configuration.write_text(yaml.safe_dump(record))
    return folder


def test_a_runs_record_has_the_behaviors_in_the_form_of_the_file_and_is_read_back(typed, tmp_path):
    _, run = typed(WALL_JUMP, "FILE", "--run-id", "r", "--device", "cpu")
    folder = recorded(run, tmp_path)
    assert folder.read_config() == run
    assert list(yaml.safe_load(folder.configuration.read_text())["run"]["behaviors"]) == [
        "BigWallJump",
        "SmallWallJump",
    ]


def test_behaviors_that_the_environment_lacks_or_that_the_file_lacks_are_named(typed):
    _, run = typed(PYRAMIDS, "FILE", "--run-id", "r")
    run.check_behaviors(["Pyramids?team=0"])
    assert run.settings_for("Pyramids?team=1").max_steps == 10_000_000
    for names in (["Stone"], ["Pyramids", "Stone"]):
        with pytest.raises(TrainerError, match="The environment has the behavior 'Stone', .*add default_settings"):
            run.check_behaviors(names)
    _, both = typed("default_settings: {max_steps: 5}\n" + PYRAMIDS, "FILE", "--run-id", "r")
    both.check_behaviors(["Pyramids", "Stone"])
    with pytest.raises(TrainerError, match="behaviors has 'Pyramids', which the environment doesn't have .*Pyr"):
        both.check_behaviors(["Pyramid"])


def test_behaviors_that_are_listed_and_the_lessons_that_wait_for_them_may_come_late(typed):
    _, run = typed(WALL_JUMP, "FILE", "--run-id", "r")
    assert run.check_behaviors(["BigWallJump?team=0"]) == ["SmallWallJump"]
    assert run.check_behaviors(["BigWallJump", "SmallWallJump"]) == []


def test_a_lesson_that_waits_for_a_behavior_that_is_not_there(typed):
    _, right = typed(WALL_JUMP, "FILE", "--run-id", "r")
    right.check_behaviors(["BigWallJump?team=0", "SmallWallJump?team=0"])
    _, wrong = typed(WALL_JUMP.replace("behavior: SmallWallJump", "behavior: SmalWallJump"), "FILE", "--run-id", "r")
    with pytest.raises(TrainerError, match="wait for the behavior 'SmalWallJump', .*the nearest name is SmallWallJump"):
        wrong.check_behaviors(["BigWallJump", "SmallWallJump"])


@pytest.mark.parametrize("option", [{"algo": "trpo"}, {"from_sb3": Path("model.zip")}])
def test_what_only_runs_in_lockstep_have_is_refused_beside_a_files_behaviors(tmp_path, option):
    (tmp_path / "it.yaml").write_text(PYRAMIDS)
    with pytest.raises(TrainerError, match="^--(algo trpo|from-sb3 model.zip) has no effect on behaviors that a file"):
        asked("r", tmp_path / "it.yaml", **option).run_config()


@pytest.mark.parametrize(
    "changes",
    [
        {"behaviors": {"A": {"max_steps": 0}}},
        {"behaviors": 5},
        {"default_settings": {"no": 5}},
        {"device": "tpu"},
        {"preset_given": 7},
        {"environment_parameters": 5},
        {"environment_parameters": {"a": {"curriculum": []}}},
    ],
)
def test_a_record_that_was_changed_to_something_else_is_refused(tmp_path, changes):
    folder = recorded(Train("r").run_config(), tmp_path, **changes)
    with pytest.raises(TrainerError, match="is missing or not a run's configuration"):
        folder.read_config()


def test_a_run_of_before_goes_on(tmp_path):
    folder = recorded(Train("r").run_config(), tmp_path)
    record = yaml.safe_load(folder.configuration.read_text())
    for name in ("behaviors", "default_settings", "device", "preset_given"):
        del record["run"][name]
    folder.configuration.write_text(yaml.safe_dump(record))
    with RunFolder.claim(Train("r").run_config(), tmp_path, resume=True, force=False):
        pass


def test_a_resumed_run_may_have_another_length_and_device_but_not_other_hyperparameters(typed, tmp_path):
    _, run = typed(PYRAMIDS, "FILE", "--run-id", "r")
    recorded(run, tmp_path)
    changed = PYRAMIDS.replace("10000000", "20000000").replace("summary_freq: 30000", "summary_freq: 5")
    _, longer = typed(changed, "FILE", "--run-id", "r", "--device", "cpu")
    with RunFolder.claim(longer, tmp_path, resume=True, force=False):
        pass
    _, other = typed(PYRAMIDS.replace("beta: 0.01", "beta: 0.02"), "FILE", "--run-id", "r")
    with (
        pytest.raises(TrainerError, match=r"behaviors.Pyramids.hyperparameters.beta 0.01 -> 0.02 \(not allowed\)"),
        RunFolder.claim(other, tmp_path, resume=True, force=False),
    ):
        pass


def test_a_run_without_a_file_has_no_behaviors():
    run = asked("r", steps=5).run_config()
    assert (run.behaviors, run.default_settings, run.settings_for("Corridor")) == ({}, None, BehaviorSettings())
