"""What a study's finished runs amount to: one number per run for each measure, and its learning curve."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trainer.config import RunConfig

Floats = NDArray[np.float64]
CURVE_POINTS = 150


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        config: What was run.
        summary: ``summary.json``.
        rows: ``progress.csv``; None where a column has no value yet.
        path: Where its folder is.
    """

    config: RunConfig
    summary: Mapping[str, Any]
    rows: Sequence[Mapping[str, float | None]]
    path: str

    def measure(self, name: str) -> float | None:
        """A number of the evaluation or the summary; None if the run has none."""
        source = self.summary["evaluation"] if name in self.summary["evaluation"] else self.summary
        value = source.get(name)
        return None if value is None else float(value)


def scores(runs: Sequence[RunResult], name: str) -> Floats:
    """A measure of every run that has it, (runs,)."""
    found = [run.measure(name) for run in runs]
    return np.array([value for value in found if value is not None], dtype=np.float64)


def steps_to(runs: Sequence[RunResult], name: str) -> Floats:
    """Steps to a success rate, (runs,): a run that never got there counts with all its steps, a lower bound."""
    found = [(run.measure(name), run.config.steps) for run in runs]
    return np.array([steps if value is None else value for value, steps in found], dtype=np.float64)


def curves(runs: Sequence[RunResult], column: str) -> tuple[Floats, Floats]:
    """A column of every run's ``progress.csv`` at common steps.

    Returns:
        Agent steps, (points,), from where every run has a value to where the shortest ends; values, (runs, points).
        Both are empty if a run has no value at all.
    """
    lines = []
    for run in runs:
        points = [(row["env_steps"], row[column]) for row in run.rows if row[column] is not None]
        if not points:
            return np.empty(0), np.empty((len(runs), 0))
        lines.append(np.array(points, dtype=np.float64).T)
    if not lines:
        return np.empty(0), np.empty((0, 0))
    first, last = max(line[0, 0] for line in lines), min(line[0, -1] for line in lines)
    if first > last:
        return np.empty(0), np.empty((len(runs), 0))
    steps = np.linspace(first, last, CURVE_POINTS)
    return steps, np.array([np.interp(steps, *line) for line in lines])
