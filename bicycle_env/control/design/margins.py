"""How far a linear design is from instability: gain, phase and disk margins of the loop broken at the plant's input.

They come from the closed loop's eigenvalues with a factor in the loop, which is exact to the bisection. (Margins from
crossings of the transfer function, as python-control 0.10 finds them, are not: for the eight states of an LQG its
polynomials are too badly conditioned, and crossings appear and disappear.)
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.linear_model import LinearModel
from bicycle_env.control.design.estimation import KalmanFilter

Matrix = NDArray[np.float64]

LARGEST_FACTOR = 1e6


class Loop(NamedTuple):
    """A loop transfer function L = C (sI - A)^-1 B, or with z; the closed loop is that of A - B C."""

    A: Matrix
    B: Matrix
    C: Matrix
    timestep: float
    """s; 0 in continuous time."""
    input_names: tuple[str, ...]

    def frequency_response(self, frequency: Matrix) -> NDArray[np.complex128]:
        """L (frequencies, inputs, inputs) at frequencies in rad/s, below pi / timestep in discrete time."""
        s = 1j * frequency
        at = np.exp(s * self.timestep) if self.timestep else s
        matrices = at[:, None, None] * np.eye(len(self.A)) - self.A
        response: NDArray[np.complex128] = self.C @ np.linalg.solve(matrices, self.B.astype(complex))
        return response


class Margins(NamedTuple):
    """What one input's loop bears, the other inputs' loops being closed as designed."""

    gain_decrease: float
    """The loop is stable for factors on its gain down to this one, < 1; 0 if down to none at all."""
    gain_increase: float
    """... and up to this one, > 1; infinite if there is no limit."""
    phase: float
    """Additional phase, either way, that the loop bears, rad."""
    disk: float
    """Disk margin d, balanced: any gain in (2-d)/(2+d) ... (2+d)/(2-d) and phase up to 2 atan(d/2), also together
    (P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020)."""


def state_feedback_loop(model: LinearModel, gain: Matrix) -> Loop:
    """From the plant's input to what u = -K x would answer, turned round: K (sI - A)^-1 B, or with z.

    Args:
        model: discrete, or continuous with timestep 0.
        gain: K (axles, states).
    """
    return Loop(model.A, model.B, gain, model.timestep, model.input_names)


def lqg_loop(model: LinearModel, gain: Matrix, sideslip_filter: KalmanFilter) -> Loop:
    """The same loop with the gain on the estimate of :class:`~bicycle_env.control.lqg.LQG`.

    Its states are those of the car (6) and the filter's prediction of lateral velocity and yaw rate (2).
    """
    known = sideslip_filter
    body, steer = np.eye(6)[2:4], np.eye(6)[4:6]
    # The innovation and the estimate, as maps from (x, prediction). What D makes of the known steer angles cancels.
    innovation = np.hstack([known.C @ body, -known.C])
    estimate = np.hstack([np.zeros((2, 6)), np.eye(2)]) + known.gain @ innovation
    measured = np.hstack([np.diag([1.0, 1.0, 0.0, 0.0, 1.0, 1.0]), np.zeros((6, 2))])
    answer = gain @ (measured + body.T @ estimate)  # -u
    prediction = (
        known.A @ estimate
        + known.B[:, :2] @ np.hstack([steer, np.zeros((2, 2))])
        - known.B[:, 2:] @ answer
        + (known.predictor_gain - known.A @ known.gain) @ innovation
    )
    A = np.vstack([np.hstack([model.A, np.zeros((6, 2))]), prediction])
    B = np.vstack([model.B, np.zeros((2, len(gain)))])
    return Loop(A, B, answer, model.timestep, model.input_names)


def margins(loop: Loop) -> dict[str, Margins]:
    """The margins at each input, by its name; ValueError if the closed loop is not stable."""
    if not _is_stable(loop, np.ones(len(loop.C))):
        raise ValueError("loop must be stable when it is closed")
    found = {}
    for i, name in enumerate(loop.input_names):

        def stable(factor: complex, i: int = i) -> bool:
            factors = np.ones(len(loop.C), complex)
            factors[i] = factor
            return _is_stable(loop, factors)

        least = _last(lambda x: stable(math.exp(-x)), math.log(LARGEST_FACTOR))
        most = _last(lambda x: stable(math.exp(x)), math.log(LARGEST_FACTOR))
        found[name] = Margins(
            gain_decrease=0.0 if math.isinf(least) and stable(0.0) else math.exp(-least),
            gain_increase=math.exp(most),
            phase=_last(lambda x: stable(cmath.exp(1j * x)), math.pi),
            disk=_disk(loop, i),
        )
    return found


def _is_stable(loop: Loop, factors: NDArray[np.inexact[Any]]) -> bool:
    poles = np.linalg.eigvals(loop.A - (loop.B * factors) @ loop.C)
    return bool(np.all(np.abs(poles) < 1.0) if loop.timestep else np.all(poles.real < 0.0))


def _last(stable: Callable[[float], bool], limit: float) -> float:
    """The end of the interval from 0 on in which the loop is stable; infinite if that is beyond the limit."""
    grid = np.linspace(0.0, limit, 1001)
    first = next((k for k, x in enumerate(grid) if not stable(float(x))), None)
    if first is None:
        return math.inf
    low, high = float(grid[first - 1]), float(grid[first])
    while high - low > 1e-9 * limit:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def _disk(loop: Loop, i: int) -> float:
    """1 / max |(S - T)/2| over frequency, S = 1/(1 + L) and T = 1 - S of one input's loop."""
    others = [j for j in range(len(loop.C)) if j != i]
    A = loop.A - loop.B[:, others] @ loop.C[others]
    single = loop._replace(A=A, B=loop.B[:, [i]], C=loop.C[[i]])
    fastest = math.pi / loop.timestep if loop.timestep else 1e3 * float(np.max(np.abs(np.linalg.eigvals(loop.A))))
    response = single.frequency_response(np.geomspace(1e-6 * fastest, 0.999 * fastest, 4000))[:, 0, 0]
    return float(1.0 / np.max(np.abs(1.0 / (1.0 + response) - 0.5)))
