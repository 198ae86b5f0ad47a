"""Slots that write down when they are asked what, and fail when told to; players made of them."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from mlagents_envs.base_env import ActionSpec
from mlagents_envs.exception import UnityCommunicatorStoppedException
from scripted import spec

from trainer.config import RestartLimits
from trainer.players.area_state import PlayerState
from trainer.players.failures import PlayerLogs
from trainer.players.several import OpenPlayer, Players
from trainer.players.slots import Slots
from trainer.players.vec_env import action_space, observation_space

UNLIMITED = RestartLimits(max_lifetime_restarts=-1, restarts_rate_limit_n=-1)
NO_LOGS = PlayerLogs(Path("nowhere"))
BEHAVIOR = spec([(13,)], ActionSpec.create_continuous(2))
DEAD = UnityCommunicatorStoppedException("gone")


class Recorded(Slots):
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


def opened(slots: Recorded) -> OpenPlayer:
    environment = SimpleNamespace(kill=slots.close, close=slots.close, is_open=True, exchange_seconds=2.0)
    return OpenPlayer(environment, slots, PlayerState(), "Scripted", BEHAVIOR)


def failing(*failures: list, limits: RestartLimits = UNLIMITED, launched: bool = True) -> Players:
    """One player whose lives end with these failures."""
    lives = [list(each) for each in failures]
    return Players(
        lambda number, restarts: opened(Recorded(failures=lives[restarts])),
        [0],
        limits,
        NO_LOGS,
        launched,
    )


def play(players: Players, steps: int) -> None:
    players.reset()
    for _ in range(steps):
        players.step(np.zeros((players.num_envs, 2)))
