"""Linear designs against the equations that define them, and against other people's implementations."""

import gymnasium as gym
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from bicycle_env import vehicles
from bicycle_env.analysis.linear_model import continuous_model, rk4_map
from bicycle_env.control.design.gains import (
    continuous_gain,
    continuous_preview_gain,
    discrete_gain,
    observer_gain,
    pole_placement_gain,
    preview_cost,
    preview_gain,
    riccati_residual,
    zero_order_hold,
)
from bicycle_env.control.lqr import continuous_design_model, design_model, wanted_states
from bicycle_env.physics.actuators import FRONT, REAR

A, B = continuous_model(vehicles["oversteer"], 43.0, (FRONT, REAR))
Q, R = np.diag([0.25, 10.0, 0.02, 4.0, 0.1, 0.1]), 20.0 * np.eye(2)
X0 = np.array([0.5, 0.1, -1.0, 0.2, 0.01, 0.0])


def by_size(values):
    return np.sort_complex(np.asarray(values))


# Zero-order hold


def test_the_hold_is_the_matrix_exponential():
    """Van Loan: exp of [[A, B], [0, 0]] dt holds both blocks."""
    timestep = 0.02
    block = np.zeros((8, 8))
    block[:6, :6], block[:6, 6:] = A, B
    whole = scipy.linalg.expm(block * timestep)
    held_a, held_b = zero_order_hold(A, B, timestep)
    np.testing.assert_allclose(held_a, whole[:6, :6], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(held_b, whole[:6, 6:], rtol=1e-12, atol=1e-14)


def test_the_hold_is_the_integrated_response():
    held_a, held_b = zero_order_hold(A, B, 0.02)
    u = np.array([0.03, -0.02])
    run = scipy.integrate.solve_ivp(lambda _, x: A @ x + B @ u, (0.0, 0.02), X0, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(held_a @ X0 + held_b @ u, run.y[:, -1], rtol=1e-9, atol=1e-12)


def test_rk4_tends_to_the_hold_with_the_fourth_power_of_the_substep():
    exact, _ = zero_order_hold(A, B, 0.02)
    errors = [np.max(np.abs(rk4_map(A, B, 0.02, substeps)[0] - exact)) for substeps in (2, 4, 8)]
    assert 12.0 < errors[0] / errors[1] < 22.0
    assert 14.0 < errors[1] / errors[2] < 18.0


def test_both_discretisations_of_a_plant():
    plant = gym.make("BicycleStab-v0").unwrapped
    own, held = design_model(plant), design_model(plant, discretisation="zoh")
    assert own.A is not held.A
    np.testing.assert_allclose(own.A, held.A, atol=1e-3)
    assert np.max(np.abs(own.A - held.A)) > 1e-12
    at_own_speed = design_model(plant, plant.speed)
    np.testing.assert_allclose(at_own_speed.A, own.A, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(at_own_speed.B, own.B, rtol=1e-13, atol=1e-15)
    with pytest.raises(ValueError, match="discretisation must be one of 'rk4', 'zoh', got 'tustin'"):
        design_model(plant, discretisation="tustin")


@pytest.mark.parametrize("steer", ["front", "rear", "both"])
def test_the_model_at_another_speed_is_that_of_an_environment_there(steer):
    plant = gym.make("BicycleStab-v0", steer=steer).unwrapped
    other = gym.make("BicycleStab-v0", steer=steer, speed=30.0).unwrapped
    moved, true = design_model(plant, 30.0), other.linear_model()
    np.testing.assert_allclose(moved.A, true.A, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(moved.B, true.B, rtol=1e-13, atol=1e-15)
    continuous = continuous_design_model(plant)
    assert continuous.timestep == 0.0
    assert continuous.B.shape == true.B.shape


# Riccati equations


def test_riccati_residuals():
    _, P = continuous_gain(A, B, Q, R)
    assert riccati_residual(A, B, Q, R, P, discrete=False) < 1e-12
    assert riccati_residual(A, B, Q, R, 1.001 * P, discrete=False) > 1e-4
    held = zero_order_hold(A, B, 0.02)
    _, P = discrete_gain(*held, Q, R)
    assert riccati_residual(*held, Q, R, P, discrete=True) < 1e-10
    assert riccati_residual(*held, Q, R, 1.001 * P, discrete=True) > 1e-6


def test_the_least_cost_of_continuous_time():
    """The cost along the closed loop, integrated, is x'Px."""
    K, P = continuous_gain(A, B, Q, R)
    closed, stage = A - B @ K, Q + K.T @ R @ K

    def rates(_, z):
        return np.append(closed @ z[:6], z[:6] @ stage @ z[:6])

    run = scipy.integrate.solve_ivp(rates, (0.0, 60.0), np.append(X0, 0.0), rtol=1e-10, atol=1e-12)
    assert np.max(np.abs(run.y[:6, -1])) < 1e-6
    assert run.y[6, -1] == pytest.approx(X0 @ P @ X0, rel=1e-7)
    worse = K * np.array([[1.1], [0.9]])
    closed, stage = A - B @ worse, Q + worse.T @ R @ worse
    run = scipy.integrate.solve_ivp(rates, (0.0, 60.0), np.append(X0, 0.0), rtol=1e-10, atol=1e-12)
    assert run.y[6, -1] > X0 @ P @ X0


# Preview


def test_the_preview_cost_is_the_cost_of_a_simulation():
    """x'Px + 2x'Sw, up to the part without x: differences between two starts with the same path."""
    model = gym.make("BicycleStab-v0").unwrapped.linear_model()
    weights, effort, horizon = np.diag([0.25, 10.0, 0.0, 4.0, 0.0, 0.0]), 0.1 * np.eye(2), 12
    M = wanted_states(43.0 * model.timestep, model.timestep, horizon)
    P, S = preview_cost(model.A, model.B, weights, effort, M, horizon)
    K, G = preview_gain(model.A, model.B, weights, effort, M, horizon)
    path = 0.1 * np.sin(np.arange(horizon + 1.0))

    def cost(x):
        w, total = path.copy(), 0.0
        for _ in range(3000):
            u = -K @ x - G @ w
            error = x - M @ w
            total += error @ weights @ error + u @ effort @ u
            x, w = model.A @ x + model.B @ u, np.append(w[1:], w[-1])
        return total

    starts = X0, np.zeros(6)
    expected = X0 @ P @ X0 + 2.0 * X0 @ S @ path
    # The lane stays aside of the straight road, so both costs converge.
    assert cost(starts[0]) - cost(starts[1]) == pytest.approx(expected, rel=1e-8)


def test_continuous_preview_is_the_limit_of_discrete_preview():
    """Tomizuka's gain with ever shorter steps, for a path that is a straight line between values 0.1 s apart."""
    speed, points = 43.0, 7
    times = 0.1 * np.arange(points)
    weights = np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    def path(grid):
        return np.array([np.interp(grid, times, row) for row in np.eye(points)]).T

    step = 0.1 / 64
    grid = np.arange(64 * (points - 1) + 1) * step
    reference = np.zeros((len(grid), 6, points))
    reference[:, 0] = path(grid)
    K, G = continuous_preview_gain(A, B, weights, R, reference, step)
    np.testing.assert_allclose(K, continuous_gain(A, B, weights, R)[0])
    np.testing.assert_allclose(K[:, 0] + G.sum(axis=1), 0.0, atol=1e-7)
    errors = []
    for timestep in (0.02, 0.01, 0.005):
        horizon = round(times[-1] / timestep)
        wanted = wanted_states(speed * timestep, timestep, horizon)
        wanted[1:] = 0.0
        held = zero_order_hold(A, B, timestep)
        _, per_step = preview_gain(*held, weights * timestep, R * timestep, wanted, horizon)
        errors.append(np.max(np.abs(per_step @ path(np.arange(horizon + 1) * timestep) - G)) / np.max(np.abs(G)))
    assert errors[2] < 0.03
    assert 1.6 < errors[0] / errors[1] < 2.4
    assert 1.8 < errors[1] / errors[2] < 2.2


# Poles and observers

POLES = np.array([-1.0 + 1.0j, -1.0 - 1.0j, -3.0, -8.0, -18.0, -22.0])


def test_pole_placement_hits_the_poles():
    K = pole_placement_gain(A, B, POLES)
    np.testing.assert_allclose(by_size(np.linalg.eigvals(A - B @ K)), by_size(POLES), rtol=1e-6)
    assert K.shape == (2, 6)
    assert K.dtype == np.float64
    five = [0, 1, 2, 3, 4]
    K = pole_placement_gain(A[np.ix_(five, five)], B[five, :1], POLES[:5])
    closed = A[np.ix_(five, five)] - B[five, :1] @ K
    np.testing.assert_allclose(by_size(np.linalg.eigvals(closed)), by_size(POLES[:5]), rtol=1e-6)


def test_ackermann_agrees():
    """One input: the gain is unique. Ackermann's formula, by hand: the last row of C^-1 times the wanted polynomial."""
    five = [0, 1, 2, 3, 4]
    a, b = A[np.ix_(five, five)], B[five, :1]
    controllability = np.hstack([np.linalg.matrix_power(a, k) @ b for k in range(5)])
    wanted = np.real(np.poly(POLES[:5]))
    polynomial = sum(c * np.linalg.matrix_power(a, 5 - k) for k, c in enumerate(wanted))
    K = np.linalg.solve(controllability.T, np.eye(5)[-1]) @ polynomial
    np.testing.assert_allclose(pole_placement_gain(a, b, POLES[:5])[0], K, rtol=1e-6)


def test_an_observer_is_the_regulator_of_the_dual_system():
    C = np.zeros((2, 6))
    C[0, 0] = C[1, 3] = 1.0
    two = [0, 1, 2, 3]
    a, c = A[np.ix_(two, two)], C[:, two]
    poles = [-4.0, -5.0, -6.0 + 2.0j, -6.0 - 2.0j]
    L = observer_gain(a, c, poles)
    np.testing.assert_allclose(by_size(np.linalg.eigvals(a - L @ c)), by_size(poles), rtol=1e-8)
    np.testing.assert_array_equal(L, pole_placement_gain(a.T, c.T, poles).T)


def test_bad_poles_are_refused():
    with pytest.raises(ValueError, match=r"[Cc]omplex|conjugate"):
        pole_placement_gain(A, B, POLES * (1 + 0.1j))
