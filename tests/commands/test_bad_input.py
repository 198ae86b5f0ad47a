"""What a user can get wrong ends in one sentence and exit code 1."""

import os
import re
import socket
import sys
from pathlib import Path

import pytest
import yaml
from conftest import corridor_here


def fails(*arguments: object, says: str) -> None:
    run = corridor_here(*arguments)
    message = run.stderr.strip().splitlines()
    assert run.returncode == 1, run.stderr
    assert re.search(says, message[-1]), run.stderr
    assert message[-1].startswith("error: ")


def player(folder: Path, body: str) -> Path:
    """An executable that behaves as its body says."""
    path = folder / "player"
    path.write_text(f"#!{sys.executable}\nimport sys, time\n{body}")
    path.chmod(0o755)
    return path


def test_an_existing_run_needs_resume_or_force(tmp_path):
    (tmp_path / "mine").mkdir()
    fails("train", "--run-id", "mine", "--results-dir", tmp_path, says="'mine' exists .* --resume, .* --force")


def test_force_leaves_a_folder_alone_that_is_no_run(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years")
    fails("train", "--run-id", "mine", "--results-dir", tmp_path, "--force", says="is not a run's folder")
    assert (tmp_path / "mine" / "thesis.tex").exists()


def test_resuming_a_run_that_does_not_exist(tmp_path):
    fails("train", "--run-id", "none", "--results-dir", tmp_path, "--resume", says="There is no run 'none'")


@pytest.mark.parametrize("run_id", ["a/b", "..", "", "a b"])
def test_a_run_id_must_name_a_folder(tmp_path, run_id):
    fails("train", f"--run-id={run_id}", "--results-dir", tmp_path, says="can't name a folder")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--steps", 0), "--steps is 0, but a whole number from 1 up was expected"),
        (("--num-areas", -3), "--num-areas is -3"),
        (("--seed", -1), "--seed is -1"),
        (("--seed", 2**31), "--seed is 2147483648"),
        (("--c", -0.1), "--c is -0.1, but a number from 0 to 1000 was expected"),
        (("--c", "nan"), "--c is nan"),
        (("--base-port", 70000), "--base-port is 70000, but ports end at 65535"),
        (("--preset", "paper", "--num-areas", 4), "preset paper trains one area"),
        (("--resume", "--force"), "give one of them"),
    ],
)
def test_an_option_out_of_its_range(tmp_path, options, says):
    fails("train", "--run-id", "r", "--results-dir", tmp_path, *options, says=says)
    assert not (tmp_path / "r").exists()


def test_a_missing_executable(tmp_path):
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--env", tmp_path / "Corridor", says="There is no player"
    )
    assert not (tmp_path / "r").exists()


def test_an_executable_without_permission(tmp_path):
    path = player(tmp_path, "")
    path.chmod(0o644)
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--env", path, says="may not be executed; run 'chmod \\+x"
    )
    assert not (tmp_path / "r").exists()


def test_a_port_in_use(tmp_path, free_port):
    with socket.create_server(("127.0.0.1", free_port)):
        fails(
            "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port,
            says=f"Port {free_port} on localhost is in use; choose another with --base-port",
        )  # fmt: skip


def test_a_player_that_never_dials(tmp_path, free_port):
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--timeout-wait", 1,
        "--env", player(tmp_path, "time.sleep(30)"),
        says=f"No player dialled in on localhost:{free_port} within 1 s; .*--timeout-wait",
    )  # fmt: skip


def test_nobody_dials_a_host_and_port(tmp_path, free_port):
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--env", f"localhost:{free_port}", "--timeout-wait", 1,
        says=f"No player dialled in on localhost:{free_port} within 1 s",
    )  # fmt: skip


def test_a_player_that_ends_at_once(tmp_path, free_port):
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port,
        "--env", player(tmp_path, "sys.exit(3)"), says="Environment shut down with return code 3",
    )  # fmt: skip


def test_a_wrong_observation_size_says_what_was_expected_and_what_came(tmp_path, free_port):
    body = """
import corridor_server.corridor.world as world
from corridor_server.corridor.corridor_config import CorridorConfig
whole = world.observation
world.observation = lambda p, state: whole(p, state)[:, :11]
CorridorConfig.observation_size = 11
from corridor_server.main import main
sys.exit(main())
"""
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--env", player(tmp_path, body),
        says=r"observations of shapes \[\(11,\)\], but one vector of 8 \+ 5K floats .* was expected",
    )  # fmt: skip


def test_a_wrong_action_size_says_what_was_expected_and_what_came(tmp_path, free_port):
    body = """
import corridor_server.corridor.world as world
world.ACTION_SIZE = 3
from corridor_server.main import main
sys.exit(main())
"""
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--env", player(tmp_path, body),
        says="has 3 continuous actions and 0 discrete branches, but 2 continuous actions",
    )  # fmt: skip


def test_evaluating_what_does_not_exist(tmp_path):
    fails("evaluate", "none", "--results-dir", tmp_path, says="No run 'none'")


def test_evaluating_a_run_without_a_checkpoint(tmp_path, free_port):
    from trainer.commands.train import Train

    folder = tmp_path / "empty"
    folder.mkdir()
    (folder / "configuration.yaml").write_text(yaml.safe_dump({"run": Train("empty").run_config().as_dict()}))
    fails("evaluate", "empty", "--results-dir", tmp_path, "--base-port", free_port, says="holds no checkpoint")
    (folder / "checkpoints").mkdir()
    (folder / "checkpoints" / "step-0000000001.safetensors").write_bytes(os.urandom(100))
    fails(
        "evaluate", "empty", "--results-dir", tmp_path, "--base-port", free_port, says="is damaged: it has no checksum"
    )


def test_evaluating_a_broken_configuration(tmp_path):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "configuration.yaml").write_text("run: {seed: 1}")
    fails("evaluate", "broken", "--results-dir", tmp_path, says="is missing or not a run's configuration")


def test_resuming_with_other_settings_lists_them(tmp_path):
    from trainer.commands.train import Train

    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "configuration.yaml").write_text(yaml.safe_dump({"run": Train("mine").run_config().as_dict()}))
    fails(
        "train", "--run-id", "mine", "--results-dir", tmp_path, "--resume", "--seed", 5, "--c", 0.1,
        says=r"begun with other settings: curiosity.c 0.3 -> 0.1 \(not allowed\), seed 0 -> 5 \(not allowed\); give",
    )  # fmt: skip


MID_RUN = """
import numpy as np
import corridor_server.protocol.wire as wire
output, count = wire.output, []
def output_going_bad(parts, *rest):
    [(_, agents)] = parts
    count.append(1)
    if len(count) == 30:
        {fault}
    return output(parts, *rest)
wire.output = output_going_bad
from corridor_server.main import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("return b'\\xff' * 9", "The player sent 9 bytes that are not a message of the ML-Agents protocol."),
        (
            "return b'\\x0a\\x03\\x08\\xc8\\x01\\xff'",
            "The player sent 6 bytes that are not a message",
        ),
        (
            "agents.deciding.observations[0][3, 2] = np.nan",
            "After step [0-9,]+: The player sent observation\\[2\\] = nan of agent [0-9]+ in area 3, but",
        ),
        (
            "agents.deciding.rewards[0] = np.inf",
            "After step [0-9,]+: The player sent reward = inf of agent [0-9]+ in area 0, but",
        ),
        ("agents.deciding.ids[:] = 7", "The player sent agent 7 8 times in one message where it asks for a decision"),
    ],
)
def test_a_player_that_goes_bad_in_mid_run_is_named_and_the_runs_data_kept(tmp_path, free_port, fault, says):
    fails(
        "train", "--run-id", "r", "--results-dir", tmp_path, "--base-port", free_port, "--num-areas", 8,
        "--env", player(tmp_path, MID_RUN.format(fault=fault)), says=says,
    )  # fmt: skip
    assert list((tmp_path / "r" / "checkpoints").glob("step-*.safetensors"))
