"""Threads that share the blocks of a step. They are started by the first step, and anew in a forked process."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

FEWEST_PER_THREAD = 512
"""Rows below which another thread costs more than it brings."""
PARTS_PER_THREAD = 8
"""Threads take parts until none is left: one that the machine holds up leaves more to the others."""


class Threads:
    """The calling thread, and helpers beside it.

    Attributes: ``helpers``: how many; 0 where there are few rows.
    """

    def __init__(self, wanted: int, num_envs: int, blocks: int) -> None:
        most = max(1, num_envs // FEWEST_PER_THREAD)
        count = min(wanted, most, blocks)
        parts = 1 if count == 1 else min(PARTS_PER_THREAD * count, most, blocks)
        edges = np.linspace(0, blocks, parts + 1).astype(int).tolist()
        self._parts = list(itertools.pairwise(edges))
        self.helpers = count - 1
        self._pool: Any = None
        self._process = 0

    def sum(self, function: Callable[..., int], arguments: tuple[Any, ...]) -> int:
        """The sum of ``function(*arguments, first, last)`` over parts that make up all blocks."""
        if self._process != os.getpid():  # a fork has this object and none of its threads: it would wait for ever
            self._pool, self._process = ThreadPoolExecutor(self.helpers), os.getpid()
        parts = iter(self._parts)
        others = [self._pool.submit(_take, function, arguments, parts) for _ in range(self.helpers)]
        total: int = _take(function, arguments, parts) + sum(other.result() for other in others)
        return total

    def stop(self) -> None:
        """End the helpers; those of a parent process are not ours."""
        if self._process == os.getpid():
            self._pool.shutdown()
        self._pool, self._process = None, 0


def _take(function: Callable[..., int], arguments: tuple[Any, ...], parts: Iterator[tuple[int, int]]) -> int:
    """One part after the other, as long as there are any."""
    return sum(function(*arguments, first, last) for first, last in parts)
