"""Passes over arrays for which NumPy would go through memory several times, compiled by Numba.

Where Numba can't be used, NumPy computes the same, to rounding, in more time. All arrays are float32 and contiguous.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
_Kernel = TypeVar("_Kernel", bound=Callable[..., None])

PROBLEM: str | None = None  # why Numba is not used, for whoever trains
try:
    import numba
except Exception as error:  # whatever a broken installation raises
    numba = None  # type: ignore[assignment]
    _reason = (str(error).splitlines() or [type(error).__name__])[0]
    PROBLEM = f"Numba can't be used ({_reason}), so training is slower; pip install --force-reinstall numba mends it."

_ONE, _HALF = np.float32(1.0), np.float32(0.5)
# tanh(x) is x P(x^2) / Q(x^2), to 4e-7, up to 8, and 1 from there on: a fit by least squares over that range.
_END = np.float32(8.0)
_P0, _P1, _P2, _P3, _P4 = (
    np.float32(each) for each in (9.99999994e-01, 1.34444900e-01, 3.57158864e-03, 2.18945115e-05, 1.52302131e-08)
)
_Q1, _Q2, _Q3, _Q4 = (np.float32(each) for each in (4.67778173e-01, 2.61644069e-02, 3.41127686e-04, 8.52236230e-07))


def _compiled(kernel: _Kernel) -> _Kernel:
    # Sums may be reordered; NaN and infinities keep their meaning, or nobody would notice them.
    options: dict[str, Any] = {
        "fastmath": {"contract", "reassoc", "arcp", "nsz"},
        "error_model": "numpy",
        "nogil": True,
    }
    try:
        compiled: _Kernel = numba.njit(cache=True, **options)(kernel)
    except RuntimeError:  # there is no folder to keep it in
        compiled = numba.njit(**options)(kernel)
    return compiled


if numba is not None:

    @_compiled
    def add_bias_tanh(values: Singles, bias: Singles) -> None:
        """Makes values, (n, units), the tanh of their sum with a bias, (units,)."""
        for row in range(values.shape[0]):
            for column in range(values.shape[1]):
                x = values[row, column] + bias[column]
                if x > _END:
                    x = _END
                elif x < -_END:
                    x = -_END
                z = x * x
                above = (((_P4 * z + _P3) * z + _P2) * z + _P1) * z + _P0
                below = (((_Q4 * z + _Q3) * z + _Q2) * z + _Q1) * z + _ONE
                values[row, column] = x * above / below

    @_compiled
    def to_before_tanh(slope: Singles, tanh: Singles, total: Singles) -> None:
        """Makes d loss / d tanh, (n, units), that of what tanh was taken of, and puts its sum over n in a total."""
        total[:] = np.float32(0.0)
        for row in range(slope.shape[0]):
            for column in range(slope.shape[1]):
                value = slope[row, column] * (_ONE - tanh[row, column] * tanh[row, column])
                slope[row, column] = value
                total[column] += value

    @_compiled
    def add_bias_swish(values: Singles, bias: Singles, bend: Singles) -> None:
        """Makes values, (n, units), the swish x / (1 + exp(-x)) of their sum with a bias, and bend its derivative."""
        for row in range(values.shape[0]):
            for column in range(values.shape[1]):
                half = _HALF * (values[row, column] + bias[column])
                if half < -_END:
                    half = -_END
                x = half
                if x > _END:
                    x = _END
                z = x * x
                above = (((_P4 * z + _P3) * z + _P2) * z + _P1) * z + _P0
                below = (((_Q4 * z + _Q3) * z + _Q2) * z + _Q1) * z + _ONE
                gate = _HALF + _HALF * (x * above / below)  # the logistic function of the sum
                values[row, column] = (half + half) * gate
                bend[row, column] = gate * (_ONE + (x + x) * (_ONE - gate))

    @_compiled
    def to_before_swish(slope: Singles, bend: Singles, total: Singles) -> None:
        """Makes d loss / d swish, (n, units), that of what swish was taken of, and puts its sum over n in a total."""
        total[:] = np.float32(0.0)
        for row in range(slope.shape[0]):
            for column in range(slope.shape[1]):
                value = slope[row, column] * bend[row, column]
                slope[row, column] = value
                total[column] += value

    @_compiled
    def adam_step(
        parameters: Singles,
        gradient: Singles,
        moment: Singles,
        square: Singles,
        factors: Singles,
        rate: np.float32,
        new_slope: np.float32,
        kept_square: np.float32,
        new_square: np.float32,
        correction: np.float32,
        epsilon: np.float32,
    ) -> None:
        """One step of Adam on (size,) parameters; weights of what is new and kept, and of the square's root."""
        for index in range(parameters.shape[0]):
            slope = gradient[index]
            moment[index] += (slope - moment[index]) * new_slope
            square[index] = square[index] * kept_square + slope * slope * new_square
            denominator = np.sqrt(square[index]) * correction + epsilon
            parameters[index] -= moment[index] / denominator * (rate * factors[index])

else:

    def add_bias_tanh(values: Singles, bias: Singles) -> None:
        """Makes values, (n, units), the tanh of their sum with a bias, (units,)."""
        values += bias
        np.tanh(values, out=values)

    def to_before_tanh(slope: Singles, tanh: Singles, total: Singles) -> None:
        """Makes d loss / d tanh, (n, units), that of what tanh was taken of, and puts its sum over n in a total."""
        slope *= _ONE - np.square(tanh)
        slope.sum(axis=0, out=total)

    def add_bias_swish(values: Singles, bias: Singles, bend: Singles) -> None:
        """Makes values, (n, units), the swish x / (1 + exp(-x)) of their sum with a bias, and bend its derivative."""
        values += bias
        gate = _HALF + _HALF * np.tanh(_HALF * values)  # the logistic function of the sum
        bend[...] = gate * (_ONE + values * (_ONE - gate))
        values *= gate

    def to_before_swish(slope: Singles, bend: Singles, total: Singles) -> None:
        """Makes d loss / d swish, (n, units), that of what swish was taken of, and puts its sum over n in a total."""
        slope *= bend
        slope.sum(axis=0, out=total)

    def adam_step(
        parameters: Singles,
        gradient: Singles,
        moment: Singles,
        square: Singles,
        factors: Singles,
        rate: np.float32,
        new_slope: np.float32,
        kept_square: np.float32,
        new_square: np.float32,
        correction: np.float32,
        epsilon: np.float32,
    ) -> None:
        """One step of Adam on (size,) parameters; weights of what is new and kept, and of the square's root."""
        moment += (gradient - moment) * new_slope
        square *= kept_square
        square += np.square(gradient) * new_square
        denominator = np.sqrt(square)
        denominator *= correction
        denominator += epsilon
        parameters -= moment / denominator * (rate * factors)
