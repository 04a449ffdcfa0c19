"""Products with a matrix, of many cars at once: each car's is the same to the bit, however many others there are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

ROWS = 16
"""That a product by BLAS has: always as many, because the order of its sums depends on how many there are."""


def in_blocks(cars: Any, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """(blocks, ROWS, entries) from (cars, entries), filled up with zeros."""
    blocks = -(-len(cars) // ROWS)
    filled = np.zeros((blocks * ROWS, cars.shape[1]), dtype)
    filled[: len(cars)] = cars
    return filled.reshape(blocks, ROWS, cars.shape[1])


def product(observation: Any, matrix: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """``observation @ matrix``: (..., n) with (n, m) to (..., m)."""
    cars = np.reshape(observation, (-1, np.shape(observation)[-1]))
    found: NDArray[np.float64] = np.matmul(in_blocks(cars), matrix).reshape(-1, matrix.shape[1])[: len(cars)]
    return found.reshape(*np.shape(observation)[:-1], matrix.shape[1])
