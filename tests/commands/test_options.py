"""An option says everything about itself in one place: type, default, help and range."""

import math
import re
from dataclasses import dataclass
from typing import Annotated

import pytest
import tyro

from corridor_server.shared.given import Range
from trainer.command_line import OF_MLAGENTS_LEARN
from trainer.commands.evaluate import Evaluate
from trainer.commands.replay import Replay
from trainer.commands.shared_options import ExistingRun
from trainer.commands.train import Train
from trainer.config import ConnectionOptions, EngineConfig, PortOptions, RestartLimits
from trainer.errors import TrainerError
from trainer.hyperparameters import CuriosityConfig, PPOConfig
from trainer.main import main
from trainer.options import Count, Options, Port, Seconds, Seed


@dataclass(frozen=True)
class Example(Options):
    """Of each kind one."""

    steps: Count = 1
    """Agent steps."""
    at_a_time: Count | None = None
    ratio: Annotated[float, Range(0, 1000)] = 0.3
    wait: Seconds = 1.0
    port: Port = 5005
    seed: Seed = 0


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ({"steps": 0}, "--steps is 0, but a whole number from 1 up was expected."),
        ({"at_a_time": 0}, "--at-a-time is 0, but a whole number from 1 up was expected."),
        ({"ratio": 1000.5}, "--ratio is 1000.5, but a number from 0 to 1000 was expected."),
        ({"ratio": math.nan}, "--ratio is nan, but a number from 0 to 1000 was expected."),
        ({"wait": math.inf}, "--wait is inf, but seconds above 0 were expected."),
        ({"wait": 2e9}, "--wait is 2e+09, but at most 1,000,000,000 seconds were expected."),
        (
            {"steps": 10**401},
            "--steps is an integer of more than 40 digits, but a whole number from 1 up was expected.",
        ),
        ({"steps": True}, "--steps is True, but a whole number from 1 up was expected."),
        ({"wait": 0.0}, "--wait is 0, but seconds above 0 were expected."),
        ({"port": 0}, "--port is 0, but a whole number from 1 up was expected."),
        ({"port": 65536}, "--port is 65536, but ports end at 65535."),
        ({"seed": -1}, "--seed is -1, but a whole number from 0 up was expected."),
        ({"seed": 2**31}, "--seed is 2147483648, but the protocol carries seeds below 2147483648."),
    ],
)
def test_a_value_out_of_its_range_is_refused_when_the_options_are_made(option, says):
    with pytest.raises(TrainerError) as refused:
        Example(**option)
    assert str(refused.value) == says


def test_values_at_the_ends_of_their_range_are_taken():
    Example(ratio=0.0, wait=1e-9, port=1)
    Example(ratio=1000.0, wait=1e9, port=65535, seed=2**31 - 1)


def test_an_option_that_must_be_whole_takes_no_fraction():
    EngineConfig(width=640)
    with pytest.raises(TrainerError, match=r"The engine setting width is 84.5, but a whole number from 1 to 16384 was"):
        EngineConfig(width=84.5)


@pytest.mark.parametrize("config", [PPOConfig, CuriosityConfig])
def test_layers_that_no_machine_has_room_for_are_refused(config):
    config(hidden_size=4096)
    with pytest.raises(TrainerError, match="hidden_size is 4097, but a whole number from 1 to 4096 was expected"):
        config(hidden_size=4097)


def test_the_string_below_a_field_is_its_help(capsys):
    with pytest.raises(SystemExit):
        tyro.cli(Example, args=["--help"])
    assert "Agent steps. (default: 1)" in capsys.readouterr().out


def test_minus_one_restart_is_no_limit_and_less_is_refused():
    RestartLimits(-1, -1)
    with pytest.raises(
        TrainerError, match="--restarts-rate-limit-n is -2, but a whole number from 0 up was expected, or"
    ):
        RestartLimits(1, -2)


@pytest.mark.parametrize(
    ("command", "made"),
    [
        (
            ["train", "--run-id", "r", "--base-port", "6000", "--listen", "::1", "--timeout-wait", "5"],
            Train("r", connection=ConnectionOptions(5, 6000, "::1")),
        ),
        (
            ["evaluate", "r", "--base-port", "6000", "--listen", "::1", "--timeout-wait", "5"],
            Evaluate(ExistingRun("r"), connection=ConnectionOptions(5, 6000, "::1")),
        ),
        (
            ["replay", "r", "--base-port", "6000", "--timeout-wait", "5"],
            Replay(ExistingRun("r"), connection=PortOptions(5, 6000)),
        ),
    ],
)
def test_commands_share_the_connections_options_under_their_own_names(command, made, monkeypatch):
    seen = []
    monkeypatch.setattr(type(made), "run", lambda command, typed: seen.append((command, typed)) or 0)
    assert main(command) == 0
    assert seen == [(made, " ".join(["corridor", *command]))]


@pytest.mark.parametrize(
    "command", [["train", "--run-id", "r"], ["evaluate", "r"], ["replay", "r"], ["study", "penalty"]]
)
def test_a_shared_option_is_refused_with_one_sentence_by_every_command(command, capsys):
    assert main([*command, "--timeout-wait", "0"]) == 1
    said = capsys.readouterr().err.strip()
    name = " ".join(command[: 1 + (command[0] == "study")])
    expected = "a whole number from 1 up was expected"
    assert said == f"error: --timeout-wait is 0, but {expected}; see corridor {name} --help."


@pytest.mark.parametrize("option", OF_MLAGENTS_LEARN)
def test_an_option_of_mlagents_learns_is_answered_with_what_it_is_here(option, capsys):
    for typed in ([option], [f"{option}=x"]):
        assert main(["train", "--run-id", "r", *typed]) == 1
        assert capsys.readouterr().err.startswith(f"error: {option} is mlagents-learn's; ")
    for ours in re.findall(r"--[a-z-]+", OF_MLAGENTS_LEARN[option]):
        with pytest.raises(SystemExit):
            main(["train", "--help"])
        assert ours in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (
            ["evaluate", "r", "--env-args", "--episodes", "3"],
            "--env-args is for corridor train, study and check, and a run keeps",
        ),
        (["check", "--env", "editor", "--env-args", "-x"], "--env-args is for players that are launched"),
        (
            ["train", "--run-id", "r", "--env", "editor", "--env-args", "-x"],
            "--env-args is for players that are launched",
        ),
        (["train", "--run-id", "r", "--graphics"], "--graphics is for builds .* but --env builtin draws nothing"),
        (["train", "--run-id", "r", "--env", "editor", "--graphics"], "--graphics .* but --env editor is not launched"),
        (["train", "--run-id", "r", "--time-scale", "20"], "--time-scale is for Unity's engine, but --env builtin has"),
        (["train", "--run-id", "r", "--c", "0", "--intrinsic", "rnd"], "--intrinsic rnd has no effect with --c 0"),
        (["train", "--run-id", "r", "--env", "editor", "--base-port", "6000"], "--base-port 6000 .* has port 5004"),
        (["train", "--run-id", "r", "--env", "localhost:7000", "--base-port", "6000"], "--base-port .* has port 7000"),
        (["train", "--run-id", "r", "--env", "localhost:7000", "--listen", "::1"], "--listen ::1 has no effect on"),
        (["replay", "study", "--checkpoint", "step-1"], "--checkpoint step-1 is a run's, but study is a study"),
    ],
)
def test_an_option_that_would_have_no_effect_is_refused(command, says, capsys, tmp_path, monkeypatch):
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "claims.json").touch()
    monkeypatch.chdir(tmp_path)
    assert main(command) == 1
    assert re.match(f"error: {says}", capsys.readouterr().err)
