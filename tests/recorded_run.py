"""A run's folder as tests need it: settings of today, and the recorded evaluation of a real trained run.

``golden/trajectories.npz`` (12 episodes) and ``golden/progress.csv`` are of a run named ``fast`` in the default corridor.
"""

import dataclasses
import shutil
from pathlib import Path

from trainer.main import Train
from trainer.results import RunFolder

GOLDEN = Path(__file__).parent / "golden"


def recorded_run(results: Path, run_id: str = "fast", env: str = "builtin", evaluated: bool = True) -> RunFolder:
    config = dataclasses.replace(Train(run_id=run_id, env=env).run_config(), environment_parameters={})
    folder = RunFolder.prepare(config, results, resume=False, force=False)
    shutil.copy(GOLDEN / "progress.csv", folder.progress)
    if evaluated:
        shutil.copy(GOLDEN / "trajectories.npz", folder.trajectories)
    return folder
