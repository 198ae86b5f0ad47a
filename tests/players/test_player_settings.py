"""Engine settings and environment parameters, from a YAML file and from the command line."""

import numpy as np
import pytest
from asked import asked

from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform
from corridor_server.protocol.side_channels import read_engine_setting, read_environment_parameter
from trainer.commands.train import Train
from trainer.config import EngineConfig, RunConfig
from trainer.corridor import CORRIDOR
from trainer.errors import TrainerError
from trainer.main import main
from trainer.players.settings import channels, tell_corridor

FILE = """
engine_settings:
  time_scale: 5
  width: 640
environment_parameters:
  opponent_speed: 1.5
  goal_x: 8
  goal_z: {sampler_type: uniform, sampler_parameters: {min_value: 1, max_value: 3}}
  agent_speed: {sampler_type: gaussian, sampler_parameters: {mean: 2, st_dev: 0.1}}
  switch_z: {sampler_type: multirangeuniform, sampler_parameters: {intervals: [[-3, -2], [2, 3]]}}
"""


def config(tmp_path, text, **options):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    return asked("r", config=path, **options).run_config()


def sent(run, seed=7):
    """What goes over the wire, as our own player reads it."""
    engine, parameters = channels(run, seed)
    bytes_of = lambda channel: [bytes(message) for message in channel.message_queue]  # noqa: E731
    return [read_engine_setting(each) for each in bytes_of(engine)], dict(
        map(read_environment_parameter, bytes_of(parameters))
    )


def test_the_defaults_are_those_of_mlagents_learn():
    engine, parameters = sent(Train("r").run_config())
    assert EngineConfig() == EngineConfig(84, 84, 5, 20.0, -1, 60)
    assert engine == [
        "resolution 84 x 84",
        "quality level 5",
        "time scale 20",
        "target frame rate -1",
        "capture frame rate 60",
    ]
    assert parameters == {"failure_penalty": 1.0} | {name: np.float32(value) for name, value in CORRIDOR.items()}


def test_a_file_and_the_command_line_which_wins(tmp_path):
    run = config(tmp_path, FILE, engine={"time_scale": 7.0}, env_param=("goal_x=8.5",))
    engine, parameters = sent(run)
    assert engine[0] == "resolution 640 x 84"
    assert engine[2] == "time scale 7"
    assert parameters["opponent_speed"] == 1.5
    assert parameters["goal_x"] == 8.5


def test_samplers_reach_the_player_each_with_its_own_seed(tmp_path):
    run = config(tmp_path, FILE)
    _, parameters = sent(run, seed=7)
    seeds = {name: 7 + index for index, name in enumerate(run.environment_parameters)}
    assert parameters["goal_z"] == Uniform(seeds["goal_z"], 1.0, 3.0)
    assert parameters["agent_speed"] == Gaussian(seeds["agent_speed"], 2.0, pytest.approx(0.1))
    assert parameters["switch_z"] == MultiRangeUniform(seeds["switch_z"], ((-3.0, -2.0), (2.0, 3.0)))


def test_a_sampler_has_mlagents_defaults_and_its_own_seed_if_the_file_says_one(tmp_path):
    text = """
environment_parameters:
  goal_z: {sampler_type: uniform, sampler_parameters: {seed: 99}}
  agent_speed: {sampler_type: gaussian, sampler_parameters: {st_dev: 0.5, seed: -1}}
  switch_z: {sampler_type: multirangeuniform, sampler_parameters: {}}
  goal_x: {sampler_type: constant, sampler_parameters: {seed: 5, value: 7}}
"""
    run = config(tmp_path, text, env="Other.x86_64")
    _, parameters = sent(run, seed=7)
    told = [name for name in run.environment_parameters if name not in run.preset_parameters]
    seeds = {name: 7 + index for index, name in enumerate(told)}
    assert parameters == {
        "goal_z": Uniform(99, 0.0, 1.0),
        "agent_speed": Gaussian(seeds["agent_speed"], 1.0, 0.5),
        "switch_z": MultiRangeUniform(seeds["switch_z"], ((0.0, 1.0),)),
        "goal_x": 7.0,
    }


def test_our_player_takes_them(open_corridor, tmp_path):
    run = config(tmp_path, FILE)
    environment = open_corridor(side_channels=channels(run, 7), log_folder=tmp_path)
    environment.reset()
    environment.close()
    log = (tmp_path / "Player-0.log").read_text()
    assert "time scale 5 noted" in log
    assert "Environment parameter opponent_speed = 1.5." in log
    assert "Environment parameter goal_z = Uniform" in log
    assert "ignored" not in log


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1, 2]", r"holds \[1, 2\], but names and values were expected."),
        ("a: [", "is not YAML"),
        ("engine_settings: 5", "line 1: engine_settings is 5, but lines 'name: value' were expected"),
        ("engine_settings: {speed: 5}", "line 1: engine_settings has no 'speed'; known ones are width, height"),
        ("engine_settings: {time_scale: 0}", "time_scale is 0, but a number from 1 to 1000 was expected"),
        ("engine_settings: {width: 84.5}", "width is 84.5, but a whole number from 1 to 16384 was expected"),
        ("engine_settings: {width: wide}", "width is 'wide', but a whole number from 1 to 16384 was expected"),
        ("engine_settings: {width: true}", "width is True, but a whole number"),
        ("engine_settings: {width: }", "width is None, but a whole number"),
        ("environment_parameters: {goal_x: far}", "goal_x is 'far', but a number was expected, or a sampler_type"),
        ("environment_parameters: {goal_x: .nan}", "goal_x is nan, but a number was expected"),
        ("environment_parameters: {goal_x: {sampler_type: odd, sampler_parameters: {}}}", "but a number was expected"),
        ("environment_parameters: {goal: 5}", "'goal' is not an environment parameter of the corridor; the nearest"),
        ("environment_parameters: {goal_radius: -5}", "goal_radius = -5 is out of its range"),
        ("environment_parameters: {failure_penalty: 0}", "failure_penalty is set by --penalty; take it out"),
    ],
)
def test_a_file_that_cant_be_used(tmp_path, text, says):
    with pytest.raises(TrainerError, match=says):
        config(tmp_path, text)


def test_a_file_that_does_not_exist(tmp_path):
    with pytest.raises(TrainerError, match="none.yaml can't be read"):
        Train("r", config=tmp_path / "none.yaml").run_config()


@pytest.mark.parametrize("text", ["goal_x", "goal_x=", "=5", "goal_x=far"])
def test_an_environment_parameter_of_another_form(text):
    with pytest.raises(TrainerError, match="is not of the form NAME=NUMBER"):
        asked("r", env_param=(text,)).run_config()


def test_another_build_may_have_any_parameter(tmp_path):
    run = config(tmp_path, "environment_parameters: {gravity: -9.8}", env="Other.x86_64")
    assert sent(run)[1]["gravity"] == pytest.approx(-9.8)


def test_the_presets_corridor_is_for_our_player_alone_until_another_is_known_to_be_one():
    run = asked("r", env="Other.x86_64", env_param=("gravity=-9", "goal_x=5"), penalty=0.5).run_config()
    _, parameters = channels(run, 7)
    told = lambda: dict(read_environment_parameter(bytes(each)) for each in parameters.message_queue)  # noqa: E731
    assert told() == {"gravity": -9.0, "goal_x": 5.0}, "what was given, though goal_x is the preset's too"
    parameters.message_queue.clear()
    tell_corridor(run, parameters)
    kept_back = {name: np.float32(value) for name, value in CORRIDOR.items() if name != "goal_x"}
    assert told() == {"failure_penalty": 0.5} | kept_back


def test_the_editor_takes_a_lower_time_scale_than_a_build():
    asked("r", env="Other.x86_64", engine={"time_scale": 200.0}).run_config()
    asked("r", env="editor", engine={"time_scale": 100.0}).run_config()
    with pytest.raises(TrainerError, match="--time-scale is 200, but the Unity editor takes at most 100; lower it, or"):
        asked("r", env="editor", engine={"time_scale": 200.0}).run_config()


def test_a_run_of_before_with_a_time_scale_below_1_is_read_as_unity_took_it():
    values = Train("r").run_config().as_dict()
    values["engine"]["time_scale"] = 0.5
    assert RunConfig.from_dict(values).engine.time_scale == 1.0


def test_a_build_renders_nothing_unless_it_shall():
    assert not Train("r").run_config().graphics
    assert not asked("r", no_graphics=True).run_config().graphics
    assert asked("r", graphics=True).run_config().graphics
    with pytest.raises(TrainerError, match="--graphics and --no-graphics contradict each other"):
        asked("r", graphics=True, no_graphics=True)


def test_everything_after_env_args_is_the_players(monkeypatch):
    seen = []
    monkeypatch.setattr(Train, "run", lambda command, typed: seen.append(command) or 0)
    main(["train", "--run-id", "r", "--seed", "3", "--env-args", "--seed", "5", "-quality", "x=1"])
    assert seen[0].training.seed == 3
    assert seen[0].environment.env_args == ("--seed", "5", "-quality", "x=1")


def test_an_engine_setting_typed_at_its_default_still_wins_over_the_file(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(Train, "run", lambda command, typed: seen.append(command.run_config()) or 0)
    (tmp_path / "settings.yaml").write_text(FILE)
    main(["train", "--run-id", "r", "--config", str(tmp_path / "settings.yaml"), "--time-scale", "20"])
    assert (seen[0].engine.time_scale, seen[0].engine.width) == (20.0, 640)


def test_given_parameters_replace_the_presets():
    given = asked("r", env_param=("goal_x=7", "agent_spawn_x=-8")).run_config().environment_parameters
    kept = {name: value for name, value in CORRIDOR.items() if not name.startswith("agent_spawn_x_")}
    assert given == {**kept, "goal_x": 7.0, "agent_spawn_x": -8.0}


def test_a_range_that_a_parameter_turns_round():
    with pytest.raises(TrainerError, match="agent_spawn_x would go from -3 to -5.5 .* give both agent_spawn_x_min and"):
        asked("r", env_param=("agent_spawn_x_min=-3",)).run_config()
    with pytest.raises(TrainerError, match="opponent_spawn_x would go from 7 to 6 "):
        asked("r", env_param=("opponent_spawn_x_max=6",)).run_config()
    asked("r", env_param=("agent_spawn_x_min=-3",), env="Other.x86_64").run_config()  # may mean something else there
