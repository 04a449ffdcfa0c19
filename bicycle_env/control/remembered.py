"""What a policy remembers: some numbers for each of the cars that it drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Remembered:
    """Numbers per car, zero when the car starts an episode.

    Args:
        width: how many numbers.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._values: NDArray[np.float64] | None = None

    def reset(self, rows: NDArray[np.bool_] | None = None) -> None:
        """Set to zero the rows where `rows` is True; all of them, for any number of cars, if it is None."""
        if rows is None:
            self._values = None
        elif self._values is not None:
            if np.shape(rows) != (len(self._values),):
                raise ValueError(f"rows must have shape ({len(self._values)},), one per car, got {np.shape(rows)}")
            self._values[rows] = 0.0

    def of(self, cars: int) -> NDArray[np.float64]:
        """(cars, width), to be changed in place; ValueError if there were other cars since the last reset."""
        if self._values is None:
            self._values = np.zeros((cars, self._width))
        if len(self._values) != cars:
            raise ValueError(
                f"observation must hold {len(self._values)} cars as since the last reset(), got {cars}: "
                "call reset() before another number of cars"
            )
        return self._values
