"""``corridor export``."""

from dataclasses import dataclass
from pathlib import Path

from trainer.commands.shared_options import ExistingRun, check_file
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Export:
    """Write a trained run's policy as an ONNX file that Unity reads."""

    results: ExistingRun
    onnx: Path
    """The file to write."""

    def run(self, typed: str) -> int:
        """Writes the file."""
        check_file(self.onnx, "--onnx")
        folder = self.results.find()
        config = folder.read_config()
        from trainer.runs.onnx_file import export_run

        export_run(config, folder, self.onnx)
        Terminal().print(f"Wrote {self.onnx}")
        return 0
