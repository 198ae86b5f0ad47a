"""Does to training runs what breaks them, over and over at random moments, and checks what docs/faults.md promises.

python tests/faults/campaign.py kills --times 200 --steps 1500000     # SIGKILL and --resume, against an uncut run
python tests/faults/campaign.py signals --times 20                    # SIGINT, SIGTERM, SIGHUP, and --resume
python tests/faults/campaign.py players --times 20                    # SIGKILL, SIGSTOP, a cut connection (root)
python tests/faults/campaign.py disk --times 20                       # a full disk (root), and --resume
python tests/faults/campaign.py readonly --times 20                   # a folder made read-only (root), and --resume
python tests/faults/campaign.py pauses --times 50 --steps 1500000    # SIGSTOP for longer than --timeout-wait, SIGCONT
python tests/faults/campaign.py often --seconds 20 --steps 1500000    # SIGKILL of the player, again and again

Where there are several faults in a line, each is done so many times.
"""

import argparse
import random
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from harness import (
    Run,
    close_folder,
    cut_connection,
    hurt_player,
    kill_players_every,
    mount_small,
    send,
    stop_with,
    train_with_kills,
    train_with_pauses,
)

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
NO_LIMITS = ("--max-lifetime-restarts", -1, "--restarts-rate-limit-n", -1)
PLAYER_FAULTS = (send(signal.SIGKILL), send(signal.SIGSTOP), cut_connection)
KINDS = {
    "kills": 1,
    "often": 1,
    "pauses": 1,
    "signals": len(SIGNALS),
    "players": len(PLAYER_FAULTS),
    "disk": 1,
    "readonly": 1,
}


def main() -> None:
    """Runs one campaign, and says how it went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=list(KINDS))
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--steps", type=int, default=60_000)
    parser.add_argument("--seconds", type=float, default=20.0, help="between two kills of often")
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
        elif options.what == "often":
            run = Run(results, "often", options.base_port, "--steps", options.steps, *NO_LIMITS)
            assert kill_players_every(options.seconds, run) == 0, run.output
            run.leaves_nothing_behind()
            successes = [each.summary()["evaluation"]["success_rate"] for each in (run, uncut)]
            print(f"success {successes[0]}, without kills {successes[1]}; restarts {run.summary()['player_restarts']}")
        elif options.what == "pauses":
            run = Run(results, "paused", options.base_port, "--steps", options.steps, "--timeout-wait", 2)
            assert train_with_pauses(run, options.times, 3.0, generator) == 0, run.output
            assert run.summary()["player_restarts"] == 0
            run.equals(uncut)
        else:
            times = options.times * KINDS[options.what]
            for number in range(times):
                once(options.what, results, uncut, options.steps, options.base_port, generator, number)
                print(f"{options.what} {number + 1}/{times}: as promised", flush=True)
    print(f"{options.what}: all as promised; {time.monotonic() - began:.0f} s")


def once(what: str, results: Path, uncut: Run, steps: int, port: int, generator: random.Random, number: int) -> None:
    """One fault at a random moment."""
    moment, delay = generator.randint(0, steps - 2_000), generator.uniform(0.0, 0.05)
    settings = ("--steps", steps)
    if what == "signals":
        run = Run(results, f"run-{number}", port, *settings)
        assert stop_with(run, SIGNALS[number % len(SIGNALS)], moment, delay) == 130, run.output
        assert "Traceback" not in run.output
        run.leaves_nothing_behind()
        assert run.finish("--resume") == 0, run.output
        run.equals(uncut)
    elif what == "players":
        run = Run(results, f"run-{number}", port, *settings, "--timeout-wait", 10)
        fault = PLAYER_FAULTS[number % len(PLAYER_FAULTS)]
        assert hurt_player(run, fault, max(moment, 1), delay) == 0, run.output
        assert run.summary()["player_restarts"] >= 1
        run.leaves_nothing_behind()
    elif what == "readonly":
        run = Run(results, f"run-{number}", port, *settings)
        process = run.start()
        run.wait_for_steps(process, max(moment, 1))
        time.sleep(delay)
        with close_folder(run.folder / "checkpoints") as closed:
            assert closed, "mounting is not allowed here"
            assert run.wait(process) == 1, run.output
        assert "can't be written (Read-only file system)" in run.output
        assert "Traceback" not in run.output
        run.leaves_nothing_behind()
        assert run.finish("--resume") == 0, run.output
        run.equals(uncut)
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
