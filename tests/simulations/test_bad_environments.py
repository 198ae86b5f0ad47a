"""What is wrong with an environment or its options ends in one sentence, an exit code, and a trainer that knows."""

import logging
import signal
import subprocess
import sys
import threading
import time
import types

import gymnasium
import numpy as np
import pytest
from conftest import BIN
from gymnasium import spaces
from mlagents_envs.exception import UnityCommunicatorStoppedException, UnityEnvironmentException
from simulations.zoo import served

from corridor_server.main import main

NOBODY = ["--mlagents-port", "1", "--timeout-wait", "0"]  # it must not come so far
STOPPED = (UnityCommunicatorStoppedException, UnityEnvironmentException)

PROGRAM = """
import os, signal, time
import gymnasium
import numpy as np
from gymnasium import spaces

class Failing(gymnasium.Env):
    observation_space = spaces.Box(-1, 1, (2,))
    action_space = spaces.Discrete(2)
    def __init__(self, how="raise", after=3):
        self.how, self.after, self.left = how, after, after
    def reset(self, *, seed=None, options=None):
        if self.after == 0:
            raise ValueError("no fuel")
        return np.zeros(2, np.float32), {}
    def step(self, action):
        self.left -= 1
        if self.left == 0:
            self.fail()
        return np.zeros(2, np.float32), 0.0, False, False, {}
    def fail(self):
        if self.how == "raise":
            raise ValueError("no fuel")
        if self.how == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.how == "exit":
            raise SystemExit(0)
        open("working", "w").close()
        time.sleep(60)

gymnasium.register("Failing-v0", Failing)

class parallel_env:
    possible_agents = ["a_0", "a_1"]
    def observation_space(self, agent):
        return spaces.Box(-1, 1, (2,))
    def action_space(self, agent):
        return spaces.Discrete(2)
    def reset(self, seed=None, options=None):
        self.agents = self.possible_agents
        return {agent: np.zeros(2) for agent in self.agents}, {}
    def step(self, actions):
        return ({"a_0": np.zeros(2), "a_1": np.zeros(3)}, dict.fromkeys(actions, 0.0), dict.fromkeys(actions, False),
                dict.fromkeys(actions, False), {})
    def close(self):
        pass
"""


@pytest.fixture
def serve_failing(tmp_path, free_port, monkeypatch):
    """Serves the environments above with these options."""
    (tmp_path / "failing.py").write_text(PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return lambda *options, **others: served(free_port, tmp_path, *options, **others)


def log_and_code(environment, folder):
    code = environment._process.wait(20)
    return (folder / "Player-0.log").read_text().splitlines(), code


def play_three_steps(environment):
    environment.reset()
    for _ in range(3):
        environment.step()


@pytest.mark.parametrize(
    ("options", "said", "traceback"),
    [
        ([], "failed in a step (ValueError: no fuel).", True),
        (["--vectorization-mode", "async"], "failed in a step (ValueError: no fuel).", True),
        (["--env-kwargs", '{"how": "exit"}'], "failed in a step (SystemExit: 0).", True),
        (
            ["--env-kwargs", '{"how": "die"}', "--vectorization-mode", "async"],
            "failed in a step (EOFError: its process ended).",
            False,
        ),
        (["--env-kwargs", '{"after": 0}'], "failed in a reset (ValueError: no fuel).", True),
    ],
)
def test_an_environment_that_fails_in_the_middle_is_told_to_the_trainer_at_once(
    options, said, traceback, serve_failing, tmp_path
):
    with serve_failing("--gym", "failing:Failing-v0", *options, num_areas=2) as environment:
        begun = time.monotonic()
        with pytest.raises(STOPPED):
            play_three_steps(environment)
        assert time.monotonic() - begun < 10
        lines, code = log_and_code(environment, tmp_path)
    assert code == 1
    assert lines[-1].endswith(f"ERROR failing:Failing-v0 {said}")
    in_its_code = any("failing.py" in line and "line" in line for line in lines)
    assert in_its_code == traceback


def test_agents_of_which_something_cant_be_used_end_the_session_in_the_same_way(serve_failing, tmp_path):
    with serve_failing("--pettingzoo", "failing") as environment:
        environment.reset()
        with pytest.raises(STOPPED):
            environment.step()
        lines, code = log_and_code(environment, tmp_path)
    assert code == 1
    assert " ERROR failing gave in a step what can't be used (ValueError: " in lines[-1]


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_a_player_that_is_stopped_in_the_middle_of_a_step_ends_well(mode, serve_failing, tmp_path):
    options = ["--env-kwargs", '{"how": "work", "after": 1}', "--vectorization-mode", mode]
    with serve_failing("--gym", "failing:Failing-v0", *options) as environment:
        environment.reset()

        def stop_at_work():
            while not (tmp_path / "working").exists():
                time.sleep(0.01)
            environment._process.send_signal(signal.SIGTERM)

        threading.Thread(target=stop_at_work).start()
        with pytest.raises(STOPPED):
            environment.step()
        lines, code = log_and_code(environment, tmp_path)
    assert code == 0
    assert lines[-1].endswith("INFO Stopped by SIGTERM; the trainer is told.")


# Command lines, in this process.


@pytest.fixture
def said(capsys):
    """Runs a player; returns its exit code and what it said, without the time."""

    def run(*arguments):
        kept = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
        root, capsys_out = logging.getLogger(), None
        handlers, level, raises = root.handlers[:], root.level, logging.raiseExceptions
        try:
            code = main([*NOBODY, *arguments])
        except SystemExit as ended:
            code = ended.code
        finally:
            for number, handler in kept.items():
                signal.signal(number, handler)
            logging.captureWarnings(False)
            root.handlers[:], logging.raiseExceptions = handlers, raises
            root.setLevel(level)
            capsys_out = capsys.readouterr()
        return code, capsys_out.out + capsys_out.err

    return run


class Small(gymnasium.Env):
    observation_space, action_space = spaces.Box(-1, 1, (2,)), spaces.Discrete(2)

    def __init__(self, size=1):
        if size == 0:
            raise ValueError("too small")

    def reset(self, *, seed=None, options=None):
        return np.zeros(2, np.float32), {}


class Talking(Small):
    observation_space = spaces.Dict({"seen": spaces.Box(-1, 1, (2,)), "said": spaces.Text(5)})


class Writing(Small):
    action_space = spaces.Tuple([spaces.Discrete(2), spaces.Text(5)])


class Endless(Small):
    action_space = spaces.Discrete(2**31)


@pytest.fixture
def mine(monkeypatch):
    for kind in (Small, Talking, Writing, Endless):
        gymnasium.register(f"{kind.__name__}-v0", kind)
    monkeypatch.setitem(sys.modules, "mine", types.SimpleNamespace(parallel_env=lambda: None, broken=None))
    yield
    for kind in (Small, Talking, Writing, Endless):
        del gymnasium.registry[f"{kind.__name__}-v0"]


WRONG = {
    "--gym CartPoel-v1": "--gym is 'CartPoel-v1', but no such environment is registered; the nearest are CartPole-v1, ",
    "--gym CartPole-v99": "--gym is 'CartPole-v99', but no such environment is registered; the nearest are CartPole-v",
    "--gym qqqqqq": "--gym is 'qqqqqq', but no such environment is registered; give MODULE:ID for one that a package ",
    "--gym ": "--gym is '', but no such environment is registered; ",
    "--gym no_such_module:X-v0": "The module of --gym 'no_such_module:X-v0' can't be imported (ModuleNotFoundError: ",
    "--gym mine:X-v0": "--gym is 'mine:X-v0', but no such environment is registered; ",
    "--gym Talking-v0": "Talking-v0 observes said as Text, which can't be carried: only Box, Discrete, ",
    "--gym Talking-v0 --vectorization-mode async": "Talking-v0 observes said as Text, which can't be carried: only Box",
    "--gym Writing-v0": "Writing-v0 has the action[1] as Text, which can't be carried: only Box of floats, Discrete, ",
    "--gym Endless-v0": "Endless-v0 has 0 numbers and 2147483648 choices in an action, but at most 10000 can be ",
    '--gym Small-v0 --env-kwargs {"size":0}': "Small-v0 can't be made (ValueError: too small).",
    '--gym Small-v0 --env-kwargs {"weight":0}': "Small-v0 can't be made (TypeError: ",
    '--gym Small-v0 --env-kwargs {"num_envs":3}': "Small-v0 can't be made (TypeError: ",
    "--gym Small-v0 --camera 4x4": "Small-v0 can't be made (TypeError: ",
    "--gym Small-v0 --camera-raw": "--camera-raw says how a picture is sent, but Small-v0 has none; leave it out.",
    "--gym Small-v0 --parameters weight": "--parameters names 'weight', but Small-v0 has no such number; give an attr",
    "--gym Small-v0 --wrapper nothing": "--wrapper is 'nothing', but MODULE:NAME of a wrapper was expected (ValueError",
    "--gym Small-v0 --wrapper mine:Nothing": "--wrapper is 'mine:Nothing', but MODULE:NAME of a wrapper was expected (",
    "--gym Small-v0 --wrapper mine:broken": "Small-v0 can't be made (TypeError: 'NoneType' object is not callable).",
    "--gym Small-v0 --pettingzoo mine": "--gym and --pettingzoo are both given, but a player plays one of them.",
    "--gym Small-v0 --config x.yaml": "--config goes with the corridor, but --gym is played.",
    "--gym Small-v0 --team a=1": "--team goes with --pettingzoo, but --gym is played.",
    "--gym Small-v0 --group": "--group goes with --pettingzoo, but --gym is played.",
    "--gym Small-v0 --behavior a=.*": "--behavior goes with --pettingzoo, but --gym is played.",
    "--env-kwargs {}": "--env-kwargs goes with --gym or --pettingzoo, but the corridor is played.",
    "--parameters gravity": "--parameters goes with --gym or --pettingzoo, but the corridor is played.",
    "--wrapper a:b": "--wrapper goes with --gym, but the corridor is played.",
    "--pettingzoo mine --camera 4x4": "--camera goes with the corridor or --gym, but --pettingzoo is played.",
    "--pettingzoo mine --vectorization-mode async": "--vectorization-mode goes with --gym, but --pettingzoo is played.",
    "--pettingzoo no_such_module": "The module of --pettingzoo 'no_such_module' can't be imported (ModuleNotFoundError",
    "--pettingzoo ": "The module of --pettingzoo '' can't be imported (ValueError: Empty module name).",
    "--pettingzoo json": "--pettingzoo is 'json', but a module with parallel_env or env was expected, such as mpe2.",
    "--pettingzoo mpe2.simple_spread_v3 --camera-raw": "--camera-raw says how a picture is sent, but mpe2.simple_spre",
    "--pettingzoo mine": "mine doesn't say what its agents are (AttributeError: ",
    "--pettingzoo pettingzoo.classic.tictactoe_v3 --team cat=1": "--team names behavior 'cat', but pettingzoo.classic",
    "--pettingzoo pettingzoo.classic.tictactoe_v3 --group": "--group needs agents that act together, but those of ",
    "--pettingzoo pettingzoo.classic.tictactoe_v3 --behavior a=b": "--behavior 'a' fits none of the agents of pettin",
}


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize("line", WRONG)
@pytest.mark.filterwarnings("ignore")
def test_a_command_line_that_cant_be_played_ends_in_one_sentence_and_code_1(line, said):
    code, log = said(*line.split(" "))
    assert code == 1
    last = log.splitlines()[-1]
    assert f" ERROR {WRONG[line]}" in last
    assert last[-1] in ".]"


MISTYPED = {
    "--gym X --env-kwargs continuous": "it is 'continuous', but a JSON object was expected, such as '{\"continuous\": ",
    "--gym X --env-kwargs [1]": "it is '[1]', but a JSON object was expected",
    '--gym X --env-kwargs {"a":}': "it is '{\"a\":}', but a JSON object was expected",
    "--pettingzoo X --behavior a": "it is 'a', but NAME=REGEX was expected, such as 'adversary=adversary_.*'.",
    "--pettingzoo X --behavior =a": "it is '=a', but NAME=REGEX was expected",
    "--pettingzoo X --behavior a=(": "it is 'a=(', but its pattern is none (missing ), unterminated subpattern at posi",
    "--pettingzoo X --team a": "it is 'a', but NAME=NUMBER was expected, such as 'agent=1'.",
    "--pettingzoo X --team a=-1": "it is 'a=-1', but NAME=NUMBER was expected",
    "--gym X --camera 0x4": "'0x4' is no picture size; 1x1 to 1024x1024 was expected.",
    "--gym X --vectorization-mode threads": "invalid choice: 'threads'",
    "--gym": "expected one argument",
}


@pytest.mark.parametrize("line", MISTYPED)
def test_a_mistyped_option_is_refused_with_what_was_expected(line, said):
    """As of every option, with the options there are and the shell's code for that."""
    code, log = said(*line.split(" "))
    assert code == 2
    assert MISTYPED[line] in log.splitlines()[-1]


@pytest.mark.parametrize(
    ("option", "module"), [("gym", "gymnasium_simulation"), ("pettingzoo", "pettingzoo_simulation")]
)
def test_a_missing_package_is_named_with_the_extra_that_has_it(option, module, said, monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    for name in [name for name in sys.modules if name.startswith("corridor_server.simulations.")]:
        if not name.endswith(".simulation"):
            monkeypatch.delitem(sys.modules, name)
    package = sys.modules["corridor_server.simulations"]
    for name in (module, "observation_sensors", "action_choices", "agent_areas", "declared_parameters"):
        if hasattr(package, name):
            monkeypatch.delattr(package, name)
    code, log = said(f"--{option}", "x")
    assert code == 1
    line = f"--{option} needs gymnasium, which is not installed: pip install curious-corridor[{option}]"
    assert log.splitlines()[-1].endswith(f" ERROR {line}")


def test_a_package_that_an_environment_misses_is_named(said, monkeypatch):
    monkeypatch.setitem(sys.modules, "Box2D", None)
    for name in [name for name in sys.modules if name.startswith("gymnasium.envs.box2d")]:
        monkeypatch.delitem(sys.modules, name)
    code, log = said("--gym", "LunarLander-v3")
    assert code == 1
    assert "LunarLander-v3 can't be made (DependencyNotInstalled: Box2D is not installed" in log.splitlines()[-1]


def test_the_process_itself_says_it_and_has_the_exit_code(tmp_path):
    log = tmp_path / "log"
    command = [str(BIN / "corridor-server"), *NOBODY, "--gym", "CartPoel-v1", "-logFile", str(log)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout) == (1, "")
    assert "the nearest are CartPole-v1" in log.read_text().splitlines()[-1]


def test_what_an_author_raised_is_in_the_log_with_its_place_before_the_sentence(said):
    class Broken(Small):
        def __init__(self):
            raise ValueError("no\nfuel")

    gymnasium.register("Broken-v0", Broken)
    try:
        code, log = said("--gym", "Broken-v0")
    finally:
        del gymnasium.registry["Broken-v0"]
    *before, last = log.splitlines()
    assert code == 1
    assert last.endswith("ERROR Broken-v0 can't be made (ValueError: no fuel).")
    assert any("test_bad_environments.py" in line for line in before)
