"""Several players as one VecEnv: stepped side by side, and started again when they die or hang."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from asked import asked
from mlagents_envs.exception import UnityTimeOutException
from recorded_slots import NO_LOGS, UNLIMITED, Recorded, failing, opened

from trainer.commands.train import Train
from trainer.config import ConnectionOptions, RestartLimits
from trainer.errors import TrainerError
from trainer.players.failures import PlayerLogs
from trainer.players.opening import open_environment, open_players
from trainer.players.settings import channels
from trainer.players.several import Players
from trainer.players.vec_env import UnityVecEnv
from trainer.seeds import player_seed


def players_of(path: Path, port: int, count: int, areas: int = 4, limits: RestartLimits = UNLIMITED, wait: int = 30):
    config = asked("r", num_envs=count, num_areas=areas).run_config()
    connection = ConnectionOptions(base_port=port, timeout_wait=wait)
    return open_players(config, PlayerLogs(path), connection, seed=5, limits=limits)


def process_of(players: Players, number: int) -> int:
    return players._players[number].environment.process_id


def seed_of(log: Path) -> str:
    return next(line for line in log.read_text().splitlines() if " seed " in line).split(" seed ")[1]


# side by side


def test_three_players_are_three_runs_of_one_player_with_seeds_of_their_own(tmp_path, free_port):
    def single(number):
        seed = player_seed(5, number)
        told = channels(Train("r").run_config(), seed)
        return UnityVecEnv(
            open_environment("builtin", seed=seed, num_areas=4, port=free_port + 3, timeout_wait=30, side_channels=told)
        )

    actions = np.random.default_rng(0).uniform(-1, 1, (300, 12, 2)).astype(np.float32)
    together = []
    with players_of(tmp_path, free_port, 3) as players:
        assert players.behavior == "Corridor?team=0"
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


def test_every_player_has_its_actions_before_the_first_answer_is_awaited():
    calls: list = []
    players = Players(lambda number, restarts: opened(Recorded(number, calls)), [0] * 3, UNLIMITED, NO_LOGS, True)
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
        Players(lambda number, _: opened(Recorded(areas=2 + number)), [0] * 2, UNLIMITED, NO_LOGS, True)


def test_if_one_of_several_cant_be_opened_the_others_are_closed():
    calls: list = []

    def start(number, restarts):
        if number == 1:
            raise TrainerError("no room")
        return opened(Recorded(number, calls))

    with pytest.raises(TrainerError, match="no room"):
        Players(start, [0] * 3, UNLIMITED, NO_LOGS, True)
    assert [call for call in calls if call[0] == "close"] == [("close", 0), ("close", 2)]


# a player that dies


def test_a_players_death_cuts_its_own_episodes_and_nothing_else(tmp_path, free_port, capfd):
    with players_of(tmp_path, free_port, 2) as players:
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
    with players_of(tmp_path, free_port, 1, wait=3) as players:
        players.reset()
        os.kill(process_of(players, 0), signal.SIGSTOP)
        *_, infos = players.step(np.zeros((4, 2), np.float32))
        assert all(info["dropped"] for info in infos)
        assert players.restarts == 1
        players.step(np.zeros((4, 2), np.float32))


def test_a_player_that_dies_in_a_reset_is_started_again(tmp_path, free_port):
    with players_of(tmp_path, free_port, 1) as players:
        players.reset()
        players.step(np.zeros((4, 2), np.float32))
        os.kill(process_of(players, 0), signal.SIGKILL)
        assert np.asarray(players.reset()).shape == (4, 13)
        assert players.restarts == 1


def test_the_gym_path_survives_too(tmp_path, free_port):
    config = asked("r", preset="paper").run_config()
    connection = ConnectionOptions(base_port=free_port, timeout_wait=30)
    with open_players(config, PlayerLogs(tmp_path), connection, seed=5, limits=UNLIMITED) as players:
        players.reset()
        players.step(np.zeros((1, 2), np.float32))
        os.kill(process_of(players, 0), signal.SIGKILL)
        *_, infos = players.step(np.zeros((1, 2), np.float32))
        assert infos[0]["dropped"]
        *_, dones, infos = players.step(np.zeros((1, 2), np.float32))
        assert not dones[0]
