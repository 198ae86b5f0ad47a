"""Episodes that somebody drives by hand in the page, each in a world of its own."""

import secrets
import threading
from collections import OrderedDict
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from corridor_server.corridor.gym_env import CorridorEnv, Observation
from corridor_server.shared.given import Range, shown
from trainer.corridor import corridor_of, is_corridor
from trainer.errors import TrainerError
from trainer.runs.folder import RunFolder
from trainer.runs.trajectories import load_trajectories
from trainer.viewer.corridor_scene import begin_again, corridor_facts, run_scene, state_row

FINITE = Range()
WHOLE = Range(0, 2**31 - 1)
SESSIONS = 16  # drives that are remembered; a new one ends the oldest


class Drives:
    """Begins episodes and steps them.

    Args:
        results_dir: The runs' folder, whose corridors can be driven in.
        seed: Decides new episodes; None draws them anew each time.
    """

    def __init__(self, results_dir: Path, seed: int | None = None) -> None:
        self._results_dir = results_dir
        self._generator = np.random.default_rng(seed)
        self._sessions: OrderedDict[str, tuple[CorridorEnv, threading.Lock]] = OrderedDict()
        self._lock = threading.Lock()

    def new(self, run: object = None, episode: object = None, seed: object = None) -> dict[str, Any]:
        """Begins an episode; what the page needs to draw it.

        Args:
            run: A run's name: the corridor is the one that it was trained in. None for the player's default corridor.
            episode: A number in the run's evaluation: it begins as that one did. None for a new one.
            seed: Of a new episode that was begun before, to begin it again.

        Raises:
            TrainerError: There is no such run or episode, or it can't begin here as it did.
            ValueError: They are no name and numbers.
        """
        env, observation, seed = self._begun(run, episode, seed)
        session = secrets.token_urlsafe(12)
        with self._lock:
            self._sessions[session] = env, threading.Lock()
            while len(self._sessions) > SESSIONS:
                self._sessions.popitem(last=False)
        return {
            "session": session,
            "seed": seed,
            "corridor": corridor_facts(env.config),
            "goal": env.state.goal[0].tolist(),
            "opponent_targets": env.state.opponent_target[0].tolist(),
            "row": {"values": state_row(observation, 0.0, (0.0, 0.0)), "outcome": None},
        }

    def step(self, session: object, action: object) -> dict[str, Any]:
        """Applies an action for one decision.

        Raises:
            ValueError: There is no such drive, it is over, or the action is not two finite numbers.
        """
        key = session if isinstance(session, str) else ""
        with self._lock:
            found = self._sessions.get(key)
        if found is None:
            raise ValueError("This drive is over; begin a new episode.")
        numbers = [FINITE.read(value) for value in action] if isinstance(action, list) else []
        if len(numbers) != 2 or None in numbers:
            raise ValueError(f"The action is {shown(action)}, but two numbers in [-1, 1] were expected.")
        env, lock = found
        with lock:
            clipped = np.clip(np.array(numbers), -1.0, 1.0).astype(np.float32)
            observation, reward, terminated, truncated, info = env.step(clipped)
        outcome = None
        if terminated or truncated:
            outcome = "truncated" if truncated else "goal" if info["is_success"] else "failed"
            with self._lock:
                self._sessions.pop(key, None)
        return {"values": state_row(observation, reward, clipped), "outcome": outcome}

    def _begun(self, run: object, episode: object, seed: object) -> tuple[CorridorEnv, Observation, int | None]:
        if run is None:
            return self._new_episode(CorridorEnv(), seed)
        folder = find_run(self._results_dir, run)
        config = folder.read_config()
        behavior = folder.read_behavior().get("name", "Corridor")  # older runs have none recorded
        if not is_corridor(str(behavior)):
            raise TrainerError(f"{shown(run)} is of behavior {shown(behavior)}, but only a corridor can be driven.")
        if episode is None:
            corridor = corridor_of(config.penalty, config.environment_parameters)
            return self._new_episode(CorridorEnv(**asdict(corridor)), seed)
        number = _whole(episode, "episode")
        return *begin_again(config, load_trajectories(folder.trajectories), number), None

    def _new_episode(self, env: CorridorEnv, seed: object) -> tuple[CorridorEnv, Observation, int]:
        with self._lock:
            number = int(self._generator.integers(2**31)) if seed is None else _whole(seed, "seed")
        return env, env.reset(seed=number)[0], number


def _whole(value: object, what: str) -> int:
    number = WHOLE.read(value, whole=True)
    if number is None:
        raise ValueError(f"The {what} is {shown(value)}, but {WHOLE.expected(whole=True)}.")
    return int(number)


def find_run(results_dir: Path, name: object) -> RunFolder:
    """A run by its path in the results folder, which is compared and never made a path of.

    Raises:
        TrainerError: There is none.
    """
    try:
        for depth in ("*", "*/*"):  # a study's runs are in its folder
            for path in results_dir.glob(f"{depth}/configuration.yaml"):
                run = path.parent
                if run.relative_to(results_dir).as_posix() == name and "~" not in run.name:  # drafts have one
                    return RunFolder(run)
    except OSError:
        pass
    raise TrainerError(f"The run {shown(name)} is gone.")


def one_episode(results_dir: Path, run: str, number: str) -> dict[str, Any]:
    """One episode of a run's recorded evaluation, whether or not it is among those that ``WatchedRuns.scene`` chooses.

    Returns:
        ``{"scene": Scene}``, with that episode alone.

    Raises:
        TrainerError: There is no such run, evaluation or episode.
        ValueError: The number is none.
    """
    folder = find_run(results_dir, run)
    row = _whole(int(number) if number.isdecimal() else number, "episode")
    return {"scene": run_scene(folder.read_config(), load_trajectories(folder.trajectories), number=row)}
