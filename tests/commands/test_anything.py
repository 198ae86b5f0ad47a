"""Whatever a number, a path, an address or a file turns out to be: it is taken, or refused in one sentence."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from asked import asked
from conftest import BIN

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from anything import try_anything

from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.gym_env import CorridorEnv
from corridor_server.shared.addresses import free_addresses, is_loopback, parse_address, parse_host
from corridor_server.shared.given import Range, shown
from trainer.commands.bench import Bench
from trainer.commands.train import Train
from trainer.config import ConnectionOptions, RunConfig
from trainer.errors import TrainerError
from trainer.players.opening import open_environment
from trainer.run_options import RunOptions
from trainer.runs.folder import RunFolder
from trainer.terminal import Terminal


def test_every_entry_takes_anything_or_says_why_not():
    failures: list[str] = []
    try_anything(60, lambda what, error: failures.append(f"{what}: {error!r}"), derandomize=True)
    assert failures == []


@pytest.mark.parametrize("value", [2, 2.0, np.int64(2), np.float32(2), np.array(2.0)])
def test_a_parameter_is_a_number_of_any_kind(value):
    assert CorridorEnv(opponent_speed=value).config.opponent_speed == 2.0
    assert type(CorridorEnv(opponent_speed=value).config.opponent_speed) is float
    assert RunOptions(environment_parameters={"goal_x": value}).parameters((), True) == {"goal_x": value}


@pytest.mark.parametrize(
    "value",
    [10**401, 10**5000, math.nan, np.float64("inf"), "2", True, None, [2], np.array([2])],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_number_of_the_range_is_refused(value):
    assert Range(0, 100).read(value) is None
    with pytest.raises(ValueError, match="opponent_speed is .*, but a number from 0 to 100 m/s was expected."):
        CorridorEnv(opponent_speed=value)


@pytest.mark.parametrize("text", ["2020-13-45", "9" * 401, "9" * 5000, "0x" + "f" * 5000, "[" * 3000, "!!timestamp x"])
def test_a_value_of_a_file_that_yaml_itself_cant_read_or_nobody_can_write(tmp_path, text):
    path = tmp_path / "settings.yaml"
    path.write_text(f"environment_parameters:\n  opponent_speed: {text}\n")
    with pytest.raises(TrainerError) as refused:
        RunOptions.read(path).parameters((), True)
    assert len(str(refused.value)) < 700
    path.write_text(f"opponent_speed: {text}\n")
    with pytest.raises(ValueError, match="settings.yaml"):
        CorridorConfig.from_file(path)


def test_a_file_that_refers_to_itself_a_billion_times_is_shown_short(tmp_path):
    lines = ["a0: &a0 [x]", *(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]" for n in range(12))]
    (tmp_path / "bomb.yaml").write_text("\n".join(lines))
    with pytest.raises(TrainerError, match="There is no section 'a0'"):
        RunOptions.read(tmp_path / "bomb.yaml")
    itself: list[object] = []
    itself.append(itself)
    assert len(shown([itself] * 100)) < 500


@pytest.mark.parametrize(
    ("name", "value"),
    [("seed", "x"), ("steps", math.nan), ("num_areas", 1.5), ("env_args", [1]), ("run_id", "../x"), ("env", "a\0b")],
)
def test_a_recorded_setting_is_held_to_its_type_and_range(name, value):
    with pytest.raises(TrainerError):
        RunConfig.from_dict({**Train("r").run_config().as_dict(), name: value})


def test_more_areas_than_our_player_has_are_refused_by_the_trainer():
    with pytest.raises(TrainerError, match="--num-areas is 70000, but the built-in player has at most 65536"):
        asked("r", num_areas=70_000).run_config()
    asked("r", num_areas=70_000, env="Other.x86_64").run_config()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--timeout-wait", "nan"], "it is 'nan', but a number from 0 to 1000000000 was expected"),
        (["--timeout-wait=-3"], "it is '-3', but a number from 0 to 1000000000 was expected"),
        (["--mlagents-port", "70000"], "it is '70000', but a whole number from 1 to 65535 was expected"),
        (["--host", ""], "'' is no host; a name or an address was expected, such as localhost"),
        (["--host", "unix:/tmp/x"], "'unix:/tmp/x' is no host"),
    ],
)
def test_the_players_flags_are_held_to_their_range(options, says, capsys):
    from corridor_server.main import main

    with pytest.raises(SystemExit):
        main(options)
    assert says in capsys.readouterr().err


def test_a_file_is_refused_before_the_work_that_it_is_for(tmp_path):
    for options in ({"official": "/nonexistent"}, {"json": tmp_path / "no" / "x.json"}, {"plot": tmp_path}):
        with pytest.raises(TrainerError, match=f"--{next(iter(options))} "):
            Bench(**options).run("corridor bench")


@pytest.mark.parametrize(
    ("text", "host", "loopback"),
    [
        ("localhost", "localhost", True),
        ("127.0.0.1", "127.0.0.1", True),
        ("127.9.9.9", "127.9.9.9", True),
        ("::1", "::1", True),
        ("[::1]", "::1", True),
        ("::ffff:127.0.0.1", "127.0.0.1", True),
        ("0.0.0.0", "0.0.0.0", False),
        ("[::]", "::", False),
        ("192.0.2.1", "192.0.2.1", False),
        ("nowhere.invalid", "nowhere.invalid", False),
    ],
)
def test_a_host_is_a_name_or_an_address_in_any_form(text, host, loopback):
    assert parse_host(text) == host
    assert ConnectionOptions(listen=text).listen == host
    assert parse_address(f"{text}:7111") == (host, 7111)
    assert is_loopback(host) == loopback


@pytest.mark.parametrize("text", ["", "[", "[localhost]", "a b", "a..b", "x" * 70, "unix:/tmp/x", "[::1", "1:2:3"])
def test_what_is_no_host_is_refused_as_one(text):
    with pytest.raises(
        TrainerError, match="--listen can't be used: '.*' is no host; a name or an address was expected"
    ):
        ConnectionOptions(listen=text)


@pytest.mark.parametrize(
    ("listen", "says"),
    [
        ("192.0.2.1", "The host '192.0.2.1' is no address of this machine, so nothing can listen there"),
        ("nowhere.invalid", "The host 'nowhere.invalid' is not known"),
        ("localhost:99999", "Port 99999 does not exist"),
        (":7111", "'' is no host"),
    ],
)
def test_what_cant_be_listened_on_says_what_failed(listen, says):
    env = listen if ":" in listen else f"{listen}:7111"
    with pytest.raises(TrainerError, match=says):
        open_environment(env, seed=0, num_areas=1, port=0, timeout_wait=1)


def test_our_player_plays_over_ipv6(free_port, capfd):
    try:
        free_addresses("::1", free_port)
    except ValueError:
        pytest.skip("this machine has no IPv6")
    environment = open_environment("builtin", seed=0, num_areas=2, port=free_port, timeout_wait=60, listen="[::1]")
    environment.reset()
    environment.close()
    assert "Warning: listening" not in capfd.readouterr().err


def test_text_is_never_markup_or_a_control_code(capsys):
    text = "run[/old]s [bold]x[/] :smile: \x1b]0;title\x07 \u202e \udce9 {0} %s"
    Terminal().print(text)
    Terminal(stderr=True).print_failure("error:", text)
    shown = "run[/old]s [bold]x[/] :smile: \\x1b]0;title\\x07 \\u202e \\udce9 {0} %s"
    out, err = capsys.readouterr()
    assert (out.strip(), err.strip()) == (shown, f"error: {shown}")


@pytest.mark.parametrize("run", ["a" * 300, "..", "\udce9", "[/x]", "a\0b", "/".join(["a" * 200] * 30)])
def test_a_name_that_no_run_can_have_is_no_run(tmp_path, run):
    (tmp_path / "configuration.yaml").touch()
    with pytest.raises(TrainerError, match="No run "):
        RunFolder.find(run, tmp_path / "results")


def test_a_run_in_a_folder_whose_name_is_markup_or_a_pattern(tmp_path):
    folder = tmp_path / os.fsdecode(b"run[/old]s[a-z]*\xe9") / "mine"
    folder.mkdir(parents=True)
    (folder / "configuration.yaml").touch()
    command = [BIN / "corridor", "evaluate", "mine", "--results-dir", folder.parent]
    run = subprocess.run(command, capture_output=True, timeout=60)
    assert run.returncode == 1
    assert run.stderr.startswith(f"error: {tmp_path}/run[/old]s[a-z]*\\udce9/mine/configuration.yaml is miss".encode())
