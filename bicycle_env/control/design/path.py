"""The path as a driver sees it: where it will be and how it will run, some time ahead of the car."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control.design.observation_map import Reading
from bicycle_env.control.policy import Plant
from bicycle_env.tasks.path import follows_path

Matrix = NDArray[np.float64]


def path_ahead(plant: Plant, times: NDArray[np.floating[Any]], derivative: int = 0) -> Matrix:
    """The linear map from an observation to the path's lateral distance from the car, at some times ahead.

    Between its place beside the car and the preview points the path is a cubic spline that sets out in the path's own
    direction, so that it has a curvature there too; beyond the last point it runs straight on. In a task without a
    path it is the middle of the lane.

    Args:
        plant: the environment that gives the observations.
        times: how far ahead, s, >= 0 and rising.
        derivative: 0 for the distance [m], 1 or 2 for its derivatives with respect to time, m/s and m/s^2.

    Returns:
        (entries, len(times)): ``observation @ matrix`` are the values.
    """
    reading = Reading(plant)
    knots, distances = reading.times, reading.path.T
    drift = np.zeros(len(plant.observation_names))  # U psi_path, the path's heading being psi minus the heading error
    if "heading_error" in plant.observation_names or follows_path(plant.task):
        drift += reading.state[:, STATE_NAMES.index("heading")]
        drift[reading.index("heading_error")] -= 1.0
        drift *= plant.speed

    near, slope = np.empty((0, len(drift))), drift
    far = times
    if len(knots) > 1:
        from scipy.interpolate import CubicSpline  # takes long to import

        spline = CubicSpline(knots, distances, bc_type=((1, drift), "not-a-knot"))
        near, slope, far = spline(times[times <= knots[-1]], derivative), spline(knots[-1], 1), times[times > knots[-1]]
    straight: list[Any] = [distances[-1] + np.outer(far - knots[-1], slope), slope, 0.0]
    beyond = np.broadcast_to(straight[derivative], (len(far), len(drift)))
    matrix: Matrix = np.concatenate([near, beyond]).T * reading.scale[:, None]
    return matrix
