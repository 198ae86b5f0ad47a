"""A run's folder as tests need it: settings of today, and the recorded evaluation of a real trained run.

``golden/trajectories.npz`` (12 episodes) and ``golden/progress.csv`` are of a run in the player's default corridor.
"""

import dataclasses
import shutil
from pathlib import Path

from trainer.commands.train import Train
from trainer.config import RunConfig
from trainer.runs.folder import RunFolder

GOLDEN = Path(__file__).parent / "golden"


def settings(run_id: str = "fast", env: str = "builtin") -> RunConfig:
    """The recorded run's: the player's default corridor, without the preset's changes."""
    return dataclasses.replace(Train(run_id=run_id, env=env).run_config(), environment_parameters={})


def recorded_run(results: Path, run_id: str = "fast", env: str = "builtin", evaluated: bool = True) -> RunFolder:
    folder = RunFolder.prepare(settings(run_id, env), results, resume=False, force=False)
    shutil.copy(GOLDEN / "progress.csv", folder.progress)
    if evaluated:
        shutil.copy(GOLDEN / "trajectories.npz", folder.trajectories)
    return folder
