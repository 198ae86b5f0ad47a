"""``corridor export``."""

from dataclasses import dataclass
from pathlib import Path

from trainer.commands.shared_options import ExistingRun, check_file
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Export:
    """Write a trained run's policies as ONNX files that Unity reads."""

    results: ExistingRun
    onnx: Path
    """The file to write; of several behaviors, each has its own: Game.onnx is then Game-Fox.onnx, Game-Hare.onnx."""

    def run(self, typed: str) -> int:
        """Writes the files."""
        check_file(self.onnx, "--onnx")
        folder = self.results.find()
        config = folder.read_config()
        from trainer.activity import doing
        from trainer.runs.checkpoint import find_checkpoint

        find_checkpoint(folder.checkpoints)
        with doing("Loading PyTorch"):
            from trainer.runs.onnx_file import export_run

        with doing("Writing policies, and comparing them with the trained ones"):
            paths = export_run(config, folder, self.onnx)
        for path in paths:
            Terminal().print(f"Wrote {path}")
        return 0
