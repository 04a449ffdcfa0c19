"""One random generator per row, as that many single environments have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from bicycle_env.backends.compiled_random import addresses
from bicycle_env.physics.validation import whole


class Generators:
    """Made when they are first needed; what seeds them is checked by :func:`checked_seeds`.

    Attributes: ``addresses``: where they lie in memory, for compiled code.
    """

    def __init__(self, num_envs: int) -> None:
        self._num_envs = num_envs
        self._each: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self.addresses = np.zeros(0, dtype=np.uint64)

    def seed(self, seeds: Sequence[int | None], mask: NDArray[np.bool_]) -> None:
        """Seed the rows of a mask that have a seed; the others go on, from a random seed at first."""
        if not self._each:
            made = [seeding.np_random(seed) for seed in seeds]
            self._each, self._seeds = [generator for generator, _ in made], [seed for _, seed in made]
        elif any(seed is not None for seed in seeds):
            for row in np.flatnonzero(mask).tolist():
                if seeds[row] is not None:
                    self._each[row], self._seeds[row] = seeding.np_random(seeds[row])
        else:
            return
        self.addresses = addresses(self._each)

    def each(self) -> tuple[np.random.Generator, ...]:
        """The generator of each row."""
        self._make()
        return tuple(self._each)

    def seeds(self) -> tuple[int, ...]:
        """What each row was last seeded with."""
        self._make()
        return tuple(self._seeds)

    def states(self) -> tuple[Any, ...]:
        """Where each generator is."""
        return tuple(generator.bit_generator.state for generator in self._each)

    def restore(self, states: Sequence[Any]) -> None:
        """Put each generator where ``states`` found it."""
        for generator, state in zip(self.each(), states, strict=True):
            generator.bit_generator.state = state

    def _make(self) -> None:
        if not self._each:
            self.seed([None] * self._num_envs, np.ones(self._num_envs, dtype=np.bool_))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "addresses"}  # a copy has its own

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.addresses = addresses(self._each)


def checked_seeds(seed: Any, num_envs: int) -> list[int | None]:
    """A seed or None for each row: from one, row i gets seed + i. ValueError or TypeError for anything else."""
    if seed is None or np.ndim(seed) == 0:
        first = None if seed is None else whole("seed", seed, 0, math.inf)
        return [None if first is None else first + row for row in range(num_envs)]
    if not isinstance(seed, (Sequence, np.ndarray)) or len(seed) != num_envs:
        raise ValueError(f"seed must be None, a whole number, or num_envs = {num_envs} of them, got {seed!r}")
    return [None if one is None else whole(f"seed[{row}]", one, 0, math.inf) for row, one in enumerate(seed)]
