"""``corridor watch``."""

from dataclasses import dataclass
from typing import Annotated

from corridor_server.shared.given import Range
from trainer.commands.shared_options import OpenPage, ResultsDir, open_page
from trainer.config import RESULTS
from trainer.options import Options
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Watch(Options):
    """Watch runs while they train, and drive the learner yourself, in a browser on this machine."""

    port: Annotated[int, Range(0, 65535, otherwise="ports go from 1 to 65535")] = 8008  # 0 takes a free one
    """Port of the page, on loopback."""
    results_dir: ResultsDir = RESULTS
    open: OpenPage = False

    def run(self, typed: str) -> int:
        """Serves the page until Ctrl-C."""
        from trainer.activity import doing

        with doing("Starting the page"):
            from trainer.viewer.page_server import watch
        watch(self.results_dir, self.port, Terminal(), open_page if self.open else None)
        return 0
