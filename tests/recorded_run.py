"""A run's folder as tests need it: settings of today, and the recorded evaluation of a real trained run.

``golden/trajectories.npz`` (12 episodes) and ``golden/progress.csv`` are of a run in the player's default corridor.
"""

import dataclasses
import shutil
from pathlib import Path

from asked import asked

from trainer.config import ConnectionOptions, RunConfig
from trainer.runs.folder import RunFolder
from trainer.runs.run import train_run

GOLDEN = Path(__file__).parent / "golden"


def settings(run_id: str = "fast", env: str = "builtin") -> RunConfig:
    """The recorded run's: the player's default corridor, without the preset's changes."""
    return dataclasses.replace(asked(run_id, env=env).run_config(), environment_parameters={})


def begun_run(config: RunConfig, results: Path) -> RunFolder:
    """The folder of a run that has been begun, and has done nothing yet."""
    with RunFolder.claim(config, results, resume=False, force=False) as (folder, draft):
        RunFolder(draft.path).record(config, {"name": "Corridor?team=0"}, config.num_areas)
        draft.publish()
    return folder


def trained_run(config: RunConfig, results: Path, port: int, *, resume: bool = False) -> RunFolder:
    """Trains as ``corridor train`` does, and evaluates on one episode."""
    connection = ConnectionOptions(base_port=port, timeout_wait=120)
    with RunFolder.claim(config, results, resume=resume, force=False) as (folder, draft):
        train_run(config, folder, draft, connection, episodes=1, resumed=resume)
    return folder


def recorded_run(results: Path, run_id: str = "fast", env: str = "builtin", evaluated: bool = True) -> RunFolder:
    folder = begun_run(settings(run_id, env), results)
    shutil.copy(GOLDEN / "progress.csv", folder.progress)
    if evaluated:
        shutil.copy(GOLDEN / "trajectories.npz", folder.trajectories)
    return folder
