"""How often players that die are started again, and what becomes of the episodes that their deaths cut."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from mlagents_envs.exception import UnityTimeOutException
from recorded_slots import DEAD, NO_LOGS, UNLIMITED, Recorded, failing, opened, play
from stable_baselines3.common.running_mean_std import RunningMeanStd

from trainer.config import RestartLimits
from trainer.errors import TrainerError
from trainer.learning.monitor import EpisodeMonitor
from trainer.players.several import Players
from trainer.runs.evaluation import evaluate


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
    slow = Players(lambda _, restarts: opened(Slow(failures=lives[restarts])), [0], limits, NO_LOGS, True)
    play(slow, 6)
    assert slow.restarts == 3


def test_limits_hold_for_each_player_alone():
    lives = {(0, 0): [DEAD], (1, 0): [DEAD]}
    players = Players(
        lambda number, restarts: opened(Recorded(failures=lives.get((number, restarts), []))),
        [0, 0], RestartLimits(), NO_LOGS, True,
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

    return Players(start, [0], UNLIMITED, NO_LOGS, launched)


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
