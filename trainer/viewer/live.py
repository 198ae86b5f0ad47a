"""The newest policy of a run that is still training, played in a process that runs only when nothing else wants to."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.gym_env import CorridorEnv

EPISODES = 4


class LiveEvaluations:
    """At most one evaluation at a time, of a run's newest checkpoint; the latest result of each run is kept."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._asked: dict[str, tuple[str, Future[dict[str, Any]]]] = {}
        self._lock = threading.Lock()

    def ask(self, run: Path, checkpoint: str) -> dict[str, Any] | None:
        """The scene of a run's checkpoint; None while it is being played.

        Raises:
            TrainerError: The checkpoint can't be played.
        """
        with self._lock:
            name, future = self._asked.get(str(run), ("", None))
            if future is None or (name != checkpoint and future.done()):
                if self._pool is None:
                    context = multiprocessing.get_context("spawn")
                    self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_stand_back)
                future = self._pool.submit(play_checkpoint, run, checkpoint)
                self._asked[str(run)] = checkpoint, future
        if not future.done():
            return None
        try:
            return future.result()
        except BrokenProcessPool:  # somebody killed the process; the next question starts another
            with self._lock:
                self._pool = None
                self._asked.clear()
            return None

    def close(self) -> None:
        """Ends the process, whatever it is doing."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():  # there are no others
                process.kill()


def play_checkpoint(run: Path, checkpoint: str) -> dict[str, Any]:
    """Plays a few episodes of a checkpoint in the in-process world, with the evaluation's seed.

    Returns:
        Of ``run_scene``.

    Raises:
        TrainerError: The checkpoint is gone, broken or does not fit.
    """
    from stable_baselines3.common.vec_env import DummyVecEnv

    from trainer.corridor import corridor_of
    from trainer.learning.stages import build_stages
    from trainer.runs.estimates import with_estimates
    from trainer.runs.evaluation import evaluate
    from trainer.runs.folder import RunFolder
    from trainer.runs.training import load_trained
    from trainer.runs.trajectories import Trajectories
    from trainer.seeds import evaluation_seed
    from trainer.viewer.corridor_scene import run_scene

    folder = RunFolder(run)
    config = folder.read_config()
    seed = evaluation_seed(config.seed)
    corridor = corridor_of(config.penalty, config.environment_parameters)
    player = DummyVecEnv([partial(_Reporting, area, seed, corridor) for area in range(EPISODES)])
    stages = build_stages(config, player)
    counters = load_trained(config, folder, stages, checkpoint)
    episodes = with_estimates(stages, evaluate(stages.model, stages.normaliser, player, EPISODES))
    return run_scene(config, Trajectories("Corridor", seed, counters.env_steps, episodes), EPISODES)


class _Reporting(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The oracle of one area with the player's seed, which reports statistics as the player does."""

    def __init__(self, area: int, seed: int, corridor: CorridorConfig) -> None:
        super().__init__(CorridorEnv(area=area, **asdict(corridor)))
        self._seed: int | None = seed

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        seed, self._seed = self._seed, None
        return self.env.reset(seed=seed, options=options)

    def step(self, action: NDArray[np.float32]) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        from trainer.corridor import episode_info

        observation, reward, terminated, truncated, info = self.env.step(action)
        statistics = {f"Corridor/{name}": value for name, value in info.get("statistics", {}).items()}
        return observation, reward, terminated, truncated, episode_info(statistics)


def _stand_back() -> None:
    """Lets everything else on the machine go first, leaves Ctrl-C to the parent, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    elif hasattr(os, "nice"):
        os.nice(19)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
        os._exit(0)

    threading.Thread(target=end_with_parent, daemon=True).start()
