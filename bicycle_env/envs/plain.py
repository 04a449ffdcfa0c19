"""Keywords in their plain form, so that a spec of them can be written as JSON and makes an equal environment."""

from __future__ import annotations

import copy
import dataclasses
import os
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from bicycle_env.envs.setup import NAMES


class UnwritableSpec(EnvSpec):
    """Of an environment with a law of one's own."""

    def to_json(self) -> str:
        """ValueError: what is written would be the law's numbers without the law."""
        own = next(name for name in NAMES if _is_own(self.kwargs.get(name)))
        raise ValueError(
            f"{own}={self.kwargs[own]!r} is of one's own and has no plain form, so that JSON would lose it: keep the "
            "spec itself (gym.make takes it, and it pickles), or the other keywords"
        )


def plain_spec(spec: Any) -> Any:
    """A copy of an EnvSpec whose keywords hold no numpy scalars or arrays; None stays None.

    ``EnvSpec.to_json`` writes dataclasses as their fields by itself: vehicles, actuators and tires are made again from
    these. A tire, a reward or another law of one's own has no plain form, and then it raises.
    """
    if spec is None:
        return None
    spec = copy.copy(spec)
    spec.kwargs = plain(spec.kwargs)
    if any(_is_own(spec.kwargs.get(name)) for name in NAMES):
        spec.__class__ = UnwritableSpec
    return spec


def _is_own(value: Any) -> bool:
    """Whether a keyword holds an object of a class that is not this package's."""
    if isinstance(value, (list, tuple, dict)):
        return any(map(_is_own, value.values() if isinstance(value, dict) else value))
    return dataclasses.is_dataclass(value) and type(value).__module__.partition(".")[0] != __name__.partition(".")[0]


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
