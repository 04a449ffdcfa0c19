"""Intervals against hand-computed and published values."""

from __future__ import annotations

import numpy as np
import pytest

from agents.statistics import bootstrap, iqm, wilson


def test_wilson_by_hand():
    # 8 of 10: centre (0.8 + z2/20)/(1 + z2/10), the textbook's 0.4902 and 0.9433.
    assert wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert wilson(0, 10)[0] == 0.0
    assert wilson(10, 10)[1] == 1.0
    assert [wilson(0, n)[0] for n in (200, 500, 2000)] == [0.0] * 3
    assert [wilson(n, n)[1] for n in (200, 500, 2000)] == [1.0] * 3


def test_interquartile_mean_by_hand():
    assert iqm([1, 2, 3, 4]) == 2.5
    assert iqm([100, 1, 2, 3]) == 2.5
    # five values: weights 0, 0.75, 1, 0.75, 0 of 2.5
    assert iqm([0, 1, 2, 5, 1000]) == pytest.approx((0.75 * 1 + 2 + 0.75 * 5) / 2.5)
    assert iqm([7.0]) == 7.0


def test_bootstrap_repeats_and_covers():
    values = np.random.default_rng(0).normal(3.0, 1.0, 200)
    low, high = bootstrap(values)
    assert (low, high) == bootstrap(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(200), rel=0.15)
    assert bootstrap([1.0, 1.0, 1.0], iqm) == (1.0, 1.0)
