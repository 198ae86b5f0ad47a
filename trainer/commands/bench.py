"""``corridor bench``."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from corridor_server.shared.given import Range
from trainer.commands.shared_options import check_file
from trainer.config import BASE_PORT
from trainer.errors import TrainerError
from trainer.options import Options
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Bench(Options):
    """Measure exchange, training, start-up and memory on this machine, or training beside that of others."""

    json: Path | None = None
    """Write the figures to this file, each as soon as it is known: Ctrl-C keeps what was measured."""
    plot: Path | None = None
    """Draw rates to this PNG file."""
    official: str | None = None
    """A Python interpreter that has Unity's published client (mlagents-envs 1.1.0), to be measured beside."""
    base_port: Annotated[int, Range(1, 65532)] = BASE_PORT
    """The first of four ports for players."""
    peers: bool = False
    """Instead: PPO by this trainer, SB3, SBX, PufferLib and plain torch (and mlagents-learn, beside --official)."""

    def run(self, typed: str) -> int:
        """Measures."""
        for option, path in (("--json", self.json), ("--plot", self.plot)):
            if path is not None:
                check_file(path, option)
        if self.official is not None and shutil.which(self.official) is None:
            raise TrainerError(f"--official {self.official} is no program; give a Python that has mlagents-envs 1.1.0.")
        from trainer.activity import doing

        with doing("Getting ready to measure"):
            from trainer.bench.measure import run_bench, run_peers

        (run_peers if self.peers else run_bench)(self.json, self.plot, self.official, self.base_port, Terminal())
        return 0
