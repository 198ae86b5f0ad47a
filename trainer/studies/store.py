"""The one place that a study's runs and reports go to: a folder, or an fsspec URL such as ``s3://bucket/results``."""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import fsspec
from fsspec.implementations.local import LocalFileSystem

from corridor_server.shared.given import read_json
from trainer.config import RunConfig
from trainer.drafts import only_writer
from trainer.errors import TrainerError
from trainer.files import write_whole
from trainer.runs.folder import RunFolder
from trainer.signals import temporary_folder
from trainer.studies.results import RunResult

READ = ("configuration.yaml", "summary.json", "progress.csv")
PATIENCE_SECONDS = 30.0  # with another attempt that is just putting the same run in its place


class Store:
    """Results by study: ``<place>/<study>/<run-id>/`` is an ordinary run folder.

    Args:
        place: A path or an fsspec URL.

    Raises:
        TrainerError: The URL is of an unknown kind, or of one that is not installed.
    """

    def __init__(self, place: str) -> None:
        try:
            self.fs, self.root = fsspec.core.url_to_fs(place)
        except Exception as error:  # every fsspec file system raises its own
            raise TrainerError(f"--results-dir {place} can't be used: {error}") from error
        self._is_local = isinstance(self.fs, LocalFileSystem)
        self.place = self.root if self._is_local else place.rstrip("/")

    @contextmanager
    def only_writer(self, study: str) -> Iterator[None]:
        """Holds a study's folder against other studies; at a URL, nothing can be held.

        Raises:
            TrainerError: Another command is writing to it.
        """
        with only_writer(Path(self.root, study)) if self._is_local else nullcontext():
            yield

    def check_writable(self) -> None:
        """Writes and removes a file.

        Raises:
            TrainerError: It can't be done.
        """
        probe = f"{self.root}/.probe-{uuid.uuid4().hex}"
        try:
            self.fs.makedirs(self.root, exist_ok=True)
            self.fs.pipe_file(probe, b"-")
            self.fs.rm_file(probe)
        except Exception as error:  # every fsspec file system raises its own
            raise TrainerError(
                f"--results-dir {self.place} can't be written ({error}); choose another place, or log in to it."
            ) from error

    def find(self, config: RunConfig, study: str, episodes: int) -> str | None:
        """The folder of a finished run with this configuration, in this study's folder or in another's.

        Args:
            config: The run.
            study: Whose folder is looked into first.
            episodes: Of its evaluation.

        Raises:
            TrainerError: The run's own place in this study holds something else.
        """
        own = f"{self.root}/{study}/{config.run_id}"
        others = [f"{self.root}/{name}/{config.run_id}" for name in sorted(self._names_in(self.root) - {study})]
        for path in (own, *others):
            if self._has(path, config, episodes):
                return path
            if path == own and self._read_config(path) != config and self._names_in(path) - {"run_logs"}:
                raise TrainerError(
                    f"{path} is not a run with this study's settings; choose another --results-dir, or remove it."
                )
        return None

    def publish_run(self, folder: Path, config: RunConfig, study: str, episodes: int) -> None:
        """Puts a run's folder in its place, whole or not at all (at a URL: ``summary.json`` last).

        Does nothing if the run is finished there already: a run is never in the results twice, even if a lost node
        turns out to be alive.
        """
        path = f"{self.root}/{study}/{config.run_id}"
        if self._is_local:
            with only_writer(Path(path), replace=True, seconds=PATIENCE_SECONDS) as draft:
                if not self._has(path, config, episodes):
                    shutil.copytree(folder, draft.path, dirs_exist_ok=True)
                    draft.publish()
            return
        if self._has(path, config, episodes):
            return
        if self.fs.exists(path):
            self.fs.rm(path, recursive=True)
        files = sorted(each for each in folder.rglob("*") if each.is_file())
        for file in sorted(files, key=lambda each: each.name == "summary.json"):
            self.put(file, f"{study}/{config.run_id}/{file.relative_to(folder).as_posix()}")

    def put(self, file: Path, name: str) -> None:
        """Copies a file to a path under the place, whole or not at all."""
        target = f"{self.root}/{name}"
        self.fs.makedirs(target.rpartition("/")[0], exist_ok=True)
        if not self._is_local:
            self.fs.put_file(str(file), target)
            return
        write_whole(Path(target), file.read_bytes())

    def load(self, path: str) -> RunResult:
        """Reads a finished run.

        Raises:
            TrainerError: A file is missing or broken.
        """
        with temporary_folder() as temporary:
            folder = RunFolder(temporary)
            try:
                for name in READ:
                    self.fs.get_file(f"{path}/{name}", str(folder.path / name))
                summary = read_json(folder.summary.read_bytes())
                return RunResult(folder.read_config(), summary, folder.read_progress(), path)
            except (OSError, ValueError) as error:
                raise TrainerError(
                    f"The run {path} can't be read ({error}); remove it and run the study again."
                ) from error

    def _has(self, path: str, config: RunConfig, episodes: int) -> bool:
        return self._is_finished(path, episodes) and self._read_config(path) == config

    def _names_in(self, path: str) -> set[str]:
        try:
            return {name.rstrip("/").rpartition("/")[2] for name in self.fs.ls(path, detail=False)}
        except OSError:
            return set()

    def _read_config(self, path: str) -> RunConfig | None:
        try:
            with temporary_folder() as temporary:
                folder = RunFolder(temporary)
                self.fs.get_file(f"{path}/configuration.yaml", str(folder.configuration))
                return folder.read_config()
        except (OSError, TrainerError):
            return None

    def _is_finished(self, path: str, episodes: int) -> bool:
        try:
            return bool(read_json(self.fs.cat_file(f"{path}/summary.json"))["evaluation"]["episodes"] == episodes)
        except (OSError, ValueError, KeyError, TypeError):
            return False
