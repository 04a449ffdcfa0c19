"""What a user gives as an array."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def real_array(value: object) -> NDArray[Any] | None:
    """An array of real numbers, of any shape; None for anything else, a tensor that numpy may not read included."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, RuntimeError):  # ragged lists; tensors elsewhere; tensors that require a gradient
        return None
    return array if array.dtype.kind in "fiu" else None
