"""Does to training runs what breaks them, over and over at random moments, and checks what docs/faults.md promises.

python tests/faults/campaign.py kills --times 200 --steps 1500000     # SIGKILL and --resume, against an uncut run
python tests/faults/campaign.py signals --times 20                    # SIGINT, SIGTERM, SIGHUP, and --resume
python tests/faults/campaign.py players --times 20                    # SIGKILL and SIGSTOP of the player
python tests/faults/campaign.py disk --times 20                       # a full disk (root only), and --resume
"""

import argparse
import random
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from harness import Run, hurt_player, mount_small, stop_with, train_with_kills


def main() -> None:
    """Runs one campaign, and says how it went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["kills", "signals", "players", "disk"])
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--steps", type=int, default=60_000)
    parser.add_argument("--base-port", type=int, default=6400)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    generator, began = random.Random(options.seed), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder)
        uncut = Run(results, "uncut", options.base_port, "--steps", options.steps)
        assert uncut.finish() == 0, uncut.output
        if options.what == "kills":
            run = Run(results, "killed", options.base_port, "--steps", options.steps)
            moments = train_with_kills(run, options.times, options.steps, generator)
            run.equals(uncut)
            print(f"{len(moments)} kills, at steps {moments}; resumes counted: {run.summary()['resumes']}")
        else:
            for time_number in range(options.times):
                once(options.what, results, uncut, options.steps, options.base_port, generator, time_number)
                print(f"{options.what} {time_number + 1}/{options.times}: as promised", flush=True)
    print(f"{options.what}: all as promised; {time.monotonic() - began:.0f} s")


def once(what: str, results: Path, uncut: Run, steps: int, port: int, generator: random.Random, number: int) -> None:
    """One fault at a random moment."""
    moment, delay = generator.randint(0, steps - 2_000), generator.uniform(0.0, 0.05)
    settings = ("--steps", steps)
    if what == "signals":
        run = Run(results, f"run-{number}", port, *settings)
        sent = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)[number % 3]
        assert stop_with(run, sent, moment, delay) == 130, run.output
        assert "Traceback" not in run.output
        run.leaves_nothing_behind()
        assert run.finish("--resume") == 0, run.output
        run.equals(uncut)
    elif what == "players":
        run = Run(results, f"run-{number}", port, *settings, "--timeout-wait", 10)
        sent = (signal.SIGKILL, signal.SIGSTOP)[number % 2]
        assert hurt_player(run, sent, max(moment, 1), delay) == 0, run.output
        assert run.summary()["player_restarts"] >= 1
        run.leaves_nothing_behind()
    else:
        disk = results / "disk"
        assert mount_small(disk, f"{generator.randint(100, 800)}k"), "a small disk can't be mounted here"
        try:
            run = Run(disk, f"run-{number}", port, *settings)
            assert run.finish() == 1, run.output
            assert "No space left on device" in run.output
            assert "Traceback" not in run.output
            run.leaves_nothing_behind()
            subprocess.run(["mount", "-o", "remount,size=50m", str(disk)], check=True)
            begun = (run.folder / "configuration.yaml").exists()
            assert run.finish("--resume" if begun else "--force") == 0, run.output
            run.equals(uncut)
        finally:
            subprocess.run(["umount", "-l", str(disk)], check=True)
    shutil.rmtree(run.folder, ignore_errors=True)


if __name__ == "__main__":
    main()
