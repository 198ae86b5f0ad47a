"""When a program learns: only while it is its turn, so that those beside it are measured on an idle machine."""

import json
import math
import sys
import time


class Turns:
    """Reads lines of seconds, and prints what was done in each turn as a line of JSON.

    A program calls ``goes_on`` before each update. Once ``warm_up`` of them are done it prints ``ready``; from there on
    it waits for a line, learns for so long, and prints ``steps``, ``seconds``, ``loss`` and ``reward`` of the turn.

    Args:
        warm_up: Updates before anything is measured.
    """

    def __init__(self, warm_up: int) -> None:
        self._warm_up = warm_up
        self._seconds = self._begun = self._reward = 0.0
        self._steps = 0
        self._measures = False

    def goes_on(self, steps: int, reward: float, loss: float) -> bool:
        """Whether to make another update; waits for the next turn, if this one is over.

        Args:
            steps: Agent steps so far.
            reward: The sum of all rewards so far.
            loss: Of the last update.
        """
        if self._warm_up > 0:
            self._warm_up -= 1
            return True
        now = time.perf_counter()
        if self._measures and now - self._begun < self._seconds:
            return True
        if self._measures:
            done = steps - self._steps
            turn = {
                "steps": done,
                "seconds": now - self._begun,
                "loss": loss if math.isfinite(loss) else None,
                "reward": (reward - self._reward) / max(done, 1),
            }
            print(json.dumps(turn), flush=True)
        else:
            print("ready", flush=True)
        line = sys.stdin.readline()
        if not line:
            return False
        self._measures, self._seconds = True, float(line)
        self._steps, self._reward = steps, reward
        self._begun = time.perf_counter()
        return True
