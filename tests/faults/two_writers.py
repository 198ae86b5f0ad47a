"""Two writers of one run folder: train, --resume, --force and evaluate at once, some of them killed.

python tests/faults/two_writers.py --times 50

After each interleaving, the folder must be one run's: settings, every checkpoint, rows and summary of the same run, and
an evaluation by a policy of its own; nothing lies beside it unless a process was killed.
"""

import argparse
import csv
import json
import multiprocessing
import os
import random
import re
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mlagents_envs.base_env import ActionSpec, BehaviorSpec, DimensionProperty, ObservationSpec, ObservationType

from trainer.learning.stages import build_stages
from trainer.main import main as corridor
from trainer.runs.checkpoint import checkpoints, from_bytes
from trainer.runs.folder import RunFolder
from trainer.runs.onnx_file import _Nobody
from trainer.runs.training import load_trained
from trainer.runs.trajectories import load_trajectories

PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["trainer.main", "trainer.runs.run"])
COMMANDS = ("train", "resume", "force", "force", "evaluate")
REFUSALS = (
    r"Another corridor command is writing|exists in|There is no run|begun with other settings|No run|no checkpoint"
)
AREAS = 16
SHORT = ("--num-areas", AREAS, "--eval-episodes", 2, "--timeout-wait", 120)
STEPS = (30_000, 15_000)  # by seed: what one run leaves in the other's folder has a name of its own


@dataclass(frozen=True)
class Ended:
    """How a command ended: what it was, its exit code, and what it said on standard error."""

    what: str
    code: int
    said: str


def interleave(
    results: Path, port: int, generator: random.Random, seconds: float = 5.0, commands: int = 2
) -> list[Ended]:
    """Two writers with a few commands each, of which about half are killed in the first seconds; how each ended."""
    ended: list[Ended] = []
    plans = [
        [
            (
                generator.choice(COMMANDS),
                generator.randrange(2),
                generator.uniform(0.0, 0.1 * seconds),
                generator.choice((None, generator.uniform(0.0, seconds))),
            )
            for _ in range(commands)
        ]
        for _ in range(2)
    ]

    def write(writer: int) -> None:
        for what, seed, pause, killed in plans[writer]:
            time.sleep(pause)
            log = logs / f"{writer}.log"
            process = _start(results, port + 10 * writer, what, seed, log)
            process.join(killed)
            process.kill()
            process.join()
            ended.append(Ended(what, process.exitcode or 0, log.read_text()))

    writers = [threading.Thread(target=write, args=(writer,)) for writer in range(2)]
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder)
        for each in writers:
            each.start()
        for each in writers:
            each.join()
    return ended


def check(results: Path, ended: list[Ended]) -> None:
    """What must be true of the folder, and of how each command ended.

    Raises:
        AssertionError: Something is not.
    """
    for each in ended:
        assert "Traceback" not in each.said, each
        assert each.code in (0, 1, -signal.SIGKILL), each
        assert each.code != 1 or re.search(REFUSALS, each.said), each
    if not any(each.code == -signal.SIGKILL for each in ended):
        assert {path.name for path in results.iterdir()} <= {"mine"}
    if not (results / "mine").exists() and not (results / ".mine~old").exists():
        return
    folder = RunFolder.find("mine", results)  # a change of place that was cut is undone
    config = folder.read_config()
    for path in checkpoints(folder.checkpoints):
        assert from_bytes(path.read_bytes()).facts["config"] == config.as_dict(), path
    if folder.summary.exists():
        assert json.loads(folder.summary.read_text())["seed"] == config.seed
    if folder.progress.exists():
        with folder.progress.open(newline="") as file:
            steps = [float(row["env_steps"]) for row in csv.DictReader(file)]
        assert steps == sorted(set(steps))
    if folder.trajectories.exists():
        _check_played(folder)


def _check_played(folder: RunFolder) -> None:
    """The recorded actions are those of the run's own policy after so many steps, if it still has it."""
    config, recorded = folder.read_config(), load_trajectories(folder.trajectories)
    named = [path for path in checkpoints(folder.checkpoints) if int(path.stem[-10:]) == recorded.env_steps]
    if not named:
        return
    size = recorded.episodes[0].observations.shape[1]
    properties = (DimensionProperty.NONE,)
    seen = ObservationSpec((size,), properties, ObservationType.DEFAULT, "vector")
    stages = build_stages(config, _Nobody(AREAS, BehaviorSpec([seen], ActionSpec.create_continuous(2))))
    load_trained(config, folder, stages, named[-1].name)
    for episode in recorded.episodes:
        observations = np.asarray(stages.normaliser.normalize_obs(episode.observations[:-1]))
        actions, _ = stages.model.predict(observations, deterministic=True)
        assert np.abs(actions - episode.actions).max() < 1e-4, "another policy was played"


def _start(results: Path, port: int, what: str, seed: int, log: Path) -> "multiprocessing.process.BaseProcess":
    """A corridor command in a process of its own, with what it imports imported: that takes longest."""
    where = ["--results-dir", str(results), "--base-port", str(port)]
    if what == "evaluate":
        arguments = ["evaluate", "mine", *where, "--episodes", "2"]
    else:
        flags = [] if what == "train" else [f"--{what}"]
        arguments = ["train", "--run-id", "mine", *where, "--seed", str(seed), *map(str, SHORT), *flags]
        arguments += ["--steps", str(STEPS[seed])]
    process = PROCESSES.Process(target=_run, args=(arguments, log))
    process.start()
    return process


def _run(arguments: list[str], log: Path) -> None:
    with log.open("w") as file:
        os.dup2(file.fileno(), 2)
        sys.stdout = sys.stderr = file
        sys.exit(corridor(arguments))


def main() -> None:
    """Runs the campaign, and says how it went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=50)
    parser.add_argument("--base-port", type=int, default=6600)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    generator, began, codes = random.Random(options.seed), time.monotonic(), Counter[tuple[str, int]]()
    with tempfile.TemporaryDirectory() as folder:
        first = _start(Path(folder), options.base_port, "train", 0, Path(folder) / "log")
        first.join()
        assert first.exitcode == 0
        seconds = time.monotonic() - began  # on this machine, today
        for number in range(options.times):
            if number % 5 == 0:  # with a folder that former interleavings left, and without
                results = Path(folder) / str(number)
                results.mkdir()
            ended = interleave(results, options.base_port, generator, seconds)
            check(results, ended)
            codes.update((each.what, each.code) for each in ended)
            print(f"{number + 1}/{options.times}: {[(each.what, each.code) for each in ended]}", flush=True)
    print(f"all as promised; {dict(codes)}; {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
