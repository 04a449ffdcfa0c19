"""Keywords in their plain form, so that a spec of them can be written as JSON and makes an equal environment."""

from __future__ import annotations

import copy
import os
from typing import Any

import numpy as np


def plain_spec(spec: Any) -> Any:
    """A copy of an EnvSpec whose keywords hold no numpy scalars or arrays; None stays None.

    ``EnvSpec.to_json`` writes dataclasses as their fields by itself: vehicles, actuators and tires are made again from
    these. A tire class of one's own has no plain form; ``gym.make`` of such a spec says so.
    """
    if spec is None:
        return None
    spec = copy.copy(spec)
    spec.kwargs = plain(spec.kwargs)
    return spec


def plain(value: Any) -> Any:
    """Numpy scalars as numbers, arrays as lists, paths as their names; also inside of mappings, lists and tuples."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if type(value) in (list, tuple):
        return type(value)(plain(entry) for entry in value)
    return value
