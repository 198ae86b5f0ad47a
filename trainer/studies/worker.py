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

from trainer.signals import INTERRUPTED, ended_by_signals
from trainer.surroundings import ignore_surroundings


def main() -> int:
    """Trains and evaluates; returns the process's exit code."""
    with ended_by_signals():
        from corridor_server.shared.standard_streams import drop_failing_output

        drop_failing_output()
        ignore_surroundings()
        return _work()


def _work() -> int:
    from trainer.config import ConnectionOptions, RunConfig
    from trainer.errors import TrainerError
    from trainer.runs.folder import RunFolder

    order = json.loads(sys.stdin.readline())
    threading.Thread(target=_stop_at_end_of_input, daemon=True).start()
    config = RunConfig.from_dict(order["config"])
    try:
        with RunFolder.claim(config, Path(order["folder"]), resume=False, force=False) as (folder, draft):
            from trainer.runs.run import train_run

            finished = train_run(
                config,
                folder,
                draft,
                ConnectionOptions(base_port=order["port"], timeout_wait=order["timeout_wait"]),
                episodes=order["episodes"],
            )
    except TrainerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0 if finished else INTERRUPTED


def _stop_at_end_of_input() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
