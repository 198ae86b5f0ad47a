"""Statistics over few runs, after Agarwal et al., "Deep RL at the Edge of the Statistical Precipice" (2021).

Interquartile means, and percentile bootstrap intervals around them. The bootstrap is stratified: runs are drawn anew
within each arm, never across arms. Every function takes one score per run, (runs,), and a Generator.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES = 10_000
CONFIDENCE = 0.95

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A statistic and its 95% bootstrap interval."""

    value: float
    low: float
    high: float


def iqm(scores: ArrayLike, axis: int = -1) -> Floats:
    """Mean of the middle half: without the lowest and the highest quarter, rounded down to whole runs.

    Fewer than four runs have no quarter to leave out, and give the plain mean.
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=axis)
    count = ordered.shape[axis]
    middle = np.take(ordered, np.arange(count // 4, count - count // 4), axis=axis)
    return np.asarray(middle.mean(axis=axis))


def interval(scores: ArrayLike, generator: np.random.Generator) -> Estimate:
    """The interquartile mean over one arm's runs, and its interval.

    Raises:
        ValueError: There is no score.
    """
    resampled = iqm(_resample(scores, generator))
    return Estimate(float(iqm(scores)), *_quantiles(resampled))


def difference(first: ArrayLike, second: ArrayLike, generator: np.random.Generator) -> Estimate:
    """The first arm's interquartile mean minus the second's, and the interval of that; each arm is a stratum.

    Raises:
        ValueError: An arm has no score.
    """
    resampled = iqm(_resample(first, generator)) - iqm(_resample(second, generator))
    return Estimate(float(iqm(first) - iqm(second)), *_quantiles(resampled))


def band(curves: Floats, generator: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Interquartile mean of curves and its interval at every point; whole curves are drawn.

    Args:
        curves: (runs, points).
        generator: Draws the runs.

    Returns:
        Value, low and high, each (points,).
    """
    drawn = generator.integers(len(curves), size=(RESAMPLES // 10, len(curves)))
    resampled = iqm(curves[drawn], axis=1)
    low, high = np.quantile(resampled, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)
    return iqm(curves, axis=0), low, high


def _resample(scores: ArrayLike, generator: np.random.Generator) -> Floats:
    """(RESAMPLES, runs), each row drawn from the scores with replacement."""
    known = np.asarray(scores, dtype=np.float64)
    if known.ndim != 1 or not len(known):
        raise ValueError(f"Scores of shape {known.shape} can't be resampled; (runs,) with at least one was expected.")
    return known[generator.integers(len(known), size=(RESAMPLES, len(known)))]


def _quantiles(resampled: Floats) -> tuple[float, float]:
    low, high = np.quantile(resampled, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)
