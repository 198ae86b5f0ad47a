"""What the runs in a results folder have to show right now, read from their files."""

import csv
import math
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from corridor_server.shared.given import Range, read_json
from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.runs.checkpoint import kept_checkpoints
from trainer.runs.folder import DERIVED, RunFolder, flat_settings
from trainer.runs.trajectories import load_trajectories
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.live import LiveEvaluations

LISTED = 200  # runs, those with the latest news
CURVES = (
    "env_steps",
    "wall_seconds",
    "mean_return",
    "success_rate",
    "mean_episode_length",
    "intrinsic_reward",
    "steps_per_second",
)
EVALUATION = (
    "episodes",
    "success_rate",
    "mean_return",
    "mean_episode_length",
    "mean_success_length",
    "opponent_contact_rate",
    "wall_contact_rate",
)
POINTS = 1000  # of a curve; longer ones are thinned out
FINITE = Range()
QUIET_SECONDS = 120  # without a row of progress, a run is not called training any more

T = TypeVar("T")
Stamp = tuple[int, int]  # of a file: when it was changed, in nanoseconds, and its size


class Found(NamedTuple):
    """A run in the results folder.

    Attributes:
        name: Its path there.
        folder: Its files.
        begun: Stamp of its configuration.
        progress: Stamp of its learning curves, if it has any yet.
    """

    name: str
    folder: RunFolder
    begun: Stamp
    progress: Stamp | None


class WatchedRuns:
    """Reads runs for the page; a file is read again only when it has changed.

    Args:
        results_dir: Where the runs are.
        live: Plays checkpoints of runs that are not finished.
    """

    def __init__(self, results_dir: Path, live: LiveEvaluations) -> None:
        self._results_dir = results_dir
        self._live = live
        self._cache: dict[tuple[str, Path], tuple[Stamp, Any]] = {}
        self._known: dict[str, RunFolder] = {}
        self._states: dict[str, tuple[list[Stamp | None] | None, Path | None, dict[str, Any]]] = {}
        self._lock = threading.Lock()

    def overview(self, chosen: list[str]) -> dict[str, Any]:
        """Every run's state, latest news first, and what those chosen have to compare.

        Returns:
            ``runs``; by the names of those chosen ``curves``, columns of ``progress.csv``, and ``settings``, names
            and texts, which stay what they are while a run's ``news`` do; ``unlisted``, how many runs there are beyond
            those listed.
        """
        found = self._found()
        listed = found[:LISTED]
        asked = {name: folder for name, folder, *_ in listed if name in chosen}
        return {
            "runs": [self._state(*each) for each in listed],
            "curves": {name: self._curves(folder) for name, folder in asked.items()},
            "settings": {name: self._settings(folder) for name, folder in asked.items()},
            "unlisted": len(found) - len(listed),
        }

    def scene(self, name: str) -> dict[str, Any]:
        """A run's newest evaluation: ``{"scene": Scene or null, "note": why there is none yet}``.

        Raises:
            TrainerError: There is no such run, or its files are broken.
        """
        folder = next((each.folder for each in self._found() if each.name == name), None)
        if folder is None:
            raise TrainerError(f"The run {name!r} is gone.")
        kind, checkpoint = self._newest(folder, folder.read_config())
        if kind == "recorded":
            scene = self._read("scene", folder.trajectories, lambda _: _recorded(folder))
            return {"scene": scene, "note": None if scene else "Its evaluation is gone."}
        if kind == "live" and checkpoint is not None:
            scene = self._live.ask(folder.path, checkpoint.stem)
            return {"scene": scene, "note": None if scene else "Its newest checkpoint is being played."}
        return {"scene": None, "note": None}

    def _found(self) -> list[Found]:
        """Runs and runs inside studies, latest news first."""
        found: list[Found] = []
        for outer in _folders_in(self._results_dir):
            if (run := self._run(outer)) is not None:
                found.append(run)
                continue
            inside = [self._run(f"{outer}/{inner}") for inner in _folders_in(self._results_dir / outer)]
            found += [run for run in inside if run is not None]
        with self._lock:
            self._known = {run.name: run.folder for run in found}
        return sorted(found, key=lambda run: (-max(run.begun, run.progress or run.begun)[0], run.name))

    def _run(self, name: str) -> Found | None:
        """The run in a folder, if there is one."""
        folder = self._known.get(name) or RunFolder(self._results_dir / name)
        begun = _stamp(folder.configuration)
        return None if begun is None else Found(name, folder, begun, _stamp(folder.progress))

    def _state(self, name: str, folder: RunFolder, begun: Stamp, progress: Stamp | None) -> dict[str, Any]:
        """A run's state, from memory if none of its files has changed."""
        summary = _stamp(folder.summary)
        stamps = [begun, progress, summary, _stamp(folder.trajectories), _stamp(folder.checkpoints)]
        with self._lock:
            before, newest, state = self._states.get(name, (None, None, {}))
        if before != [*stamps, _stamp(newest) if newest else None]:
            newest = self._newest_checkpoint(folder)
            state = {**self._read_state(name, folder), "news": f"{begun} {progress}"}
            with self._lock:
                self._states[name] = [*stamps, _stamp(newest) if newest else None], newest, state
                while len(self._states) > 2 * LISTED:
                    self._states.pop(next(iter(self._states)))
        return {**state, "status": _status(progress, summary, state["evaluation"] is not None)}

    def _read_state(self, name: str, folder: RunFolder) -> dict[str, Any]:
        problem = None
        config: RunConfig | None = None
        try:
            config = self._config(folder)
        except TrainerError as error:
            problem = str(error)
        curves = self._curves(folder)
        if not curves["env_steps"]:
            problem = problem or "No progress yet."
        scene = None
        if config is not None:
            kind, checkpoint = self._newest(folder, config)
            if kind == "recorded":
                scene = f"recorded {_stamp(folder.trajectories)}"
            elif kind == "live" and checkpoint is not None:
                scene = checkpoint.stem
            elif config.env != "builtin":
                problem = problem or "Its player is not the built-in one: episodes are shown when the run is evaluated."
        return {
            "name": name,
            "env_steps": _last(curves["env_steps"]),
            "steps": config.steps if config else None,
            "c": config.curiosity.c if config else None,
            "seed": config.seed if config else None,
            "success_rate": _last(curves["success_rate"]),
            "steps_per_second": _last(curves["steps_per_second"]),
            "evaluation": _evaluation(self._read("summary", folder.summary, _summary) or {}),
            "scene": scene,
            "problem": problem,
        }

    def _config(self, folder: RunFolder) -> RunConfig | None:
        return self._read("config", folder.configuration, lambda _: folder.read_config())

    def _curves(self, folder: RunFolder) -> dict[str, list[float | None]]:
        return self._read("curves", folder.progress, _curves) or {column: [] for column in CURVES}

    def _settings(self, folder: RunFolder) -> dict[str, str]:
        try:
            config = self._config(folder)
        except TrainerError:
            return {}
        flat = flat_settings(config.as_dict()) if config else {}
        return {name: _text(value) for name, value in flat.items() if name not in ("run_id", *DERIVED)}

    def _newest(self, folder: RunFolder, config: RunConfig) -> tuple[str | None, Path | None]:
        """Whether to show the recorded evaluation or, if it is older or missing, to play the newest checkpoint."""
        checkpoint = self._newest_checkpoint(folder)
        recorded = _stamp(folder.trajectories)
        saved = _stamp(checkpoint) if checkpoint else None
        if recorded and (saved is None or recorded[0] >= saved[0] or config.env != "builtin"):
            return "recorded", None
        if checkpoint and config.env == "builtin":
            return "live", checkpoint
        return None, None

    def _newest_checkpoint(self, folder: RunFolder) -> Path | None:
        kept = self._read("checkpoints", folder.checkpoints, kept_checkpoints)
        return kept[-1] if kept else None

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
            while len(self._cache) > 5 * LISTED:
                self._cache.pop(next(iter(self._cache)))
        return value


def _folders_in(path: Path) -> list[str]:
    try:
        with os.scandir(path) as entries:
            return [entry.name for entry in entries if "~" not in entry.name and entry.is_dir()]  # no drafts
    except OSError:
        return []


def _recorded(folder: RunFolder) -> dict[str, Any]:
    return run_scene(folder.read_config(), load_trajectories(folder.trajectories))


def _status(progress: Stamp | None, summarised: Stamp | None, evaluated: bool) -> str:
    if summarised and (progress is None or summarised[0] >= progress[0]):
        return "finished" if evaluated else "stopped"
    if progress is None:
        return "starting"
    quiet = time.time() - progress[0] / 1e9
    return "training" if quiet < QUIET_SECONDS else f"no news for {quiet / 60:.0f} min"


def _summary(path: Path) -> dict[str, Any]:
    try:
        return read_json(path.read_bytes())
    except ValueError:
        return {}


def _evaluation(summary: dict[str, Any]) -> dict[str, float | None] | None:
    """The numbers of ``summary.json``'s evaluation, and the policy's age in steps and seconds; None without one."""
    found = summary.get("evaluation")
    if not isinstance(found, dict):
        return None
    numbers = {name: FINITE.read(found.get(name)) for name in EVALUATION}
    return numbers | {name: FINITE.read(summary.get(name)) for name in ("env_steps", "wall_seconds")}


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none"
    return "none" if value is None else str(value)


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


def _stamp(path: Path) -> Stamp | None:
    try:
        stat = os.stat(path)
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size
