"""What the runs in a results folder have to show right now, read from their files."""

import csv
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from corridor_server.shared.given import read_json
from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.runs.checkpoint import kept_checkpoints
from trainer.runs.folder import RunFolder
from trainer.runs.trajectories import load_trajectories
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.live import LiveEvaluations

LISTED = 100  # runs, those with the latest news
CURVES = ("env_steps", "mean_return", "success_rate", "mean_episode_length", "intrinsic_reward", "steps_per_second")
POINTS = 1000  # of a curve; longer ones are thinned out
QUIET_SECONDS = 120  # without a row of progress, a run is not called training any more

T = TypeVar("T")


class WatchedRuns:
    """Reads runs for the page; a file is read again only when it has changed.

    Args:
        results_dir: Where the runs are.
        live: Plays checkpoints of runs that are not finished.
    """

    def __init__(self, results_dir: Path, live: LiveEvaluations) -> None:
        self._results_dir = results_dir
        self._live = live
        self._cache: dict[tuple[str, Path], tuple[tuple[int, int], Any]] = {}
        self._lock = threading.Lock()

    def overview(self, chosen: list[str]) -> dict[str, Any]:
        """Every run's state, latest news first, and the learning curves of those chosen."""
        folders = self._folders()
        runs = [self._state(folder) for folder in folders]
        curves = {
            folder.path.name: self._read("curves", folder.progress, _curves) or {column: [] for column in CURVES}
            for folder in folders
            if folder.path.name in chosen
        }
        return {"runs": runs, "curves": curves}

    def scene(self, name: str) -> dict[str, Any]:
        """A run's newest evaluation: ``{"scene": Scene or null, "note": why there is none yet}``.

        Raises:
            TrainerError: There is no such run, or its files are broken.
        """
        folder = next((folder for folder in self._folders() if folder.path.name == name), None)
        if folder is None:
            raise TrainerError(f"The run {name!r} is gone.")
        kind, checkpoint = _newest(folder, folder.read_config())
        if kind == "recorded":
            scene = self._read("scene", folder.trajectories, lambda _: _recorded(folder))
            return {"scene": scene, "note": None if scene else "Its evaluation is gone."}
        if kind == "live" and checkpoint is not None:
            scene = self._live.ask(folder.path, checkpoint.stem)
            return {"scene": scene, "note": None if scene else "Its newest checkpoint is being played."}
        return {"scene": None, "note": None}

    def _folders(self) -> list[RunFolder]:
        try:
            paths = self._results_dir.glob("*/configuration.yaml")
            found = [RunFolder(path.parent) for path in paths if "~" not in path.parent.name]  # drafts have one
            return sorted(found, key=lambda folder: (-_news(folder), folder.path.name))[:LISTED]
        except OSError:
            return []

    def _state(self, folder: RunFolder) -> dict[str, Any]:
        problem = None
        config: RunConfig | None = None
        try:
            config = self._read("config", folder.configuration, lambda _: folder.read_config())
        except TrainerError as error:
            problem = str(error)
        curves = self._read("curves", folder.progress, _curves) or {column: [] for column in CURVES}
        if not curves["env_steps"]:
            problem = problem or "No progress yet."
        scene = None
        if config is not None:
            kind, checkpoint = _newest(folder, config)
            if kind == "recorded":
                scene = f"recorded {_stamp(folder.trajectories)}"
            elif kind == "live" and checkpoint is not None:
                scene = checkpoint.stem
            elif config.env != "builtin":
                problem = problem or "Its player is not the built-in one: episodes are shown when the run is evaluated."
        return {
            "name": folder.path.name,
            "status": _status(folder, self._read("summary", folder.summary, _summary)),
            "env_steps": _last(curves["env_steps"]),
            "steps": config.steps if config else None,
            "c": config.curiosity.c if config else None,
            "seed": config.seed if config else None,
            "success_rate": _last(curves["success_rate"]),
            "steps_per_second": _last(curves["steps_per_second"]),
            "scene": scene,
            "problem": problem,
        }

    def _read(self, what: str, path: Path, read: Callable[[Path], T]) -> T | None:
        """What a file says, from memory if it has not changed; None if it is not there."""
        stamp = _stamp(path)
        if stamp is None:
            return None
        with self._lock:
            cached = self._cache.get((what, path))
        if cached is not None and cached[0] == stamp:
            value: T = cached[1]
            return value
        try:
            value = read(path)
        except FileNotFoundError:
            return None
        with self._lock:
            self._cache[what, path] = stamp, value
            while len(self._cache) > 4 * LISTED:
                self._cache.pop(next(iter(self._cache)))
        return value


def _newest(folder: RunFolder, config: RunConfig) -> tuple[str | None, Path | None]:
    """Whether to show the recorded evaluation or, if it is older or missing, to play the newest checkpoint."""
    kept = kept_checkpoints(folder.checkpoints)
    checkpoint = kept[-1] if kept else None
    recorded = _stamp(folder.trajectories)
    saved = _stamp(checkpoint) if checkpoint else None
    if recorded and (saved is None or recorded[0] >= saved[0] or config.env != "builtin"):
        return "recorded", None
    if checkpoint and config.env == "builtin":
        return "live", checkpoint
    return None, None


def _recorded(folder: RunFolder) -> dict[str, Any]:
    return run_scene(folder.read_config(), load_trajectories(folder.trajectories))


def _status(folder: RunFolder, summary: dict[str, Any] | None) -> str:
    progress, summarised = _stamp(folder.progress), _stamp(folder.summary)
    if summary is not None and summarised and (progress is None or summarised[0] >= progress[0]):
        return "finished" if summary.get("evaluation") else "stopped"
    if progress is None:
        return "starting"
    quiet = time.time() - progress[0] / 1e9
    return "training" if quiet < QUIET_SECONDS else f"no news for {quiet / 60:.0f} min"


def _summary(path: Path) -> dict[str, Any]:
    try:
        return read_json(path.read_bytes())
    except ValueError:
        return {}


def _curves(path: Path) -> dict[str, list[float | None]]:
    """Columns of ``progress.csv``; a row that is not whole yet is left for the next time."""
    try:
        with path.open(newline="", encoding="utf-8", errors="replace") as file:
            rows = [row for row in csv.DictReader(file) if None not in row.values() and _number(row.get("env_steps"))]
    except csv.Error:
        rows = []
    kept = rows[:: max(1, math.ceil(len(rows) / POINTS))]
    if rows and kept[-1] is not rows[-1]:
        kept.append(rows[-1])
    return {column: [_number(row.get(column)) for row in kept] for column in CURVES}


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _last(values: list[float | None]) -> float | None:
    return values[-1] if values else None


def _news(folder: RunFolder) -> int:
    return max((stamp[0] for path in (folder.configuration, folder.progress) if (stamp := _stamp(path))), default=0)


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size
