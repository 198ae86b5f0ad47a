"""The kit's own test: players with one fault each, and the sentence that must fail.

Verdicts are ``pytest.fail``'s: all of this holds under ``python -O`` too, which strips ``assert``.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN

from trainer import conformance
from trainer.conformance.checker import Result, check, sentences
from trainer.conformance.suite import NotAsExpected, expect, expect_equal

PLAYER = """#!{python}
import sys
import numpy as np
from corridor_server import player
from corridor_server.corridor import areas, world
from corridor_server.protocol import wire
from corridor_server.main import main
{fault}
sys.exit(main())
"""

FAULTS = {
    "reused ids": (
        conformance.Episodes,
        "every_episode_has_an_id_that_was_not_used_before",
        """
begin = areas.Areas._begin
def begin_with_old_ids(self, rows):
    ids = self._ids.copy()
    begin(self, rows)
    if ids.any():
        self._ids[:] = ids
areas.Areas._begin = begin_with_old_ids
""",
    ),
    "swapped action order": (
        conformance.CorridorContract,
        "each_action_reaches_the_agent_that_asked_in_that_place",
        "checked = wire._checked\nwire._checked = lambda actions, *rest: checked(actions, *rest)[::-1]",
    ),
    "reward not reset": (
        conformance.CorridorContract,
        "a_step_far_from_everything_costs_a_thousandth",
        """
step = world.step
def step_adding_up(p, state, action):
    state, outcome = step(p, state, action)
    outcome.reward[:] = np.where(outcome.ended, outcome.reward, state.episode_return)
    return state, outcome
world.step = step_adding_up
""",
    ),
    "missing terminal message": (
        conformance.Episodes,
        "an_agent_keeps_its_id_until_it_has_ended",
        """
output = wire.output
def output_of_the_living(behavior, agents, *rest):
    return output(behavior, agents.deciding, *rest)
wire.output = output_of_the_living
""",
    ),
    "terminal reward lost": (
        conformance.CorridorContract,
        "a_failed_episode_pays_the_penalty_with_its_last_reward",
        """
output = wire.output
def output_without_last_rewards(behavior, agents, *rest):
    agents.rewards[agents.done] = 0
    return output(behavior, agents, *rest)
wire.output = output_without_last_rewards
""",
    ),
    "brain parameters late": (
        conformance.Handshake,
        "every_behavior_is_introduced_in_the_message_that_has_its_first_agents",
        """
output, sent = wire.output, []
def output_introducing_late(behavior, agents, side_channel, introduce, *rest):
    sent.append(agents)
    return output(behavior, agents, side_channel, len(sent) == 2, *rest)
wire.output = output_introducing_late
""",
    ),
    "wrong shape": (
        conformance.Episodes,
        "observations_have_as_many_values_as_their_shape_says",
        """
output = wire.output
def output_with_another_shape(behavior, *rest):
    message = wire.UnityMessageProto.FromString(output(behavior, *rest))
    for info in message.unity_output.rl_output.agentInfos[behavior.name].value:
        info.observations[0].shape[0] += 1
    return message.SerializeToString()
wire.output = output_with_another_shape
""",
    ),
    "ignoring QUIT": (
        conformance.Shutdown,
        "quit_ends_the_player_with_code_0",
        "wire._ends = lambda message: message.header.status != wire.OK\nwire.STEP = 2  # QUIT, taken for a STEP",
    ),
    "ignoring num_areas": (
        conformance.Handshake,
        "the_number_of_areas_is_the_trainers",
        "make = player.Areas\nplayer.Areas = lambda config, seed, numbers, camera: make(config, seed, [0], camera)",
    ),
    "stale observation after reset": (
        conformance.CorridorContract,
        "a_reset_in_mid_episode_shows_a_new_start",
        """
reset = areas.Areas.reset
def reset_showing_the_past(self):
    past = world.observation(self.parameters.columns, self.state)
    agents = reset(self)
    if past.any():
        agents.observations[0][:] = past
    return agents
areas.Areas.reset = reset_showing_the_past
""",
    ),
}


def failures(topic: type[conformance.Conformance], name: str, player: Path) -> list[Result]:
    """Runs one sentence of a topic on a player."""
    if f"test_{name}" not in sentences(topic):
        pytest.fail(f"{topic.__name__} has no sentence {name}")
    others = {other: None for other in sentences(topic) if other != f"test_{name}"}
    only = type(topic.__name__, (topic,), {**others, "__doc__": topic.__doc__})
    results: list[Result] = []

    def start(port: int, *arguments: str) -> "subprocess.Popen[bytes]":
        return subprocess.Popen([str(player), "--mlagents-port", str(port), *arguments])

    check([only], start, results.append)
    if len(results) != 1:
        pytest.fail(f"{len(results)} sentences were checked")
    return [result for result in results if result.verdict == "fail"]


def write_player(folder: Path, fault: str) -> Path:
    path = folder / "player"
    path.write_text(PLAYER.format(python=sys.executable, fault=fault))
    path.chmod(0o755)
    return path


@pytest.mark.parametrize("fault", FAULTS)
def test_a_player_with_one_fault_fails_its_sentence(fault, tmp_path):
    topic, name, code = FAULTS[fault]
    found = failures(topic, name, write_player(tmp_path, code))
    if not found:
        pytest.fail(f"{fault}: nothing failed")
    if not found[0].detail:
        pytest.fail(f"{fault}: not a word about what was seen")


def test_a_broken_player_is_caught_under_python_without_asserts():
    this = f"{__file__}::test_a_player_with_one_fault_fails_its_sentence[wrong shape]"
    command = [sys.executable, "-O", "-m", "pytest", "-q", "-p", "no:cacheprovider", this]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if run.returncode or "1 passed" not in run.stdout:
        pytest.fail(run.stdout)


def test_no_bare_assert_is_left_in_the_kit():
    modules = sorted(Path(conformance.__file__).parent.glob("*.py"))
    found = [
        f"{path.name}:{node.lineno}"
        for path in modules
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Assert)
    ]
    if len(modules) < 10 or found:
        pytest.fail(f"asserts in {len(modules)} modules: {found}")


def test_a_failure_says_what_came_and_what_was_expected():
    with pytest.raises(NotAsExpected, match="^no agents; at least one was expected$"):
        expect([], "no agents", "at least one")
    with pytest.raises(NotAsExpected, match="^exit code 1; 0 was expected$"):
        expect_equal(1, 0, "exit code")
    expect([1], "no agents", "at least one")
    expect_equal(0, 0, "exit code")


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["wrong shape"])
def test_corridor_check_prints_a_table_and_fails(fault, tmp_path):
    player = write_player(tmp_path, FAULTS[fault][2])
    command = [BIN / "corridor", "check", "--env", player]
    stripped = {**os.environ, "PYTHONOPTIMIZE": "1", "COLUMNS": "180"}  # without asserts, and each row on one line
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=stripped)
    if run.returncode != 1 or "fail" not in run.stdout:
        pytest.fail(run.stdout)
    if "shape [14] with 13 values; 14 was expected" not in run.stdout:
        pytest.fail(run.stdout)


def test_corridor_check_of_nothing_says_so(tmp_path):
    run = subprocess.run([BIN / "corridor", "check", "--env", tmp_path / "none"], capture_output=True, text=True)
    if run.returncode != 1 or "There is no player" not in run.stderr:
        pytest.fail(run.stderr)


def test_corridor_check_of_a_program_that_is_no_player_says_so():
    arguments = ["check", "--env", "/bin/true", "--timeout-wait", "1"]
    run = subprocess.run([BIN / "corridor", *arguments], capture_output=True, text=True)
    if run.returncode != 1 or "The player does not play: the player sent nothing for 1 s" not in run.stderr:
        pytest.fail(run.stderr)
