"""A study's statistics on cases that can be solved by hand."""

import numpy as np
import pytest

from trainer.studies.bootstrap import band, difference, interval, iqm


def generator() -> np.random.Generator:
    return np.random.default_rng(3)


def test_the_iqm_leaves_out_a_quarter_at_each_end():
    assert iqm([7, 0, 5, 1, 6, 2, 3, 1000]) == (2 + 3 + 5 + 6) / 4


def test_a_quarter_is_rounded_down_to_whole_runs():
    assert iqm([0.0, 1.0, 5.0]) == 2.0
    assert iqm([1000.0, 1.0, 2.0, 3.0, -1000.0]) == 2.0
    # ten runs: two at each end
    assert iqm([0, 0, 1, 1, 1, 1, 1, 1, 9, 9]) == 1.0


def test_the_iqm_along_an_axis_is_that_of_each_line():
    values = np.array([[0.0, 4.0], [1.0, 5.0], [2.0, 6.0], [9.0, 90.0]])
    assert iqm(values, axis=0).tolist() == [1.5, 5.5]


def test_equal_runs_have_no_spread():
    estimate = interval([0.7] * 10, generator())
    assert (estimate.value, estimate.low, estimate.high) == pytest.approx((0.7, 0.7, 0.7))


def test_the_interval_of_two_runs_by_hand():
    """Draws of (0, 1) with replacement have means 0, 1/2 and 1 with chances 1/4, 1/2 and 1/4."""
    estimate = interval([0.0, 1.0], generator())
    assert (estimate.value, estimate.low, estimate.high) == (0.5, 0.0, 1.0)


def test_the_interval_of_many_runs_is_that_of_their_distribution():
    """The IQM of n normal values has a standard error of about 1.09 / sqrt(n)."""
    values = np.random.default_rng(0).standard_normal(400)
    estimate = interval(values, generator())
    assert estimate.high - estimate.low == pytest.approx(2 * 1.96 * 1.09 / np.sqrt(400), rel=0.15)
    assert estimate.low < estimate.value < estimate.high


def test_a_difference_draws_within_each_arm():
    """Drawn across arms, the interval of two constant arms would not be a point."""
    estimate = difference([5.0] * 6, [2.0] * 8, generator())
    assert (estimate.value, estimate.low, estimate.high) == (3.0, 3.0, 3.0)


def test_the_difference_of_two_small_arms_by_hand():
    """First arm: 0, 1/2 or 1 (1/4, 1/2, 1/4); second: 10. The ends have more than 2.5% each."""
    estimate = difference([0.0, 1.0], [10.0], generator())
    assert (estimate.value, estimate.low, estimate.high) == (-9.5, -10.0, -9.0)


def test_intervals_repeat_with_the_seed_and_change_with_it():
    values = np.random.default_rng(1).random(10)
    first, again = (interval(values, np.random.default_rng(5)) for _ in range(2))
    assert first == again
    assert interval(values, np.random.default_rng(6)) != first


def test_a_band_is_an_interval_at_every_point():
    curves = np.array([[0.0, 3.0], [1.0, 3.0]])
    middle, low, high = band(curves, generator())
    assert middle.tolist() == [0.5, 3.0]
    assert low.tolist() == [0.0, 3.0]
    assert high.tolist() == [1.0, 3.0]


def test_no_runs_have_no_interval():
    with pytest.raises(ValueError, match=r"shape \(0,\) can't be resampled"):
        interval([], generator())
