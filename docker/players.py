"""Runs NUM_ENVS players, each on a port of its own from BASE_PORT on, beside a trainer that listens on localhost.

The command line is the player's; ``--mlagents-port N`` is added. A player is started once the trainer listens on its
port (a Unity build that finds nobody there plays on alone), and again if it ends while the trainer goes on. A player
ends with 0 when the trainer told it to, and also, as Unity's does, when the connection breaks: which of the two it was
shows in whether a trainer listens on the port again. Exits with 0 when every player has ended with 0 and no trainer
listens any more, and with 1 when one has failed.
"""

import os
import signal
import socket
import subprocess
import sys
import threading
import time

PATIENCE = float(os.environ.get("TRAINER_PATIENCE", "60"))  # seconds without a trainer before giving up
# Seconds after a player's good end in which a trainer that goes on listens again: it closes the port and opens it anew.
RETURN = 5.0


def wait_for_trainer(port: int, seconds: float) -> bool:
    """Whether the trainer listens on its port before so many seconds have passed."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            socket.create_connection(("localhost", port), 2).close()
            return True
        except OSError:
            time.sleep(0.2)
    return False


def play(command: list[str], port: int, running: dict[int, subprocess.Popen[bytes]], failed: list[int]) -> None:
    """Keeps one player going until the trainer is gone."""
    code = None
    while wait_for_trainer(port, RETURN if code == 0 else PATIENCE):
        running[port] = subprocess.Popen([*command, "--mlagents-port", str(port)])
        code = running[port].wait()
        print(f"The player on port {port} ended with code {code}.", flush=True)
        time.sleep(0.5)  # the trainer closes a port whose player has ended
    print(f"No trainer listens on port {port}.", flush=True)
    if code != 0:
        failed.append(port)


def main() -> int:
    """Runs the players."""
    first, count = int(os.environ.get("BASE_PORT", "5005")), int(os.environ.get("NUM_ENVS", "1"))
    running: dict[int, subprocess.Popen[bytes]] = {}
    failed: list[int] = []

    def stop(number: int, frame: object) -> None:
        for process in running.values():
            process.terminate()
        sys.exit(0)

    signal.signal(signal.SIGTERM, stop)
    ports = range(first, first + count)
    threads = [threading.Thread(target=play, args=(sys.argv[1:], port, running, failed), daemon=True) for port in ports]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
