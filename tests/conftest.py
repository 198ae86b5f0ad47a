"""What tests share: a free port, a corridor whose numbers are easy by hand, and the commands under test."""

import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import trainer  # noqa: F401 - makes mlagents_envs importable
from corridor_server import world
from corridor_server.config import CorridorConfig
from corridor_server.parameters import EpisodeParameters

BIN = Path(sys.executable).parent


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def open_corridor(free_port: int, tmp_path: Path) -> Iterator[Callable[..., object]]:
    """Opens our player through the real UnityEnvironment; closes what was opened."""
    from trainer.unity import open_environment

    opened = []

    def open_one(**options: object) -> object:
        defaults = {"seed": 1, "num_areas": 1, "port": free_port, "timeout_wait": 30, "log_folder": tmp_path}
        opened.append(open_environment("builtin", **{**defaults, **options}))  # type: ignore[arg-type]
        return opened[-1]

    yield open_one
    for environment in opened:
        if environment._loaded:
            environment.close()


def interpreter(version: str) -> str | None:
    """A Python of this version that runs, on the path or among pyenv's."""
    found = [shutil.which(f"python{version}"), *Path.home().glob(f".pyenv/versions/{version}.*/bin/python")]
    for candidate in found:
        if candidate and subprocess.run([candidate, "--version"], capture_output=True).returncode == 0:
            return str(candidate)
    return None


class OneArea:
    """A single area with everything placed by hand."""

    def __init__(self, **config: float) -> None:
        self.p = EpisodeParameters(CorridorConfig(**config), (0,)).columns  # type: ignore[arg-type]

    def state(
        self,
        position: tuple[float, float] = (0.0, 0.0),
        *,
        velocity: tuple[float, float] = (0.0, 0.0),
        goal: tuple[float, float] = (9.0, 0.0),
        switch_on: bool = False,
        opponents: tuple[tuple[float, float], ...] = ((-8.0, -4.0),),
        opponent_targets: tuple[tuple[float, float], ...] | None = None,
        episode_return: float = 0.0,
        episode_steps: int = 0,
    ) -> world.State:
        """By default the opponent stands still on its target, far from the learner."""
        zero = np.zeros(1, np.int64)
        return world.State(
            position=np.array([position]),
            velocity=np.array([velocity]),
            goal=np.array([goal]),
            switch_on=np.array([switch_on]),
            opponent_position=np.array([opponents]),
            opponent_velocity=np.zeros((1, len(opponents), 2)),
            opponent_target=np.array([opponents if opponent_targets is None else opponent_targets]),
            episode_return=np.array([episode_return]),
            episode_steps=np.array([episode_steps]),
            opponent_contacts=zero,
            wall_contacts=zero,
            closest_approach=np.array([9.0]),
        )

    def step(self, state: world.State, action: tuple[float, float] = (0.0, 0.0)) -> tuple[world.State, world.Outcome]:
        return world.step(self.p, state, np.array([action]))

    def reward(self, state: world.State, action: tuple[float, float] = (0.0, 0.0)) -> float:
        return float(self.step(state, action)[1].reward[0])


@pytest.fixture
def one_area() -> type[OneArea]:
    return OneArea
