"""The player as its users meet it: a subprocess that the unmodified UnityEnvironment launches."""

import re
import subprocess
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from conftest import BIN
from mlagents_envs.base_env import ActionTuple
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel

from corridor_server.player import Player
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.protocol.messages import QUIT, RESET, UnityMessageProto
from corridor_server.protocol.side_channels import AREA_STATE, message
from corridor_server.protocol.trainer_messages import command, initialization
from corridor_server.simulations.simulation import Simulation, SimulationError

BEHAVIOR = "Corridor?team=0"
SERVER = str(BIN / "corridor-server")


def test_the_published_environment_with_its_own_communicator_plays(free_port):
    """Nothing of ours on the trainer's side but the message classes."""
    environment = UnityEnvironment(SERVER, base_port=free_port, seed=1, no_graphics=True, timeout_wait=30, num_areas=3)
    try:
        environment.reset()
        for _ in range(50):
            environment.set_actions(BEHAVIOR, environment.behavior_specs[BEHAVIOR].action_spec.random_action(3))
            environment.step()
        decision, _ = environment.get_steps(BEHAVIOR)
        assert decision.obs[0].shape == (3, 13)
    finally:
        environment.close()


def test_the_behavior_is_the_contracts(open_corridor):
    environment = open_corridor()
    environment.reset()
    assert list(environment.behavior_specs) == [BEHAVIOR]
    spec = environment.behavior_specs[BEHAVIOR]
    assert [observation.shape for observation in spec.observation_specs] == [(13,)]
    assert (spec.action_spec.continuous_size, spec.action_spec.discrete_size) == (2, 0)
    assert environment.academy_capabilities.baseRLCapabilities


@pytest.mark.slow
def test_over_grpc_as_in_process_bit_for_bit(open_corridor):
    """10,000 random-action steps: observation, reward and end of each area, in float32."""
    areas, steps, seed = 8, 1250, 1
    environment = open_corridor(seed=seed, num_areas=areas)
    oracle = [gymnasium.make("corridor_server:Corridor-v0", area=area) for area in range(areas)]
    expected = np.array([env.reset(seed=seed)[0] for env in oracle])
    environment.reset()
    decision, _ = environment.get_steps(BEHAVIOR)
    assert np.array_equal(decision.obs[0], expected)
    rng = np.random.default_rng(0)
    episodes = 0
    for _ in range(steps):
        actions = rng.uniform(-1.1, 1.1, (areas, 2)).astype(np.float32)
        environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
        environment.step()
        ids = decision.agent_id
        decision, terminal = environment.get_steps(BEHAVIOR)
        for area, env in enumerate(oracle):
            observation, reward, terminated, truncated, _ = env.step(actions[area])
            assert (terminated or truncated) == (ids[area] in terminal.agent_id)
            if terminated or truncated:
                last = terminal[ids[area]]
                assert np.array_equal(last.obs[0], observation)
                assert last.reward == np.float32(reward)
                assert bool(last.interrupted) == truncated
                observation, reward = env.reset()[0], 0.0
                episodes += 1
            assert np.array_equal(decision.obs[0][area], observation)
            assert decision.reward[area] == np.float32(reward)
    assert episodes > 15


def test_parameters_set_over_the_side_channel_reach_the_next_reset(open_corridor):
    parameters = EnvironmentParametersChannel()
    parameters.set_float_parameter("goal_x", 5.0)
    parameters.set_float_parameter("no_such_thing", 1.0)
    environment = open_corridor(side_channels=[parameters])
    environment.reset()
    assert environment.get_steps(BEHAVIOR)[0].obs[0][0, 4] == pytest.approx(0.5)


def test_an_ignored_parameter_is_logged_with_its_range(open_corridor, tmp_path):
    parameters = EnvironmentParametersChannel()
    parameters.set_float_parameter("agent_speed", 5000.0)
    environment = open_corridor(side_channels=[parameters])
    environment.reset()
    environment.close()
    log = (tmp_path / "Player-0.log").read_text()
    assert "agent_speed = 5000 is out of its range, 0 to 100. It was ignored." in log


def test_statistics_are_sent_at_each_episodes_end(open_corridor):
    statistics, parameters = StatsSideChannel(), EnvironmentParametersChannel()
    parameters.set_float_parameter("max_episode_steps", 3)
    environment = open_corridor(num_areas=2, side_channels=[statistics, parameters])
    environment.reset()
    for _ in range(3):
        environment.step()
    _, terminal = environment.get_steps(BEHAVIOR)
    assert terminal.interrupted.tolist() == [True, True]
    received = statistics.get_and_reset_stats()
    assert sorted(received) == [
        "Corridor/Closest Approach",
        "Corridor/Episode Length",
        "Corridor/Opponent Contacts",
        "Corridor/Success",
        "Corridor/Switch Triggered",
        "Corridor/Wall Contacts",
    ]
    assert [value for value, _ in received["Corridor/Episode Length"]] == [3.0, 3.0]


def test_closing_ends_the_player_with_code_0(open_corridor, tmp_path):
    environment = open_corridor()
    process = environment._process
    environment.reset()
    environment.close()
    assert process.returncode == 0
    assert "The trainer ended the session." in (tmp_path / "Player-0.log").read_text()


def test_a_player_that_is_asked_to_stop_tells_the_trainer(open_corridor):
    from mlagents_envs.exception import UnityCommunicatorStoppedException, UnityEnvironmentException

    environment = open_corridor()
    environment.reset()
    process = environment._process
    process.terminate()
    assert process.wait(10) == 0
    with pytest.raises((UnityCommunicatorStoppedException, UnityEnvironmentException)):
        environment.step()


def test_a_nan_action_stops_the_player_with_a_sentence(open_corridor, tmp_path):
    environment = open_corridor(num_areas=2)
    environment.reset()
    process = environment._process
    actions = np.array([[0.0, 0.0], [np.nan, 0.0]], np.float32)
    environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
    with pytest.raises(Exception, match="exited|return code 1"):
        environment.step()
    assert process.wait(10) == 1
    assert "Action 1 is [nan, 0.0], but finite numbers" in (tmp_path / "Player-0.log").read_text()


class TwoBehaviors(Simulation):
    """Agents 0 and 1 of one behavior, and one of another whose id is given."""

    def __init__(self, other):
        self.other = other
        self.forgone = False

    @property
    def behaviors(self):
        names = ("Fox?team=0", "Hare?team=0")
        return {name: Behavior(name, (Sensor.of("place", (1,)),), 1) for name in names}

    def reset(self):
        fox, hare = self.behaviors
        return {fox: self.asking(0, 1), hare: self.asking(self.other)}

    def asking(self, *ids):
        return Agents.that_ask(ids, (np.zeros((len(ids), 1), np.float32),), np.zeros(len(ids)))

    def step(self, actions):
        raise NotImplementedError

    def forgo_snapshots(self):
        self.forgone = True

    def snapshot(self):
        return np.zeros(1, [("row", "<i4")])


class Script:
    """A connection to a trainer that answers this in turn; keeps what it was told."""

    def __init__(self, *replies):
        self.replies, self.told = list(replies), []

    def exchange(self, message, timeout=None):
        self.told.append(UnityMessageProto.FromString(message))
        return self.replies.pop(0).SerializeToString()


def test_agents_of_two_behaviors_with_one_id_stop_the_player_with_a_sentence():
    script = Script(initialization(seed=1, num_areas=1), command(RESET), command(QUIT))
    said = "an agent 1 of Fox?team=0 and one of Hare?team=0, but ids that are unique over all behaviors were expected"
    with pytest.raises(SimulationError, match=re.escape(said)):
        Player(script, lambda seed, count: TwoBehaviors(1), "test").run()
    assert [told.header.status for told in script.told] == [200, 200, 400]
    script = Script(initialization(seed=1, num_areas=1), command(RESET), command(QUIT))
    Player(script, lambda seed, count: TwoBehaviors(2), "test").run()
    assert len(script.told[-1].unity_output.rl_output.agentInfos) == 2


@pytest.mark.parametrize("asks", [True, False])
def test_a_trainer_that_does_not_ask_for_the_state_with_its_first_reset_will_not_ask(asks):
    side_channel = message(AREA_STATE, b"") if asks else b""
    script = Script(initialization(seed=1, num_areas=1), command(RESET, side_channel=side_channel), command(QUIT))
    simulation = TwoBehaviors(2)
    Player(script, lambda seed, count: simulation, "test").run()
    assert simulation.forgone is not asks
    assert bool(script.told[-1].unity_output.rl_output.side_channel) is asks


def test_nobody_listening_is_one_sentence_with_host_port_and_seconds(free_port):
    run = subprocess.run(
        [SERVER, "--mlagents-port", str(free_port), "--timeout-wait", "0.5"], capture_output=True, text=True, timeout=30
    )
    assert run.returncode == 1
    assert re.search(rf"No trainer listens on localhost:{free_port} \(waited 0.5 s, ML-Agents API 1.5.0\)", run.stderr)
    assert "Traceback" not in run.stderr


def test_a_bad_config_file_is_one_sentence(tmp_path, free_port):
    path = tmp_path / "bad.yaml"
    path.write_text("agent_spead: 3")
    run = subprocess.run([SERVER, "--config", str(path)], capture_output=True, text=True, timeout=30)
    assert run.returncode == 1
    assert "'agent_spead' is not a parameter of the corridor; did you mean 'agent_speed'?" in run.stderr
    assert len(run.stderr.splitlines()) == 1


def test_unknown_arguments_are_ignored_with_a_line_in_the_log(free_port, tmp_path):
    log = tmp_path / "player.log"
    arguments = [
        "-screen-width",
        "640",
        "--mlagents-port",
        str(free_port),
        "--timeout-wait",
        "0.1",
        "-logfile",
        str(log),
    ]
    subprocess.run([SERVER, *arguments], timeout=30, check=False)
    assert "Arguments ignored: -screen-width 640" in log.read_text()


def test_a_killed_trainer_ends_the_player(free_port, tmp_path):
    program = (
        "import trainer, os, signal\n"
        "from trainer.players.opening import open_environment\n"
        f"e = open_environment('builtin', seed=1, num_areas=1, port={free_port}, timeout_wait=30,"
        f" log_folder=__import__('pathlib').Path({str(tmp_path)!r}))\n"
        "e.reset(); print(e._process.pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    run = subprocess.run([str(BIN / "python"), "-c", program], capture_output=True, text=True, timeout=60)
    player = Path(f"/proc/{int(run.stdout)}")
    deadline = time.monotonic() + 10
    while player.exists() and "zombie" not in (player / "status").read_text() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert "The connection to the trainer at localhost" in (tmp_path / "Player-0.log").read_text()


def test_a_program_that_forgets_to_close_does_not_hang(free_port):
    program = (
        "import trainer\nfrom trainer.players.opening import open_environment\n"
        f"e = open_environment('builtin', seed=1, num_areas=1, port={free_port}, timeout_wait=30)\ne.reset()"
    )
    assert subprocess.run([str(BIN / "python"), "-c", program], timeout=30).returncode == 0


def test_it_starts_without_torch_and_gymnasium():
    program = (
        "import sys\nsys.modules['gymnasium'] = None\nimport corridor_server.main\n"
        "assert not {'torch', 'gymnasium.core', 'mlagents_envs', 'yaml'} & set(sys.modules)"
    )
    assert subprocess.run([str(BIN / "python"), "-c", program]).returncode == 0
