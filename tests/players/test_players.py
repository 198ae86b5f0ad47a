"""Several players as one VecEnv: stepped side by side, and started again when they die or hang."""

import csv
import json
import os
import signal
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import BIN
from mlagents_envs.base_env import ActionSpec
from mlagents_envs.exception import UnityCommunicatorStoppedException, UnityTimeOutException
from scripted import spec
from stable_baselines3.common.running_mean_std import RunningMeanStd

from trainer.commands.shared_options import TrainingOptions
from trainer.commands.train import Train
from trainer.config import RestartLimits
from trainer.errors import TrainerError
from trainer.players.area_state import PlayerState
from trainer.players.environment import open_environment
from trainer.players.settings import channels
from trainer.players.several import PLAYER_STRIDE, EpisodeMonitor, Player, Players, open_player
from trainer.players.vec_env import Areas, UnityVecEnv, action_space, observation_space
from trainer.runs.evaluation import evaluate

UNLIMITED = RestartLimits(max_lifetime_restarts=-1, restarts_rate_limit_n=-1)
BEHAVIOR = spec([(13,)], ActionSpec.create_continuous(2))
TIMING = {"steps_per_second", "wall_seconds"}


def players_of(path: Path, port: int, count: int, areas: int = 4, limits: RestartLimits = UNLIMITED, wait: int = 30):
    config = Train("r", num_envs=count, num_areas=areas).run_config()
    return open_player(config, path, seed=5, port=port, timeout_wait=wait, limits=limits)


def process_of(players: Players, number: int) -> int:
    return players._players[number].environment._process.pid


def seed_of(log: Path) -> str:
    return next(line for line in log.read_text().splitlines() if " seed " in line).split(" seed ")[1]


# side by side


def test_three_players_are_three_runs_of_one_player_with_seeds_of_their_own(tmp_path, free_port):
    def single(number):
        seed = 5 + number * PLAYER_STRIDE
        told = channels(Train("r").run_config(), seed)
        return UnityVecEnv(
            open_environment("builtin", seed=seed, num_areas=4, port=free_port + 3, timeout_wait=30, side_channels=told)
        )

    actions = np.random.default_rng(0).uniform(-1, 1, (300, 12, 2)).astype(np.float32)
    together = []
    with players_of(tmp_path, free_port, 3) as (players, behavior):
        assert behavior == "Corridor?team=0"
        together.append(players.reset())
        for each in actions:
            observations, rewards, dones, infos = players.step(each)
            together += [observations, rewards, dones, ["terminal_observation" in info for info in infos]]
    assert together[0].shape == (12, 13)
    ended = 0
    for number in range(3):
        env, slots = single(number), slice(4 * number, 4 * number + 4)
        alone = [env.reset()]
        for each in actions:
            observations, rewards, dones, infos = env.step(each[slots])
            alone += [observations, rewards, dones, ["terminal_observation" in info for info in infos]]
            ended += dones.sum()
        env.close()
        assert all(np.array_equal(one[slots], other) for one, other in zip(together, alone, strict=True))
    assert ended > 0
    assert not np.array_equal(together[0][:4], together[0][4:8])


class Recorded(Areas):
    """Slots that write down when they are asked what, and fail when told to."""

    def __init__(self, name: object = 0, calls: list | None = None, failures: list | None = None, areas: int = 2):
        super().__init__(areas, observation_space(BEHAVIOR), action_space(BEHAVIOR))
        self.name, self.calls, self.failures = name, [] if calls is None else calls, failures or []
        self.steps = 0

    def reset(self):
        self.calls.append(("reset", self.name))
        return np.zeros((self.num_envs, 13), np.float32)

    def step_async(self, actions):
        self.calls.append(("send", self.name))

    def step_wait(self):
        self.calls.append(("wait", self.name))
        self.steps += 1
        if self.failures:
            raise self.failures.pop(0)
        ended = np.full(self.num_envs, self.steps % 5 == 0)
        infos = [{"terminal_observation": np.ones(13, np.float32)} if end else {} for end in ended]
        return np.full((self.num_envs, 13), self.steps, np.float32), np.ones(self.num_envs, np.float32), ended, infos

    def close(self):
        self.calls.append(("close", self.name))


def opened(slots: Recorded) -> Player:
    environment = SimpleNamespace(kill=slots.close, close=slots.close, _loaded=True, exchange_seconds=2.0)
    return Player(environment, slots, PlayerState(), "Scripted", BEHAVIOR)


def failing(*failures: list, limits: RestartLimits = UNLIMITED, launched: bool = True) -> Players:
    """One player whose lives end with these failures."""
    lives = [list(each) for each in failures]
    return Players(
        lambda number, restarts: opened(Recorded(failures=lives[restarts])), [0], limits, Path("nowhere"), launched
    )


def test_every_player_has_its_actions_before_the_first_answer_is_awaited():
    calls: list = []
    players = Players(
        lambda number, restarts: opened(Recorded(number, calls)), [0] * 3, UNLIMITED, Path("nowhere"), True
    )
    players.reset()
    calls.clear()
    players.step(np.zeros((6, 2)))
    assert calls == [("send", 0), ("send", 1), ("send", 2), ("wait", 0), ("wait", 1), ("wait", 2)]


def test_a_player_computes_while_nobody_waits_for_it(open_corridor):
    env = UnityVecEnv(open_corridor(num_areas=2))
    env.reset()
    env.step_async(np.zeros((2, 2), np.float32))
    answers = env.environment._communicator._received
    deadline = time.monotonic() + 20
    while not answers.qsize() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert answers.qsize() == 1
    assert env.step_wait()[1].shape == (2,)


def test_the_time_spent_with_a_player_that_died_still_counts():
    players = failing([UnityTimeOutException("silent")], [])
    players.reset()
    assert players.exchange_seconds == 2.0
    players.step(np.zeros((2, 2)))
    assert players.exchange_seconds == 4.0


def test_players_of_different_builds_are_refused():
    with pytest.raises(TrainerError, match=r"Player 1 has 3 areas .* but the first had 2 .* the same build"):
        Players(lambda number, _: opened(Recorded(areas=2 + number)), [0] * 2, UNLIMITED, Path("nowhere"), True)


def test_if_one_of_several_cant_be_opened_the_others_are_closed():
    calls: list = []

    def start(number, restarts):
        if number == 1:
            raise TrainerError("no room")
        return opened(Recorded(number, calls))

    with pytest.raises(TrainerError, match="no room"):
        Players(start, [0] * 3, UNLIMITED, Path("nowhere"), True)
    assert [call for call in calls if call[0] == "close"] == [("close", 0), ("close", 2)]


# a player that dies


def test_a_players_death_cuts_its_own_episodes_and_nothing_else(tmp_path, free_port, capfd):
    with players_of(tmp_path, free_port, 2) as (players, _):
        players.reset()
        for _ in range(20):
            before, *_ = players.step(np.zeros((8, 2), np.float32))
        first = process_of(players, 1)
        os.kill(first, signal.SIGKILL)
        observations, rewards, dones, infos = players.step(np.zeros((8, 2), np.float32))
        assert dones.tolist() == [False] * 4 + [True] * 4
        assert rewards[4:].tolist() == [0.0] * 4
        for slot in range(4, 8):
            assert np.array_equal(infos[slot]["terminal_observation"], before[slot])
            assert infos[slot]["TimeLimit.truncated"] is True
            assert infos[slot]["dropped"] is True
        assert np.all(observations[4:, 2:4] == 0.0), "the next episodes begin at rest"
        assert not np.array_equal(observations[4:], before[4:])
        assert players.restarts == 1
        assert process_of(players, 1) != first
        for _ in range(20):
            *_, dones, infos = players.step(np.zeros((8, 2), np.float32))
        assert not any("dropped" in info for info in infos)
    assert seed_of(tmp_path / "Player-1.log") != seed_of(tmp_path / "Player-1.died-1.log")
    error = capfd.readouterr().err
    assert "Player 1: Environment shut down with return code -9 (SIGKILL). The player's log is" in error
    assert "It is started again (restart 1)." in error


def test_a_player_that_hangs_is_started_again(tmp_path, free_port):
    with players_of(tmp_path, free_port, 1, wait=3) as (players, _):
        players.reset()
        os.kill(process_of(players, 0), signal.SIGSTOP)
        *_, infos = players.step(np.zeros((4, 2), np.float32))
        assert all(info["dropped"] for info in infos)
        assert players.restarts == 1
        players.step(np.zeros((4, 2), np.float32))


def test_a_player_that_dies_in_a_reset_is_started_again(tmp_path, free_port):
    with players_of(tmp_path, free_port, 1) as (players, _):
        players.reset()
        players.step(np.zeros((4, 2), np.float32))
        os.kill(process_of(players, 0), signal.SIGKILL)
        assert np.asarray(players.reset()).shape == (4, 13)
        assert players.restarts == 1


def test_the_gym_path_survives_too(tmp_path, free_port):
    config = Train("r", training=TrainingOptions(preset="paper")).run_config()
    with open_player(config, tmp_path, seed=5, port=free_port, timeout_wait=30, limits=UNLIMITED) as (players, _):
        players.reset()
        players.step(np.zeros((1, 2), np.float32))
        os.kill(process_of(players, 0), signal.SIGKILL)
        *_, infos = players.step(np.zeros((1, 2), np.float32))
        assert infos[0]["dropped"]
        *_, dones, infos = players.step(np.zeros((1, 2), np.float32))
        assert not dones[0]


DEAD = UnityCommunicatorStoppedException("gone")


def play(players: Players, steps: int) -> None:
    players.reset()
    for _ in range(steps):
        players.step(np.zeros((players.num_envs, 2)))


def test_limits_over_the_whole_run():
    play(failing([DEAD], [DEAD], [], limits=RestartLimits(2, -1)), 6)
    with pytest.raises(TrainerError, match=r"not started again: --max-lifetime-restarts allows 2\."):
        play(failing([DEAD], [DEAD], [DEAD], limits=RestartLimits(2, -1)), 6)


def test_limits_in_a_period():
    with pytest.raises(TrainerError, match=r"not started again: --restarts-rate-limit-n allows 1 in 60 s\."):
        play(failing([DEAD], [DEAD]), 0) or play(failing([DEAD], [DEAD], limits=RestartLimits()), 6)

    class Slow(Recorded):
        def step_wait(self):
            time.sleep(0.06)
            return super().step_wait()

    lives = [[DEAD], [DEAD], [DEAD], []]
    limits = RestartLimits(-1, 1, 0.05)
    slow = Players(lambda _, restarts: opened(Slow(failures=lives[restarts])), [0], limits, Path("nowhere"), True)
    play(slow, 6)
    assert slow.restarts == 3


def test_limits_hold_for_each_player_alone():
    lives = {(0, 0): [DEAD], (1, 0): [DEAD]}
    players = Players(
        lambda number, restarts: opened(Recorded(failures=lives.get((number, restarts), []))),
        [0, 0], RestartLimits(), Path("nowhere"), True,
    )  # fmt: skip
    play(players, 3)
    assert players.restarts == 2


def test_minus_one_is_no_limit():
    play(failing(*([DEAD] for _ in range(30)), []), 40)


def starting(attempts: list, launched: bool) -> Players:
    """The first life ends at once; each attempt at another fails, until one is None."""

    def start(number, restarts):
        if restarts == 0:
            return opened(Recorded(failures=[DEAD]))
        if (failure := attempts.pop(0)) is not None:
            raise TrainerError(str(failure)) from failure
        return opened(Recorded())

    return Players(start, [0], UNLIMITED, Path("nowhere"), launched)


def test_a_player_that_dies_while_it_starts_is_tried_again():
    players = starting([UnityTimeOutException("slow"), DEAD, None], launched=True)
    play(players, 3)
    assert players.restarts == 3


def test_what_another_try_would_not_mend_is_not_tried_again():
    with pytest.raises(TrainerError, match="port in use"):
        play(starting([OSError("port in use"), None], launched=True), 3)


def test_a_player_from_elsewhere_is_awaited_once():
    with pytest.raises(TrainerError, match="nobody came"):
        play(starting([UnityTimeOutException("nobody came"), None], launched=False), 3)


def test_dropped_episodes_are_not_reported():
    monitor = EpisodeMonitor(failing([DEAD], []))
    monitor.reset()
    *_, infos = monitor.step(np.zeros((2, 2)))
    assert all(info["dropped"] and "episode" not in info for info in infos)
    for _ in range(5):
        *_, infos = monitor.step(np.zeros((2, 2)))
    assert [(info["episode"]["r"], info["episode"]["l"]) for info in infos] == [(5.0, 5), (5.0, 5)]


def test_dropped_episodes_are_not_evaluated():
    model = SimpleNamespace(predict=lambda observations, deterministic: (np.zeros((2, 2)), None))
    normaliser = SimpleNamespace(normalize_obs=lambda observations: observations, obs_rms=RunningMeanStd())
    episodes = evaluate(model, normaliser, failing([DEAD], []), 2)
    assert [len(episode.rewards) for episode in episodes] == [5, 5]


# the command


def corridor(*arguments: object, timeout: float = 400) -> subprocess.CompletedProcess[str]:
    command = [str(BIN / "corridor"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [{name: text for name, text in row.items() if name not in TIMING} for row in csv.DictReader(file)]


def wait_for_a_row(run: Path) -> None:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not ((run / "progress.csv").exists() and rows(run / "progress.csv")):
        time.sleep(0.1)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_run_with_three_players(tmp_path, free_port):
    found = []
    for name in ("one", "two"):
        done = corridor(
            "train", "--run-id", name, "--results-dir", tmp_path, "--base-port", free_port, "--num-envs", 3,
            "--num-areas", 5, "--steps", 20_000, "--eval-episodes", 6,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append(
            (rows(tmp_path / name / "progress.csv"), json.loads((tmp_path / name / "summary.json").read_text()))
        )
    assert len(found[0][0]) >= 2
    assert found[0][0] == found[1][0]
    assert found[0][1]["evaluation"] == found[1][1]["evaluation"]


def test_training_goes_on_when_a_player_is_killed(tmp_path, free_port):
    process = subprocess.Popen(
        [str(BIN / "corridor"), "train", "--run-id", "r", "--results-dir", str(tmp_path), "--base-port",
         str(free_port), "--num-envs", "2", "--num-areas", "4", "--steps", "30000", "--eval-episodes", "4"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    wait_for_a_row(tmp_path / "r")
    found = subprocess.run(["pgrep", "-f", f"mlagents-port {free_port + 1}"], capture_output=True, text=True).stdout
    os.kill(int(found), signal.SIGKILL)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert "It is started again (restart 1)." in errors
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    assert summary["restarts"] == 1
    assert summary["env_steps"] >= 30_000
    assert summary["evaluation"]["episodes"] == 4


def dial_in(port: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [str(BIN / "corridor-server"), "--mlagents-port", str(port), "-logFile", os.devnull],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def test_players_that_dial_in_from_elsewhere_and_one_that_dials_in_again(tmp_path, free_port):
    process = subprocess.Popen(
        [str(BIN / "corridor"), "train", "--run-id", "r", "--results-dir", str(tmp_path), "--env",
         f"localhost:{free_port}", "--num-envs", "2", "--num-areas", "4", "--steps", "30000", "--eval-episodes", "4"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    away = [dial_in(free_port + number) for number in range(2)]
    wait_for_a_row(tmp_path / "r")
    away[1].kill()
    said = process.stderr.readline()
    assert "Waiting for it to dial in again (restart 1)." in said
    away.append(dial_in(free_port + 1))
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["restarts"] == 1
    assert [each.wait(20) for each in away] == [0, -signal.SIGKILL, 0]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--num-envs", 0), "--num-envs is 0, but a whole number from 1 up was expected"),
        (("--num-envs", 2, "--env", "editor"), "the Unity editor is one player"),
        (("--num-envs", 2, "--preset", "paper"), "--num-envs is 2, but preset paper trains one area"),
        (("--num-envs", 2, "--base-port", 65535), "ports end at 65535"),
        (
            ("--num-envs", 2, "--env", "localhost:65535"),
            "2 players from port 65535 on need ports above 65535; begin lower.",
        ),
        (("--max-lifetime-restarts", -2), "--max-lifetime-restarts is -2, but a whole number from 0 up"),
        (("--restarts-rate-limit-period-s", 0), "--restarts-rate-limit-period-s is 0, but seconds above 0"),
        (("--time-scale", 1000), "time_scale is 1000.0, but a number from 0.01 to 100 was expected"),
    ],
)
def test_options_out_of_their_range(tmp_path, options, says):
    done = corridor("train", "--run-id", "r", "--results-dir", tmp_path, "--timeout-wait", 1, *options)
    assert done.returncode == 1
    assert says in done.stderr
    assert "Traceback" not in done.stderr
