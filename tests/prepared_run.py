"""A run as ``tests/faults/harness.py`` has it, whose trainers begin with everything imported and write rows often."""

import sys
from pathlib import Path

from conftest import WITH_ROWS
from prepared import Prepared

sys.path.insert(0, str(Path(__file__).parent / "faults"))
from harness import Run


class PreparedRun(Run):
    """A run of the tests; ``campaign.py`` has processes that import for themselves."""

    def start(self, *options: object) -> Prepared:
        return Prepared([WITH_ROWS, *self._command[1:], *options])
