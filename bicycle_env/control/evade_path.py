"""Round an obstacle: a path from the gates of BicycleEvade-v0, followed by LQR with preview."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bicycle_env.control.design.gains import preview_gain
from bicycle_env.control.design.observation_map import Reading
from bicycle_env.control.lqr import Weights, cost_matrices, preview_steps, wanted_states
from bicycle_env.control.policy import Array, Plant, Policy
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

    out_length: float = 1.02
    """s that the way out takes."""
    out_end: float = -0.015
    """s from the obstacle's begin to the end of the way out."""
    offset: float = 3.495
    """m to the side beside the obstacle."""
    back_begin: float = 0.068
    """s from the obstacle's end to the beginning of the way back ..."""
    back_share: float = 0.039
    """... and this share of the time from there to the last gate."""
    back_end: float = 0.116
    """s from the last gate to the end of the way back."""
    return_offset: float = 0.036
    """m to the side after it."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "out_length": (SHORTEST, 10.0),
        "out_end": (-10.0, 10.0),
        "offset": (-10.0, 10.0),
        "back_begin": (-10.0, 10.0),
        "back_share": (-1.0, 1.0),
        "back_end": (-10.0, 10.0),
        "return_offset": (-10.0, 10.0),
    }

    def __post_init__(self) -> None:
        for name, (low, high) in self.RANGES.items():
            object.__setattr__(self, name, number(name, getattr(self, name), low, high))

    def lateral_position(self, begin: Matrix, end: Matrix, last: Matrix, ahead: Matrix) -> Matrix:
        """Of the path [m], to the side of the other lane; s from the front bumper to the gates and to the place."""
        out_end = begin + self.out_end
        back_begin = end + self.back_begin + self.back_share * (last - end)
        back_length = np.maximum(last + self.back_end - back_begin, SHORTEST)
        out = rise((ahead - out_end) / self.out_length + 1.0)
        back = rise((ahead - back_begin) / back_length)
        place: Matrix = self.offset * out + (self.return_offset - self.offset) * back
        return place


BOTH_PATH = PathRound(1.05, -0.063, 3.58, 0.073, 0.15, 0.1, 0.131)
BOTH_WEIGHTS = Weights(1.0, 9.03, 325.0, 0.0969, 0.183, 0.76)
"""Where both axles are steered. They, and PathRound's defaults with the task's weights for the front axle, were each
found together, by cross-entropy on the success of 400 starts of BicycleEvade-v0."""


def rise(share: Matrix) -> Matrix:
    """From 0 to 1, with slope and curvature 0 at both ends: 10 s^3 - 15 s^4 + 6 s^5."""
    s: Any = np.clip(share, 0.0, 1.0)
    risen: Matrix = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    return risen


class EvadePath(Policy):
    """A path round the obstacle, from the gates that are observed, followed by LQR with optimal preview.

    It knows the nominal car, not the friction, and remembers nothing. Attributes: ``path``, ``gain`` (axles, 6) and
    ``preview`` (axles, steps + 1) as those of LQR, and the ``model`` that they were designed for.

    Args:
        plant: an environment that shows the side, the gates and the whole state; ValueError otherwise.
        path, weights: the way round, and those of the LQR; by default the tuned ones.
    """

    name = "evade-path"

    def __init__(self, plant: Plant, path: PathRound | None = None, weights: Weights | None = None) -> None:
        names = list(plant.observation_names)
        missing = [name for name in ("lateral_position", "side", *GATES) if name not in names]
        if missing:
            raise ValueError(
                f"{self.name!r} needs {', '.join(missing)} in the observation, which has {', '.join(names)}"
            )
        both = plant.steer == "both"
        self.path = path or (BOTH_PATH if both else PathRound())
        self.model = plant.linear_model(quasi_static=True)
        Q, R = cost_matrices(plant, weights or (BOTH_WEIGHTS if both else None), plant.speed)
        timestep = self.model.timestep
        steps = preview_steps(np.array([LOOK_AHEAD]), timestep)
        wanted = wanted_states(plant.speed * timestep, timestep, steps)
        self.gain, self.preview = preview_gain(self.model.A, self.model.B, Q, R, wanted, steps)
        self._ahead = timestep * np.arange(steps + 1.0)
        self._reading, self._speed = Reading(plant), plant.speed
        self._lateral, self._side = names.index("lateral_position"), names.index("side")
        self._gates = [names.index(name) for name in GATES]

    def act(self, observation: Array) -> NDArray[np.float32]:
        cars = np.atleast_2d(np.asarray(observation, np.float64)) * self._reading.scale
        begin, end, last = (cars[:, [place]] / self._speed for place in self._gates)
        place = cars[:, [self._side]] * self.path.lateral_position(begin, end, last, self._ahead)
        wanted = place - cars[:, [self._lateral]]
        action: Any = np.clip(-cars @ self._reading.state @ self.gain.T - wanted @ self.preview.T, -1.0, 1.0)
        return np.asarray(action, np.float32).reshape(*np.shape(observation)[:-1], len(self.gain))
