"""The cross-entropy method for each start (R. Y. Rubinstein, D. P. Kroese, The Cross-Entropy Method, Springer 2004)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_SAMPLES = 8
"""The elite is an eighth."""


class StartSearch:
    """The search for one start: independent normal numbers, moved to the best of the samples drawn from them.

    Args:
        random: its own random numbers.
        mean, deviation: (...,) where it begins.
        least_deviation: what the deviation does not fall below.
        bounds: least and greatest of the samples.
        samples: how many are drawn at a time.
        iterations: at most so many times.
    """

    def __init__(
        self,
        random: np.random.Generator,
        mean: Array,
        deviation: Array,
        least_deviation: Array | float,
        bounds: tuple[Array | float, Array | float],
        samples: int,
        iterations: int,
    ) -> None:
        self.random, self.drawn = random, np.zeros((samples, *mean.shape))
        self.iteration = 0
        self.done = False
        """Set it where nothing better is looked for."""
        self.mean, self._deviation, self._least = mean, deviation, least_deviation
        self._bounds, self._iterations = bounds, iterations

    @property
    def over(self) -> bool:
        """Whether it is done or has had its iterations."""
        return self.done or self.iteration >= self._iterations

    def draw(self) -> Array:
        """(samples, ...)."""
        noise = self.random.standard_normal(self.drawn.shape)
        self.drawn = np.clip(self.mean + self._deviation * noise, *self._bounds)
        return self.drawn

    def learn(self, ranks: Array) -> int:
        """Move to the elite, an eighth of the samples; gives the best sample's index."""
        order = np.argsort(-ranks, kind="stable")
        elite = self.drawn[order[: len(self.drawn) // LEAST_SAMPLES]]
        self.mean = elite.mean(axis=0)
        self._deviation = np.maximum(elite.std(axis=0), self._least)
        self.iteration += 1
        return int(order[0])


def search_each(
    starts: Sequence[int],
    begin: Callable[[int], StartSearch],
    iterate: Callable[[dict[int, StartSearch]], None],
    batch: int,
) -> None:
    """Search for every start, `batch` of them at a time; one that is over makes room for the next.

    A search has its own random numbers and does not see the others: how they are batched changes nothing.

    Args:
        starts: what `begin` takes.
        begin: makes a start's search.
        iterate: one iteration of the searches given, by start.
        batch: starts at a time.
    """
    waiting, running = list(starts), dict[int, StartSearch]()
    while waiting or running:
        free = batch - len(running)
        running |= {k: begin(k) for k in waiting[:free]}
        waiting = waiting[free:]
        iterate(running)
        running = {k: search for k, search in running.items() if not search.over}
