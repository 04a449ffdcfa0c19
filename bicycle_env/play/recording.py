"""Episodes as arrays in an .npz file, with the names of their columns."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.files import write_bytes
from bicycle_env.play.drives import Drive


class Recording:
    """Of every episode its states, observations, actions and rewards; one row for each policy and start.

    The file holds, of E episodes with at most T steps: ``policy``, ``seed``, ``outcome``, ``steps``, (E,) each;
    ``state`` (E, T + 1, states) in SI units, ``observation`` (E, T + 1, entries), ``action`` (E, T, axles), ``reward``
    (E, T), nan after the end; ``state_names``, ``observation_names``, ``action_names``; ``timestep`` [s]. No pickles.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._episodes: list[tuple[str, int, str, tuple[Any, ...]]] = []
        self._names: dict[str, Any] = {}

    def add(self, drives: Sequence[Drive], seed: int) -> None:
        """The episodes that these have driven from a start."""
        plant = drives[0].plant
        axles = {"front": ("front",), "rear": ("rear",), "both": ("front", "rear")}[plant.steer]
        self._names = {
            "state_names": plant.state._fields,
            "observation_names": plant.observation_names,
            "action_names": [f"{axle}_steer" for axle in axles],
            "timestep": plant.action_timestep,
        }
        for one in drives:
            columns = one.states, one.observations, one.actions, one.rewards
            self._episodes.append((one.name, seed, one.words, tuple(np.array(column) for column in columns)))

    def close(self) -> None:
        """Write the file, whole or not at all."""
        names, seeds, outcomes, columns = zip(*self._episodes, strict=True)
        state, observation, action, reward = (_filled(each) for each in zip(*columns, strict=True))
        content = io.BytesIO()
        arrays: dict[str, Any] = {
            "policy": np.array(names),
            "seed": np.array(seeds),
            "outcome": np.array(outcomes),
            "steps": np.array([len(each[3]) for each in columns]),
            "state": state,
            "observation": observation,
            "action": action,
            "reward": reward,
            **{name: np.array(value) for name, value in self._names.items()},
        }
        np.savez_compressed(content, **arrays)
        write_bytes(self._path, content.getvalue())


def _filled(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """One array of several of different lengths, the shorter ones followed by nan."""
    longest = max(len(one) for one in arrays)
    found = np.full((len(arrays), longest, *arrays[0].shape[1:]), np.nan, arrays[0].dtype)
    for row, one in zip(found, arrays, strict=True):
        row[: len(one)] = one
    return found
