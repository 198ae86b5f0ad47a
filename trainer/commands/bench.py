"""``corridor bench``."""

from dataclasses import dataclass
from pathlib import Path

from trainer.config import BASE_PORT
from trainer.options import Options, Port
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Bench(Options):
    """Measure exchange, training, start-up and memory on this machine."""

    json: Path | None = None
    """Write the figures to this file."""
    plot: Path | None = None
    """Draw the rate against the number of areas to this PNG file."""
    official: str | None = None
    """A Python interpreter that has Unity's published client (mlagents-envs 1.1.0), to be measured beside."""
    base_port: Port = BASE_PORT
    """The first of three ports for players."""

    def run(self, typed: str) -> int:
        """Measures."""
        from trainer.bench.measure import run_bench

        run_bench(self.json, self.plot, self.official, self.base_port, Terminal())
        return 0
