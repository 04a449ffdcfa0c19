"""What an observation tells a controller, in SI units: where the car is and where the path goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control.policy import Plant
from bicycle_env.tasks.path import follows_path

Matrix = NDArray[np.float64]


class Reading:
    """Linear maps of the observation, as matrices that it is multiplied with from the left.

    Args:
        needed: those of ``STATE_NAMES`` without which it cannot be; ValueError names the missing.

    Attributes:
        scale: (entries,), SI value per unit of the observation.
        state: (entries, 6), SI entries to ``STATE_NAMES``. Lateral positions are counted from the car: the first is 0.
        path: (entries, points), SI entries to the lateral distance from the car to the path at ``times``.
        times: (points,), s ahead; the first is now, the others are the task's preview.
    """

    def __init__(self, plant: Plant, needed: tuple[str, ...] = STATE_NAMES[1:]) -> None:
        names = plant.observation_names
        on_path = "lateral_error" in names or follows_path(plant.task)
        lateral = "lateral_error" if on_path else "lateral_position"
        self._names = names
        self._must_have(lateral, *needed)
        self.scale = plant.observation_scale
        self.times = look_ahead_times(plant)
        self.state = np.zeros((len(names), len(STATE_NAMES)))
        for name in needed:
            self.state[names.index(name), STATE_NAMES.index(name)] = 1.0
        points = len(self.times)
        self.path = np.zeros((len(names), points))
        self.path[names.index(lateral), 0] = -1.0
        if points > 1:
            self.path[-(points - 1) :, 1:] = np.eye(points - 1)

    def _must_have(self, *needed: str) -> None:
        missing = [name for name in needed if name not in self._names]
        if missing:
            raise ValueError(
                f"this controller needs {', '.join(missing)} in the observation, which has {', '.join(self._names)}"
            )

    def index(self, name: str) -> int:
        """Of an entry; ValueError names it where it is missing."""
        self._must_have(name)
        return self._names.index(name)

    def state_feedback(self, gain: Matrix) -> Matrix:
        """(entries, axles): ``observation @ matrix`` is gain x, for a gain (axles, 6)."""
        return (self.state @ gain.T) * self.scale[:, None]

    def path_feedback(self, preview: Matrix) -> Matrix:
        """(entries, axles): ``observation @ matrix`` is preview w, for a preview (axles, points)."""
        return (self.path @ preview.T) * self.scale[:, None]


def look_ahead_times(plant: Plant) -> Matrix:
    """(points,): now, and the task's preview times, s."""
    return np.array([0.0, *plant.task.preview_times])


def interpolation(times: Matrix, grid: Matrix, derivative: int = 0) -> Matrix:
    """(grid, times): the natural cubic spline through values at `times`, or a derivative of it, on a grid.

    The last value is held.
    """
    if len(times) == 1:
        return np.full((len(grid), 1), float(derivative == 0))
    if len(times) == 2:
        share = np.clip(grid / times[1], 0.0, 1.0)
        if derivative == 0:
            return np.stack([1.0 - share, share], axis=1)
        slope = np.where(grid < times[1], 1.0 / times[1], 0.0) if derivative == 1 else np.zeros(len(grid))
        return np.stack([-slope, slope], axis=1)
    from scipy.interpolate import CubicSpline  # takes long to import

    spline = CubicSpline(times, np.eye(len(times)), bc_type="natural")
    matrix: Matrix = spline(np.minimum(grid, times[-1]), derivative)
    if derivative > 0:
        matrix[grid >= times[-1]] = 0.0
    return matrix
