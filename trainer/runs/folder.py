"""A run's folder, ``results/<run-id>/``: what is in it, how it comes to be, and who may write to it."""

import csv
import json
import os
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from corridor_server.shared.given import read_mapping, shown
from trainer.config import RunConfig
from trainer.drafts import Draft, mend, only_writer
from trainer.errors import TrainerError
from trainer.files import write_whole
from trainer.options import is_name
from trainer.paper_settings import paper_sections

if TYPE_CHECKING:
    from trainer.runs.checkpoint import Checkpoint

PACKAGES = (
    "curious-corridor",
    "mlagents-envs",
    "stable-baselines3",
    "sb3-contrib",
    "torch",
    "gymnasium",
    "numpy",
    "grpcio",
    "protobuf",
)

# What follows from other settings; runs of before have not recorded it.
DERIVED = ("preset_parameters", "preset_given", "behavior")
# Settings that a resumed run may have changed: how long, where, and how fast it trains, but not what.
MAY_CHANGE = ("steps", "env", "env_args", "graphics", "engine", "device")
CLAIMS = "claims.json"  # of a study
MAY_CHANGE_OF_A_BEHAVIOR = ("max_steps", "summary_freq", "keep_checkpoints", "checkpoint_interval", "even_checkpoints")


class RunFolder:
    """Paths inside one run's folder.

    Args:
        path: The folder, ``results/<run-id>``.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.configuration = path / "configuration.yaml"
        self.summary = path / "summary.json"
        self.progress = path / "progress.csv"
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self.logs = path / "run_logs"
        self.evaluation_logs = self.logs / "evaluation"
        self.learning_curve = path / "learning_curve.png"
        self.episode_paths = path / "episode_paths.png"
        self.trajectories = path / "trajectories.npz"

    @classmethod
    @contextmanager
    def claim(
        cls, config: RunConfig, results_dir: Path, *, resume: bool, force: bool
    ) -> Iterator[tuple["RunFolder", Draft]]:
        """Holds a run's folder, which need not exist, for the command that trains the run; changes nothing in it.

        Yields:
            The folder, and a draft: of the folder, or with ``resume`` of its new files.

        Raises:
            TrainerError: The run id is no folder name, the run exists (without ``resume`` or ``force``), it does not
                (with ``resume``) or has other settings, or the folder can't be written, or another command does.
        """
        if resume and force:
            raise TrainerError("--resume continues a run and --force overwrites it; give one of them.")
        folder = cls(results_dir / config.run_id)
        with only_writer(folder.path, replace=force) as draft:
            if resume:
                folder._check_same_settings(config)
            else:
                folder._check_may_begin(force)
            yield folder, draft

    @classmethod
    def find(cls, run: str, results_dir: Path) -> "RunFolder":
        """The folder of an existing run, by its id or its path.

        Raises:
            TrainerError: There is none.
        """
        for path in run_places(run, results_dir):
            mend(path)
            if os.path.isfile(path / "configuration.yaml"):  # Path's own raises for a name that no file can have
                return cls(path)
        raise TrainerError(f"No run {shown(run)} in {results_dir}; give a run id there, or the path of a run's folder.")

    @property
    def shown(self) -> Path:
        """The path as a person reads it: from the working folder on, where it is below it."""
        try:
            return self.path.relative_to(Path.cwd())
        except (ValueError, OSError):  # it is elsewhere, or there is no working folder any more
            return self.path

    def behavior(self, name: str, only: bool) -> "RunFolder":
        """Where a behavior's own results go: the run's folder if it is the only one, else one of its name in it."""
        if only:
            return self
        return RunFolder(self.path / re.sub(r"[^\w.+-]", lambda found: f"%{ord(found.group()):02X}", name))

    def read_config(self) -> RunConfig:
        """The run's settings.

        Raises:
            TrainerError: ``configuration.yaml`` is missing or broken.
        """
        try:
            return RunConfig.from_dict(self._read_record()["run"])
        except (AttributeError, KeyError, TypeError, TrainerError) as error:
            raise TrainerError(f"{self.configuration} is missing or not a run's configuration ({error}).") from error

    def _read_record(self) -> dict[str, Any]:
        try:
            return read_mapping(self.configuration)
        except ValueError as error:
            raise TrainerError(f"{self.configuration} is missing or not a run's configuration ({error}).") from error

    def record(self, config: RunConfig, behavior: dict[str, Any], agents: int) -> None:
        """Writes ``configuration.yaml`` of a run in lockstep, which ``corridor train`` takes as its file, too.

        Args:
            config: The run's settings.
            behavior: What the players' behavior observes and does.
            agents: How many each player has.
        """
        run = {"run": config.as_dict(), "versions": versions(), "machine": machine()}
        players = {"behavior": behavior, "agents_per_player": agents}
        sections = paper_sections(config, behavior["name"])
        write_whole(self.configuration, yaml.safe_dump({**sections, **run, **players}, sort_keys=False))

    def record_scene(self, config: RunConfig, behaviors: Mapping[str, Any], agents: int) -> None:
        """Writes ``configuration.yaml`` of a run of any behaviors, which ``corridor train`` takes as its file, too.

        Args:
            config: The run's settings.
            behaviors: What each observes and does, as plain values, by full names.
            agents: How many the first player had at first.
        """
        sections = config.sections(behaviors)
        run = {"run": config.as_dict(), "versions": versions(), "machine": machine()}
        players = {"specs": dict(behaviors), "agents_per_player": agents}
        if len(behaviors) == 1:
            players["behavior"] = next(iter(behaviors.values()))
        write_whole(self.configuration, yaml.safe_dump({**sections, **run, **players}, sort_keys=False))

    def read_checkpoint(self, config: RunConfig, name: str | None = None) -> "Checkpoint":
        """Reads a checkpoint of the run; the newest without a name.

        Args:
            config: The run's settings, as its folder had them when it was looked at.
            name: The checkpoint's.

        Raises:
            TrainerError: There is none, it is damaged, it is another run's, or its policies are for other layers.
        """
        from trainer.runs.checkpoint import check_layers, read_checkpoint

        checkpoint = read_checkpoint(self.checkpoints, name)
        try:
            theirs = RunConfig.from_dict(checkpoint.facts["config"])
        except (KeyError, TypeError) as error:
            raise TrainerError(
                f"The checkpoints in {self.checkpoints} are not of this version of curious-corridor ({error})."
            ) from error
        other = {name: both for name, both in _differences(theirs, config).items() if not _may_change(name)}
        if other:
            listed = ", ".join(f"{name} {its} instead of {ours}" for name, (its, ours) in other.items())
            raise TrainerError(
                f"The checkpoint of step {checkpoint.facts['env_steps']:,} in {self.checkpoints} is another run's: it "
                f"has {listed}; delete it, or train the run again with --force."
            )
        for behavior in checkpoint.part("behaviors"):
            if config.settings_for(behavior).trainer_type != "sac":
                check_layers(checkpoint, behavior)
        return checkpoint

    def read_behavior(self) -> dict[str, Any]:
        """The behavior that ``record`` wrote; empty in a run of before it was recorded.

        Raises:
            TrainerError: ``configuration.yaml`` is missing or broken.
        """
        behavior = self._read_record().get("behavior")
        return behavior if isinstance(behavior, dict) else {}

    def read_agents(self) -> int | None:
        """How many agents each player had; None in a run of before they were recorded.

        Raises:
            TrainerError: ``configuration.yaml`` is missing or broken.
        """
        agents = self._read_record().get("agents_per_player")
        return agents if isinstance(agents, int) else None

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Writes ``summary.json`` whole or not at all."""
        write_whole(self.summary, json.dumps(summary, indent=2) + "\n")

    def read_progress(self) -> list[dict[str, float | None]]:
        """The rows of ``progress.csv``; None where a column has no value yet.

        Raises:
            OSError: There is no such file, or it can't be read.
            TrainerError: It is broken.
        """
        try:
            with self.progress.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            return [{name: float(text) if text else None for name, text in row.items()} for row in rows]
        except (csv.Error, TypeError, ValueError) as error:
            raise TrainerError(f"{self.progress} is broken ({error}).") from error

    def _check_same_settings(self, config: RunConfig) -> None:
        if not self.configuration.is_file():
            raise TrainerError(
                f"There is no run {config.run_id!r} in {self.path.parent} to resume; leave --resume out."
            )
        differing = _differences(self.read_config(), config)
        if not all(map(_may_change, differing)):
            listed = ", ".join(
                f"{name} {before} -> {now} ({'not ' * (not _may_change(name))}allowed)"
                for name, (before, now) in differing.items()
            )
            raise TrainerError(
                f"Run {config.run_id!r} was begun with other settings: {listed}; give those that it began with, or "
                "begin another run. Only these may change: " + ", ".join(MAY_CHANGE) + "."
            )

    def _check_may_begin(self, force: bool) -> None:
        if not self.path.exists():
            return
        if not force:
            raise TrainerError(
                f"The run {self.path.name!r} exists in {self.path.parent}; continue it with --resume, overwrite it "
                "with --force, or choose another --run-id."
            )
        if not self.configuration.is_file() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise TrainerError(
                f"{self.path} is not a run's folder, so --force leaves it alone; choose another --run-id."
            )


def _differences(one: RunConfig, other: RunConfig) -> dict[str, tuple[Any, Any]]:
    """Settings that differ, and what each has."""
    before, now = flat_settings(one.as_dict()), flat_settings(other.as_dict())
    names = (before.keys() | now.keys()) - set(DERIVED)
    if not (one.unlisted_settings and other.unlisted_settings):  # of before, or a corridor's
        names = {name for name in names if not name.startswith("unlisted_settings")}
    return {name: (before.get(name), now.get(name)) for name in sorted(names) if before.get(name) != now.get(name)}


def _may_change(name: str) -> bool:
    first, _, rest = name.partition(".")
    if first in ("behaviors", "default_settings", "unlisted_settings"):
        return rest.rpartition(".")[2] in MAY_CHANGE_OF_A_BEHAVIOR
    return first in MAY_CHANGE


def run_places(run: str, results_dir: Path) -> list[Path]:
    """Where a run may be: in the results folder under its id, or a study's and its id; or at its own path."""
    names = run.split("/")
    inside = [results_dir / run] if all(is_name(name) for name in names) else []
    return [*inside, Path(run)]


def is_study(folder: Path) -> bool:
    """Whether ``corridor study`` has reported in this folder."""
    return os.path.isfile(folder / CLAIMS)


def flat_settings(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Settings in sections under one name each, such as ``ppo.gamma``."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= flat_settings(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def versions() -> dict[str, str]:
    """Versions of Python and of what a run depends on, by package."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def machine() -> dict[str, Any]:
    """What kind of machine this is."""
    return {"system": platform.system(), "machine": platform.machine(), "cpus": os.cpu_count()}
