"""One run of a study, as a process of its own: ``python -m trainer.studies.worker``.

The first line on standard input is the run as JSON. The input's end asks for a clean stop: so a run never outlives the
process that started it, whatever ended that.
"""

import json
import os
import signal
import sys
import threading
from pathlib import Path

from corridor_server.standard_streams import drop_failing_output
from trainer.config import ConnectionOptions, RunConfig
from trainer.errors import TrainerError
from trainer.runs.folder import RunFolder


def main() -> int:
    """Trains and evaluates; returns the process's exit code."""
    drop_failing_output()
    order = json.loads(sys.stdin.readline())
    threading.Thread(target=_stop_at_end_of_input, daemon=True).start()
    config = RunConfig.from_dict(order["config"])
    try:
        folder = RunFolder.prepare(config, Path(order["folder"]), resume=False, force=False)
        from trainer.runs.run import train_run

        finished = train_run(
            config,
            folder,
            ConnectionOptions(base_port=order["port"], timeout_wait=order["timeout_wait"]),
            episodes=order["episodes"],
        )
    except TrainerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0 if finished else 130


def _stop_at_end_of_input() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
