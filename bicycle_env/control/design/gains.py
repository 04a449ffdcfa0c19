"""Linear designs, matrices in and gains out: regulators, preview, poles, observers. scipy solves the Riccati equations.

A, B, C are the matrices of x' = A x + B u (continuous) or x+ = A x + B u (discrete), y = C x; Q and R weigh x and u.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def zero_order_hold(A: Matrix, B: Matrix, timestep: float) -> tuple[Matrix, Matrix]:
    """(A, B) of the exact discrete map of x' = A x + B u with u held for a timestep [s]: the matrix exponential."""
    from scipy.signal import cont2discrete  # takes as long to import as the rest of the controllers

    discrete = cont2discrete((A, B, np.eye(len(A)), np.zeros_like(B)), timestep, method="zoh")
    return discrete[0], discrete[1]


# Regulators


def continuous_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> tuple[Matrix, Matrix]:
    """K of u = -K x that minimises the integral of x'Qx + u'Ru along x' = A x + B u, and P: the least cost is x'Px."""
    P = scipy.linalg.solve_continuous_are(A, B, Q, R)
    return np.linalg.solve(np.atleast_2d(R), B.T @ P), P


def discrete_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> tuple[Matrix, Matrix]:
    """K of u = -K x that minimises the sum of x'Qx + u'Ru along x+ = A x + B u, and P: the least cost is x'Px."""
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    K: Any = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    return K, P


def riccati_residual(A: Matrix, B: Matrix, Q: Matrix, R: Matrix, P: Matrix, *, discrete: bool) -> float:
    """Largest entry of what the Riccati equation leaves over with P, as a share of the largest entry of P."""
    if discrete:
        BPA = B.T @ P @ A
        left = A.T @ P @ A - P - BPA.T @ np.linalg.solve(R + B.T @ P @ B, BPA) + Q
    else:
        left = A.T @ P + P @ A - P @ B @ np.linalg.solve(R, B.T @ P) + Q
    return float(np.max(np.abs(left)) / np.max(np.abs(P)))


# Preview: the cost is that of x - M w, where w holds what is known of a reference signal now and ahead


def preview_cost(A: Matrix, B: Matrix, Q: Matrix, R: Matrix, reference: Matrix, horizon: int) -> tuple[Matrix, Matrix]:
    """P and S of the least cost x'Px + 2 x'Sw (+ a part without x) of :func:`preview_gain`'s problem."""
    K, P = discrete_gain(A, B, Q, R)
    shift = np.eye(horizon + 1, k=1)
    shift[-1, -1] = 1.0
    closed = (A - B @ K).T
    # S = (A - BK)' S D - Q M, D the shift: a series, summed by doubling (R. A. Smith, SIAM J. Appl. Math. 16, 1968).
    S = -Q @ reference
    for _ in range(64):
        more = closed @ S @ shift
        S = S + more
        if np.max(np.abs(more)) <= 1e-15 * np.max(np.abs(S)):
            break
        closed, shift = closed @ closed, shift @ shift
    return P, S


def preview_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix, reference: Matrix, horizon: int) -> tuple[Matrix, Matrix]:
    """Gains of u = -K x - G w for the cost (x - M w)'Q(x - M w) + u'Ru with a previewed signal w.

    Discrete-time optimal preview control (M. Tomizuka, J. Dyn. Syst. Meas. Control 97, 1975; for cars R. S. Sharp and
    V. Valtetsiotis, Vehicle System Dynamics Suppl. 35, 2001). w holds the signal now and in the next `horizon` steps;
    it moves up one place a step and its last value is held.

    Args:
        reference: M, (states, horizon + 1), the wanted state as a linear function of w.
        horizon: how many future values are known.

    Returns:
        K (inputs, states) and G (inputs, horizon + 1).
    """
    P, S = preview_cost(A, B, Q, R, reference, horizon)
    shift = np.eye(horizon + 1, k=1)
    shift[-1, -1] = 1.0
    curvature = R + B.T @ P @ B
    K: Any = np.linalg.solve(curvature, B.T @ P @ A)
    G: Any = np.linalg.solve(curvature, B.T @ S @ shift)
    return K, G


def continuous_preview_gain(
    A: Matrix, B: Matrix, Q: Matrix, R: Matrix, reference: Matrix, step: float
) -> tuple[Matrix, Matrix]:
    """:func:`preview_gain` in continuous time: G = -R^-1 B' times the integral of e^((A - BK)'t) Q M(t).

    Args:
        reference: M(t), (n, states, points), at t = 0, step, ..., (n - 1) step; the last one is held for ever.
        step: s. The integral is Simpson's.

    Returns:
        K (inputs, states) and G (inputs, points).
    """
    from scipy.integrate import simpson

    K, _ = continuous_gain(A, B, Q, R)
    closed = (A - B @ K).T
    weighed = Q @ reference
    moved, ahead = np.empty_like(weighed), np.eye(len(A))
    one_step = scipy.linalg.expm(closed * step)
    for k in range(len(weighed)):
        moved[k] = ahead @ weighed[k]
        last, ahead = ahead, one_step @ ahead
    whole = -np.linalg.solve(closed, last @ weighed[-1])  # from the last time to infinity
    if len(moved) > 1:
        whole = whole + simpson(moved, dx=step, axis=0)
    G: Any = -np.linalg.solve(R, B.T @ whole)
    return K, G


# Poles and observers


def pole_placement_gain(A: Matrix, B: Matrix, poles: Any) -> Matrix:
    """K (inputs, states) of u = -K x with which A - B K has these eigenvalues (scipy: Tits and Yang's method).

    Raises:
        ValueError: a complex pole without its conjugate, a pole more often than B has inputs, or too few of them.
    """
    from scipy.signal import place_poles

    found = place_poles(A, B, np.asarray(poles))
    K: Matrix = np.real(found.gain_matrix)
    return K


def reference_gain(A: Matrix, B: Matrix, C: Matrix, K: Matrix) -> Matrix:
    """k of u = -K x + k w with which y = C x comes to rest at w: -(C (A - BK)^-1 B)^-1, continuous, as many y as u."""
    k: Matrix = -np.linalg.inv(C @ np.linalg.solve(A - B @ K, B))
    return k


def observer_gain(A: Matrix, C: Matrix, poles: Any) -> Matrix:
    """L (states, outputs) with which A - L C has these eigenvalues: pole placement of the dual system (A', C')."""
    L: Matrix = pole_placement_gain(A.T, C.T, poles).T
    return L
