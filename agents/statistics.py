"""Intervals for the tables: Wilson for a share, bootstrap for a mean, interquartile mean over seeds."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Z_95 = 1.959963984540054
RESAMPLES = 5000


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a share (E. B. Wilson, JASA 22, 1927)."""
    share, z2 = successes / trials, Z_95**2
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    low, high = max(0.0, centre - half), min(1.0, centre + half)
    return (0.0 if successes == 0 else low), (1.0 if successes == trials else high)  # exactly; rounded it may miss them


def share(flags: ArrayLike) -> dict[str, Any]:
    """The share of true flags with its 95 % interval."""
    flags = np.asarray(flags, bool)
    return {"value": float(np.mean(flags)), "interval": wilson(int(np.sum(flags)), len(flags))}


def mean(values: ArrayLike) -> dict[str, Any]:
    """The mean with its 95 % bootstrap interval."""
    return {"value": float(np.mean(np.asarray(values, float))), "interval": bootstrap(values)}


def iqm(values: ArrayLike) -> float:
    """Interquartile mean: the mean of the middle half, with fractional weights at its ends."""
    ordered = np.sort(np.asarray(values, float))
    n = len(ordered)
    edges = np.clip(np.arange(n + 1), n / 4, 3 * n / 4)
    weights = np.diff(edges)
    return float(ordered @ weights / weights.sum())


def bootstrap(
    values: ArrayLike, statistic: Callable[[NDArray[np.float64]], float] = lambda x: float(np.mean(x)), seed: int = 0
) -> tuple[float, float]:
    """95 % percentile bootstrap interval of a statistic; fixed seed, so a table repeats."""
    values = np.asarray(values, float)
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, len(values), (RESAMPLES, len(values)))
    samples = np.array([statistic(values[row]) for row in draws])
    low, high = np.percentile(samples, [2.5, 97.5])
    return float(low), float(high)
