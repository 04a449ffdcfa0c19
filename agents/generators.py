"""States of random generators as plain arrays, so that they can lie in a file that holds no code."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

HALF = 2**64


def of_process() -> dict[str, NDArray[Any]]:
    """States of the generators that a whole process shares: Python's, numpy's global one and torch's on the CPU."""
    version, words, gauss = random.getstate()
    name, keys, place, has_gauss, cached = np.random.get_state(legacy=True)  # noqa: NPY002 (SB3 draws from it)
    if version != 3 or name != "MT19937":
        raise ValueError(f"generators of another kind: Python's {version}, numpy's {name}")
    return {
        "python": np.array(words, np.uint32),
        "python_gauss": np.array([] if gauss is None else [gauss], np.float64),
        "numpy": np.array(keys, np.uint32),
        "numpy_place": np.array([place, has_gauss], np.int64),
        "numpy_gauss": np.array([cached], np.float64),
        "torch": torch.get_rng_state().numpy().copy(),
    }


def set_process(states: Mapping[str, NDArray[Any]]) -> None:
    """Put back what :func:`of_process` gave; ValueError for what no generator can be in."""
    gauss = states["python_gauss"].tolist()
    place, has_gauss = states["numpy_place"].tolist()
    if len(gauss) > 1 or not 0 <= place <= 624 or has_gauss not in (0, 1):
        raise ValueError("the generators' states are impossible")
    try:
        random.setstate((3, tuple(states["python"].tolist()), gauss[0] if gauss else None))
        np.random.set_state(("MT19937", states["numpy"], place, has_gauss, float(states["numpy_gauss"][0])))  # noqa: NPY002
        torch.set_rng_state(torch.from_numpy(states["torch"]))
    except (RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"the generators' states are impossible: {error}") from None


def rows(states: Iterable[Mapping[str, Any]]) -> NDArray[np.uint64]:
    """(generators, 6): states of numpy's PCG64 as numpy gives them, both 128-bit numbers in halves."""
    numbers = []
    for state in states:
        if state["bit_generator"] != "PCG64":
            raise ValueError(f"a generator is not PCG64 but {state['bit_generator']}")
        inner = state["state"]
        numbers.append(
            [*divmod(inner["state"], HALF), *divmod(inner["inc"], HALF), state["has_uint32"], state["uinteger"]]
        )
    return np.array(numbers, np.uint64).reshape(-1, 6)


def from_rows(numbers: NDArray[np.uint64]) -> tuple[dict[str, Any], ...]:
    """The states that :func:`rows` took; ValueError for what PCG64 cannot be in."""
    states = []
    for high, low, inc_high, inc_low, has_uint32, uinteger in numbers.tolist():
        if not inc_low % 2 or has_uint32 > 1 or uinteger >= 2**32:
            raise ValueError("a generator's state is impossible")
        inner = {"state": high * HALF + low, "inc": inc_high * HALF + inc_low}
        states.append({"bit_generator": "PCG64", "state": inner, "has_uint32": has_uint32, "uinteger": uinteger})
    return tuple(states)
