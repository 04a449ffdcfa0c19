"""Round an obstacle: a path from the gates of BicycleEvade-v0, followed by LQR with preview."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.design.gains import preview_gain
from bicycle_env.control.design.observation_map import Reading
from bicycle_env.control.lqr import WeightedPolicy, Weights, preview_steps, wanted_states, weights_of
from bicycle_env.control.policy import Array, Plant
from bicycle_env.control.rows import product
from bicycle_env.control.tunable import Parameter, TunableLaw, searched, values_of
from bicycle_env.physics.validation import explain_keywords, number

Matrix = NDArray[np.float64]

GATES = ("obstacle_begin", "obstacle_end", "last_gate")
LOOK_AHEAD = 1.5
"""s of the preview."""
SHORTEST = 0.3
"""s that a change of lanes takes at least."""


@explain_keywords
@dataclasses.dataclass(frozen=True)
class PathRound:
    """A quintic change into the other lane and one back, in s from the gates [s at the car's speed] and in m."""

    out_length: float
    """s that the way out takes."""
    out_end: float
    """s from the obstacle's begin to the end of the way out."""
    offset: float
    """m to the side beside the obstacle."""
    back_begin: float
    """s from the obstacle's end to the beginning of the way back ..."""
    back_share: float
    """... and this share of the time from there to the last gate."""
    back_end: float
    """s from the last gate to the end of the way back."""
    return_offset: float
    """m to the side after it."""

    def __post_init__(self) -> None:
        for one in PATH:
            object.__setattr__(self, one.name, number(one.name, getattr(self, one.name), one.least, one.greatest))

    def lateral_position(self, begin: Matrix, end: Matrix, last: Matrix, ahead: Matrix) -> Matrix:
        """Of the path [m], to the side of the other lane; s from the front bumper to the gates and to the place."""
        out_begin, back_begin, back_length = ways(self, begin, end, last)
        out, back = rise((ahead - out_begin) / self.out_length), rise((ahead - back_begin) / back_length)
        place: Matrix = self.offset * out + (self.return_offset - self.offset) * back
        return place


PATH = (
    Parameter("out_length", SHORTEST, 10.0, 1.0, 0.15),
    Parameter("out_end", -10.0, 10.0, 0.0, 0.1),
    Parameter("offset", -10.0, 10.0, 3.5, 0.15),
    Parameter("back_begin", -10.0, 10.0, 0.05, 0.1),
    Parameter("back_share", -1.0, 1.0, 0.1, 0.1),
    Parameter("back_end", -10.0, 10.0, 0.1, 0.1),
    Parameter("return_offset", -10.0, 10.0, 0.0, 0.1),
)
"""The fields of ``PathRound``."""
WEIGHTS = {"heading": 20.0, "sideslip": 100.0, "yaw_rate": 0.1, "front_command": 0.5, "rear_command": 0.5}
"""Where a search for the weights begins: from anywhere, three of five ended in worse valleys."""


def ways(path: Any, begin: Matrix, end: Matrix, last: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Where the way out and the way back begin and how long this takes, s; `path` has numbers or one per car."""
    back_begin = end + path.back_begin + path.back_share * (last - end)
    return begin + path.out_end - path.out_length, back_begin, np.maximum(last + path.back_end - back_begin, SHORTEST)


def rise(share: Matrix) -> Matrix:
    """From 0 to 1, with slope and curvature 0 at both ends: 10 s^3 - 15 s^4 + 6 s^5."""
    s: Any = np.clip(share, 0.0, 1.0)
    risen: Matrix = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    return risen


class EvadePath(TunableLaw):
    """A path round the obstacle, from the gates that are observed, followed by LQR with optimal preview.

    It knows the nominal car, not the friction, and remembers nothing. Attributes: ``path``, ``gain`` (axles, 6) and
    ``preview`` (axles, steps + 1) as those of LQR, and the ``model`` that they were designed for.

    Args:
        plant: an environment that shows the side, the gates and the whole state; ValueError otherwise.
        path, weights: the way round, and those of the LQR; by default those that come with the package.
    """

    name = "evade-path"
    tuned_for = "evade"
    parameters = (
        *PATH,
        *(dataclasses.replace(one, start=WEIGHTS[one.name], spread=0.4) for one in WeightedPolicy.parameters),
    )
    planned = tuple(one.name for one in PATH)

    def __init__(self, plant: Plant, path: PathRound | None = None, weights: Weights | None = None) -> None:
        names = list(plant.observation_names)
        missing = [name for name in ("lateral_position", "side", *GATES) if name not in names]
        if missing:
            raise ValueError(
                f"{self.name!r} needs {', '.join(missing)} in the observation, which has {', '.join(names)}"
            )
        usual = self.usual(plant) if path is None or weights is None else None
        values = np.zeros(0) if usual is None else values_of(type(self), plant, usual)
        self.path = PathRound(*values[: len(PATH)]) if path is None else path
        self._path: Any = self.path
        self._weights = searched(type(self), plant)[len(PATH) :]
        self._speed, self._reading = plant.speed, Reading(plant)
        self._lateral, self._side = names.index("lateral_position"), names.index("side")
        self._gates = [names.index(name) for name in GATES]
        self.model = plant.linear_model(quasi_static=True)
        self._steps = preview_steps(np.array([LOOK_AHEAD]), self.model.timestep)
        weights = weights or weights_of(self._weights, values[len(PATH) :])
        self.values = np.array(
            [*dataclasses.astuple(self.path), *(getattr(weights, one.name) for one in self._weights)]
        )
        self.gain, self.preview = self._design(weights)
        self._take([(self.gain, self.preview)])

    @classmethod
    def of(cls, plant: Plant, values: Matrix) -> Self:
        weights = weights_of(searched(cls, plant)[len(PATH) :], values[len(PATH) :])
        return cls(plant, PathRound(*values[: len(PATH)].tolist()), weights)

    def vary(self, values: Matrix) -> None:
        names = [one.name for one in PATH]
        self._path = SimpleNamespace(**dict(zip(names, values[:, : len(PATH)].T.copy(), strict=True)))
        rows, self._row = np.unique(values[:, len(PATH) :], axis=0, return_inverse=True)
        self._take([self._design(weights_of(self._weights, row)) for row in rows])

    def _design(self, weights: Weights) -> tuple[Matrix, Matrix]:
        """``gain`` and ``preview``."""
        timestep = self.model.timestep
        wanted = wanted_states(self._speed * timestep, timestep, self._steps)
        cost = weights.matrices(self._speed, self.model.input_names)
        return preview_gain(self.model.A, self.model.B, *cost, wanted, self._steps)

    def _take(self, designs: Sequence[tuple[Matrix, Matrix]]) -> None:
        """Drive with these; with several, car after car with that of ``_row``."""
        self._feedback = np.array([self._reading.state @ gain.T for gain, _ in designs])
        powers = np.arange(self._steps + 1.0)[:, None] ** np.arange(6)
        self._sums = np.zeros((len(designs), self._steps + 2, 6, len(self.gain)))
        for sums, (_, preview) in zip(self._sums, designs, strict=True):
            sums[1:] = np.cumsum(powers[:, :, None] * preview.T[:, None, :], axis=0)

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float64)) * self._reading.scale
        path, several = self._path, len(self._sums) > 1
        row: Any = self._row if several else 0
        out_begin, back_begin, back_length = ways(path, *(cars[:, gate] / self._speed for gate in self._gates))
        out, back = self._risen(row, out_begin, path.out_length), self._risen(row, back_begin, back_length)
        offset, more = np.atleast_1d(path.offset), np.atleast_1d(path.return_offset - path.offset)
        wanted = cars[:, [self._side]] * (offset[:, None] * out + more[:, None] * back)
        wanted -= cars[:, [self._lateral]] * self._sums[row, -1, 0]
        feedback: Any = self._feedback[row]
        fed = np.einsum("ce,cea->ca", cars, feedback) if several else product(cars, feedback)
        action: Any = np.clip(-fed - wanted, -1.0, 1.0)
        return np.asarray(action, np.float32).reshape(*np.shape(observation)[:-1], len(self.gain))

    def _risen(self, row: Any, begin: Matrix, length: Any) -> Matrix:
        """(cars, axles): preview times ``rise((ahead - begin) / length)``.

        ``rise`` is a polynomial of the time between its ends, so sums of preview times powers of the time are enough.
        """
        begin, length = begin / self.model.timestep, length / self.model.timestep
        ends = (np.clip(np.ceil(end), 0.0, self._steps + 1.0).astype(np.int64) for end in (begin, begin + length))
        first, last = (self._sums[row, place] for place in ends)
        s = -begin / length
        taylor = (
            s * s * s * (10.0 + s * (6.0 * s - 15.0)),
            30.0 * (s * (1.0 - s)) ** 2,
            30.0 * s * (1.0 + s * (2.0 * s - 3.0)),
            10.0 + 60.0 * s * (s - 1.0),
            30.0 * s - 15.0,
            6.0 + 0.0 * s,
        )
        coefficients = np.stack([factor / length**power for power, factor in enumerate(taylor)], axis=1)
        risen: Matrix = np.einsum("cp,cpa->ca", coefficients, last - first) + self._sums[row, -1, 0] - last[:, 0]
        return risen
