"""What an environment parameter's message can hold: a number, or one of ML-Agents' samplers with a seed of its own."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class Uniform:
    """ML-Agents' uniform sampler: ``low`` to ``high``."""

    seed: int
    low: float
    high: float

    def sample(self, generator: "np.random.Generator") -> float:
        """Draws one value."""
        return self.low + (self.high - self.low) * generator.random()


@dataclass(frozen=True)
class Gaussian:
    """ML-Agents' Gaussian sampler."""

    seed: int
    mean: float
    standard_deviation: float

    def sample(self, generator: "np.random.Generator") -> float:
        """Draws one value."""
        return self.mean + self.standard_deviation * generator.standard_normal()


@dataclass(frozen=True)
class MultiRangeUniform:
    """ML-Agents' multi-range uniform sampler: uniform over the union of the ranges."""

    seed: int
    ranges: tuple[tuple[float, float], ...]

    def sample(self, generator: "np.random.Generator") -> float:
        """Draws one value."""
        lengths = [high - low for low, high in self.ranges]
        left = generator.random() * sum(lengths)
        for (low, _), length in zip(self.ranges, lengths, strict=True):
            if left <= length:
                return low + left
            left -= length
        return self.ranges[-1][1]


Sampler = Uniform | Gaussian | MultiRangeUniform
Value = float | Sampler
