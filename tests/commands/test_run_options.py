"""mlagents-learn's YAML: published files are read whole, and what can't be used is named with its file and line."""

import dataclasses
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from yaml_files import BALANCE, HALLWAY, PYRAMIDS, RECORDED, WALL_JUMP

from corridor_server.protocol.samplers import Uniform
from trainer.behavior_settings import (
    BehaviorSettings,
    CuriositySignal,
    NetworkSettings,
    PPOHyperparameters,
    RewardSignal,
    RewardSignals,
    RNDSignal,
    SACHyperparameters,
)
from trainer.errors import TrainerError
from trainer.parameter_values import parse_parameter
from trainer.run_options import CheckpointSettings, EnvSettings, RunOptions, TorchSettings


@pytest.fixture
def read(tmp_path):
    def one(text: str) -> RunOptions:
        path = tmp_path / "it.yaml"
        path.write_text(text)
        return RunOptions.read(path)

    return one


def test_pyramids(read):
    assert read(PYRAMIDS) == RunOptions(
        behaviors={
            "Pyramids": BehaviorSettings(
                hyperparameters=PPOHyperparameters(batch_size=128, buffer_size=2048, beta=0.01),
                network_settings=NetworkSettings(hidden_units=512),
                reward_signals=RewardSignals(
                    rnd=RNDSignal(strength=0.01, network_settings=NetworkSettings(hidden_units=64, num_layers=3))
                ),
                max_steps=10_000_000,
                time_horizon=128,
                summary_freq=30_000,
            )
        }
    )


def test_balance_with_sac_and_samplers(read):
    balance = read(BALANCE)
    assert balance.behaviors["3DBall"] == BehaviorSettings(
        trainer_type="sac",
        hyperparameters=SACHyperparameters(
            batch_size=64,
            buffer_size=200_000,
            steps_per_update=10,
            init_entcoef=0.5,
            reward_signal_steps_per_update=10,
        ),
        network_settings=NetworkSettings(normalize=True, hidden_units=64),
        max_steps=200_000,
        time_horizon=1000,
        summary_freq=12_000,
    )
    assert balance.environment_parameters["mass"]["sampler_parameters"] == {"min_value": 0.5, "max_value": 10}


def test_wall_jump_with_curricula_and_a_behavior_that_is_another_but_for_its_steps(read):
    jump = read(WALL_JUMP)
    assert jump.behaviors["SmallWallJump"] == dataclasses.replace(jump.behaviors["BigWallJump"], max_steps=5_000_000)
    assert len(jump.environment_parameters["big_wall_height"]["curriculum"]) == 3
    assert jump.max_steps == 20_000_000


def test_what_mlagents_learn_records_of_a_run(read):
    options = read(RECORDED)
    network = NetworkSettings(hidden_units=20, num_layers=1)
    signals = RewardSignals(RewardSignal(gamma=0.9), CuriositySignal(strength=0.02, network_settings=network))
    assert options == RunOptions(
        behaviors={
            "Basic": BehaviorSettings(
                hyperparameters=PPOHyperparameters(batch_size=32, buffer_size=256, beta_schedule="constant"),
                network_settings=network,
                reward_signals=signals,
                time_horizon=3,
                summary_freq=2000,
            )
        },
        env_settings=EnvSettings("builds/Basic", None, 5006, 2, 1, None, 60, 10, 1, 60.0),
        engine_settings={
            "width": 84,
            "height": 84,
            "quality_level": 5,
            "time_scale": 20.0,
            "target_frame_rate": -1,
            "capture_frame_rate": 60,
        },
        graphics=False,
        environment_parameters=yaml.safe_load(RECORDED)["environment_parameters"],
        checkpoint_settings=CheckpointSettings("basic", "results", False, True),
    )


@pytest.mark.parametrize("text", [PYRAMIDS, BALANCE, WALL_JUMP, RECORDED])
def test_what_a_run_records_is_such_a_file_again(read, text):
    options = read(text)
    behaviors, default, _ = options.recorded(None, None, "icm")
    again = read(yaml.safe_dump({"behaviors": behaviors, "default_settings": default}))
    assert (again.behaviors, again.default_settings) == (options.behaviors, options.default_settings)


def test_the_hallway_needs_a_memory(read, tmp_path):
    with pytest.raises(TrainerError) as refused:
        read(HALLWAY)
    assert str(refused.value) == (
        f"{tmp_path}/it.yaml, line 12: network_settings has memory, which is not supported: there are no recurrent "
        "networks here; take memory out, and stack observations."
    )


BEHAVIOR = "behaviors:\n  A:\n    "
SAMPLED = "environment_parameters:\n  a: {sampler_type: "
UNIFORM = SAMPLED + "uniform, sampler_parameters: "
CURRICULUM = "environment_parameters:\n  a:\n    curriculum:\n    - "


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("behaviour: {}", 1, "There is no section 'behaviour'; the nearest name is behaviors."),
        ("\nzzz: 1", 2, "There is no section 'zzz'; known ones are behaviors, default_settings, .*, torch_settings."),
        (
            "parameter_randomization: {}",
            1,
            "is of ML-Agents before 0.18; samplers stand under environment_parameters n",
        ),
        ("debug: 3", 1, "debug is 3, but true or false was expected"),
        ("behaviors: 5", 1, "behaviors is 5, but lines 'name: value' were expected"),
        ("behaviors:\n  A:", 2, "A is None, but lines 'name: value' were expected."),
        (
            BEHAVIOR + "hyperparameters:\n      bach_size: 5",
            4,
            "hyperparameters has no 'bach_size'; the nearest name is",
        ),
        (BEHAVIOR + "hyperparameters:\n      buffer_size: 5", 3, "batch_size is 1024, but buffer_size is 5, and"),
        (BEHAVIOR + "max_steps: 1\n    max_steps: 2", 4, "'max_steps' stands on line 3 already; take one out."),
        ("behaviors: {A: {max_steps: 1, max_steps: 2}}", 1, "'max_steps' stands on line 1 already; take one out."),
        (
            BEHAVIOR + "reward_signals:\n      gail:\n        x: 1",
            4,
            "reward_signals has gail, which is not supported:",
        ),
        (BEHAVIOR + "self_play:\n      x: 1", 3, "a behavior has self_play, which is not supported: no team plays"),
        (BEHAVIOR + "trainer_type: poca", 3, "trainer_type is 'poca', but one of ppo, sac was expected."),
        ("x: &x\n  max_steps: 0\nbehaviors:\n  A:\n    <<: *x", 1, "There is no section 'x'"),
        ("default_settings: &x\n  max_steps: 1\n  a: 2\nbehaviors:\n  A: *x", 3, "a behavior has no 'a'; known ones"),
        ("default_settings:\n  max_steps: 0", 2, "max_steps is 0, but a whole number from 1 up was expected."),
        (
            BEHAVIOR + "network_settings: &n\n      x: 1\n  B:\n    network_settings: *n",
            4,
            "network_settings has no 'x'",
        ),
        (BEHAVIOR + "network_settings:\n      <<: {\n       hidden_units: 0}", 5, "hidden_units is 0, but"),
        ("behaviors:\n  7: {}", 2, "7 is no behavior's name; give it as a text, and without its team."),
        ("env_settings:\n  num_env: 2", 2, "env_settings has no 'num_env'; the nearest name is num_envs."),
        ("env_settings:\n  seed: -2", 2, "seed is -2, but a whole number from 0 up was expected."),
        ("env_settings:\n  base_port: 70000", 2, "base_port is 70000, but ports end at 65535."),
        ("env_settings:\n  env_args: [-x, [5]]", 2, r"env_args is \['-x', \[5\]\], but a text was expected."),
        ("env_settings:\n  env_args: -x", 2, "env_args is '-x', but a list was expected."),
        ("engine_settings:\n  width: 0", 2, "width is 0, but a whole number from 1 to 16384 was expected."),
        ("engine_settings:\n  no_graphics: 1", 2, "no_graphics is 1, but true or false was expected."),
        ("engine_settings:\n  no_graphics_monitor: true", 2, "no_graphics_monitor, which is not supported: either all"),
        (
            "checkpoint_settings:\n  initialize_from: a",
            2,
            "not supported: name the checkpoint .* as init_path of each b",
        ),
        ("checkpoint_settings:\n  load_model: true", 2, "load_model, which is not supported: write resume: true."),
        (
            "checkpoint_settings:\n  inference: true",
            2,
            "inference, .*: corridor evaluate plays what a run has learned.",
        ),
        ("torch_settings:\n  device: tpu", 2, "device is 'tpu', but one of auto, cpu, cuda was expected."),
        ("environment_parameters: 5", 1, "environment_parameters is 5, but lines 'name: value' were expected."),
        ("environment_parameters:\n  a: far", 2, "The environment parameter a is 'far', but a number was expected, or"),
        ("environment_parameters:\n  5: 5", 2, "The environment parameter 5 can't be sent; give it a name of at most"),
        (
            "environment_parameters:\n  a: {sampler_type: uniform, sampler_params: {min_value: 2, max_value: 1}}",
            2,
            "a is .*, but a number was expected, or a sampler_type with its",
        ),
        (UNIFORM + "{min_value: 2}}", 2, "a has a sampler of which the least value, 2, is above the greatest, 1."),
        (
            UNIFORM + "{min: 2}}",
            2,
            "a has a sampler of which 'min' is no parameter; known ones are min_value, max_value.",
        ),
        (UNIFORM + "{min_value: low}}", 2, "a has a sampler of which min_value is 'low', but a number was expected."),
        (UNIFORM + "{seed: 0.5}}", 2, "a has a sampler of which the seed is 0.5, but a whole number from -1"),
        (
            SAMPLED + "gaussian, sampler_parameters: {st_dev: -1}}",
            2,
            "a has .* st_dev is -1, but 0 or more was expected",
        ),
        (
            SAMPLED + "multirangeuniform, sampler_parameters: {intervals: [[1]]}}",
            2,
            "a has .* intervals is no list of pa",
        ),
        ("environment_parameters:\n  a:\n    curriculum: []", 3, r"The curriculum of a is \[\], but a list of lessons"),
        ("environment_parameters:\n  a:\n    curriculum: []\n    b: 1", 4, "a has a curriculum and 'b'; values belong"),
        (CURRICULUM + "5", 4, "a lesson is 5, but lines 'name: value' were expected."),
        (
            CURRICULUM + "name: L\n      value: 1\n      vaule: 2",
            6,
            "a lesson has no 'vaule'; the nearest name is value",
        ),
        (CURRICULUM + "name: L", 4, "a lesson has no value, which it needs."),
        (CURRICULUM + "name: L\n      value: x", 5, "The environment parameter a is 'x', but a number was expected"),
        (
            CURRICULUM + "{name: L, value: 1}\n    - {name: M, value: 1}",
            4,
            "The lesson 'L' of a has no completion_criter",
        ),
        (
            CURRICULUM
            + "name: L\n      value: 1\n      completion_criteria:\n        measure: luck\n        behavior: A",
            7,
            "measure is 'luck', but one of reward, progress was expected.",
        ),
        (
            CURRICULUM + "name: L\n      value: 1\n      completion_criteria:\n        measure: reward",
            6,
            "completion_criteria has no behavior, which it needs.",
        ),
        (
            CURRICULUM + "name: L\n      value: 1\n      completion_criteria:\n        behavior: A\n"
            "        measure: progress\n        threshold: 2",
            9,
            "threshold is 2, but with measure progress it is a share of max_steps, and a number from 0 to 1 was",
        ),
    ],
)
def test_what_cant_be_used_is_named_with_its_file_and_line(read, tmp_path, text, line, says):
    with pytest.raises(TrainerError, match=f"^{tmp_path}/it.yaml, line {line}: .*{says}") as refused:
        read(text)
    assert str(refused.value).endswith(".")


def test_sections_whose_lines_are_all_comments_say_nothing(read):
    assert read("behaviors:\nenv_settings:\n# num_envs: 5\ndefault_settings:\n") == RunOptions()
    assert read("") == RunOptions()


def test_a_samplers_number_may_be_what_yaml_reads_as_a_text(read):
    text = UNIFORM + "{min_value: 1e-3, max_value: 1}}\n  b: 1e-3"
    parameters = read(text).environment_parameters
    assert parse_parameter("a", parameters["a"], 5) == Uniform(5, 0.001, 1.0)
    assert parse_parameter("b", parameters["b"], 5) == 0.001


def test_cuda_0_is_cuda_and_a_seed_of_minus_one_is_none(read):
    assert read("torch_settings: {device: 'cuda:0'}").torch_settings == TorchSettings("cuda")
    assert read("env_settings: {seed: -1}").env_settings == EnvSettings()


def test_numbers_among_a_builds_arguments_are_texts(read):
    assert read("env_settings: {env_args: [--agents, 5]}").env_settings.env_args == ["--agents", "5"]


def test_a_graphics_less_build_is_what_no_graphics_says(read):
    assert read("engine_settings: {no_graphics: false}").graphics is True
    assert read("engine_settings: {width: 100}").graphics is None


SECTIONS = st.sampled_from(
    ["behaviors", "default_settings", "env_settings", "engine_settings", "environment_parameters", "torch_settings"]
)
OF_LESSONS = ["curriculum", "name", "value", "completion_criteria", "sampler_type", "sampler_parameters", "uniform"]
OF_OTHERS = ["seed", "device", "width", "hyperparameters", "trainer_type", "no_graphics", "max_steps", "reward_signals"]
NAMES = st.text(max_size=4) | st.sampled_from([*OF_LESSONS, *OF_OTHERS])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | NAMES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=4),
    max_leaves=15,
)


@given(st.dictionaries(SECTIONS | NAMES, st.dictionaries(NAMES, VALUES, max_size=3) | VALUES, max_size=3))
def test_any_file_is_taken_or_refused_in_one_sentence(tmp_path_factory, values):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(yaml.safe_dump(values))
    said = ""
    try:
        RunOptions.read(path)
    except TrainerError as error:
        said = str(error)
    assert said == "" or (said.startswith(str(path)) and said.endswith(".") and "\n" not in said)
