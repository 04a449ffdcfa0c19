"""Products with a matrix, of many cars at once: each car's is the same to the bit, however many others there are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def product(cars: Any, matrix: NDArray[Any]) -> NDArray[Any]:
    """``cars @ matrix``: (..., n) with (n, m) to (..., m).

    Each car is a product of its own. In one of many rows the order of a row's sums depends, with the BLAS of some
    processors, on how many there are and on which of them it is.
    """
    found: NDArray[Any] = np.matmul(np.asarray(cars)[..., None, :], matrix)[..., 0, :]
    return found
