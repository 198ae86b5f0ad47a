"""A run as ``tests/faults/harness.py`` has it, whose trainers begin with everything imported."""

import sys
from pathlib import Path

from prepared import Prepared

sys.path.insert(0, str(Path(__file__).parent / "faults"))
from harness import Run


class PreparedRun(Run):
    """A run of the tests; ``campaign.py`` has processes that import for themselves."""

    def start(self, *options: object) -> Prepared:
        return Prepared([*self._command, *options])
