"""RK4: its order, measured against exact solutions, and the limit on its step."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from bicycle_env import analysis, simulate, vehicles
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.integrators import STABILITY_LIMIT, check_timestep, rk4

SPEED = 43.0
START = {"lateral_position": 0.2, "heading": 0.05, "lateral_velocity": 3.0, "yaw_rate": -0.3}
STATES = tuple(START)
TIMESTEPS = np.array([0.02, 0.01, 0.005, 0.0025])


def order(timesteps, error):
    """Slope of log(error) against log(timestep), by least squares."""
    return np.polyfit(np.log(timesteps), np.log(error), 1)[0]


def end_of(steer, timestep, **keywords):
    run = simulate("oversteer", SPEED, steer, 1.0, initial_state=START, timestep=timestep, **keywords)
    return np.array([run[name][-1] for name in STATES])


def linear_system():
    """x' = A x + B steer for y, psi, V, r."""
    a, b = np.zeros((4, 4)), np.zeros((4, 2))
    a[0, 1], a[0, 2], a[1, 3] = SPEED, 1.0, 1.0
    a[2:, 2:] = analysis.state_matrix(vehicles["oversteer"], SPEED)
    b[2:] = analysis.input_matrix(vehicles["oversteer"], SPEED)
    return a, b


def test_global_error_is_fourth_order_against_the_matrix_exponential():
    a, b = linear_system()
    steer = np.array([0.02, -0.01])
    whole = np.zeros((6, 6))
    whole[:4, :4], whole[:4, 4:] = a, b
    truth = (expm(whole) @ [*START.values(), *steer])[:4]
    errors = [np.linalg.norm(end_of(steer, h, tire="linear") - truth) for h in TIMESTEPS]
    assert order(TIMESTEPS, errors) == pytest.approx(4.0, abs=0.05)


def test_fourth_order_with_a_steer_that_changes_in_time():
    """steer = (p sin wt, q cos wt) joins the state as an oscillator, which makes the exact solution an exponential."""
    a, b = linear_system()
    w, p, q = 5.0, 0.03, -0.02
    whole = np.zeros((6, 6))
    whole[:4, :4] = a
    whole[:4, 4:] = b @ np.diag([p, q])
    whole[4, 5], whole[5, 4] = w, -w  # sin' = w cos, cos' = -w sin
    truth = (expm(whole) @ [*START.values(), 0.0, 1.0])[:4]
    errors = [
        np.linalg.norm(end_of(lambda t: (p * np.sin(w * t), q * np.cos(w * t)), h, tire="linear") - truth)
        for h in TIMESTEPS
    ]
    assert order(TIMESTEPS, errors) == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("tire", ["tanh", "magic_formula"])
def test_fourth_order_beyond_the_linear_model(tire):
    """Smooth laws in exact geometry, against the same method with a step 16 times shorter than the shortest."""

    def steer(t):
        return (0.05 * np.sin(4.0 * t), 0.02 * np.cos(3.0 * t))

    timesteps = np.array([0.008, 0.004, 0.002])
    truth = end_of(steer, 0.002 / 16, tire=tire)
    errors = [np.linalg.norm(end_of(steer, h, tire=tire) - truth) for h in timesteps]
    assert order(timesteps, errors) == pytest.approx(4.0, abs=0.2)


def test_one_step_by_hand():
    """x' = -x in every field: one step multiplies by 1 - h + h^2/2 - h^3/6 + h^4/24."""
    advance = rk4(PYTHON, CarState, lambda state, command, car: CarState(*(-value for value in state)))
    after = advance(CarState(*[1.0] * 7), 0.0, 0.0, 0.0, None, 0.5)
    np.testing.assert_allclose(after, 1 - 0.5 + 0.125 - 0.125 / 6 + 0.0625 / 24, rtol=1e-15)


def test_the_input_is_used_at_its_three_times():
    """x' = u(t) is Simpson's rule."""
    advance = rk4(PYTHON, CarState, lambda state, command, car: CarState(*[command] * 7))
    after = advance(CarState(*[0.0] * 7), 1.0, 2.0, 5.0, None, 0.6)
    np.testing.assert_allclose(after, 0.6 * (1.0 + 4.0 * 2.0 + 5.0) / 6.0, rtol=1e-15)


def test_every_field_moves_by_its_own_rate():
    speeds = CarState(*(10.0 * 2.0 ** np.arange(7)))
    after = rk4(PYTHON, CarState, lambda state, command, car: speeds)(CarState(*np.arange(7.0)), *[None] * 4, 0.5)
    assert after == pytest.approx([k + 5.0 * 2.0**k for k in range(7)], rel=1e-15)


@pytest.mark.parametrize(("fastest", "timestep"), list(itertools.product([0.5, 7.0, 300.0], [0.99, 1.0])))
def test_a_step_within_the_limit_is_accepted(fastest, timestep):
    check_timestep("timestep", timestep * STABILITY_LIMIT / fastest * (1 - 1e-15), fastest)


def test_a_step_beyond_the_limit_is_refused_with_the_largest_allowed():
    with pytest.raises(ValueError, match=r"^physics_timestep must be <= 0\.25 s here, got 0\.26: .* 10 1/s"):
        check_timestep("physics_timestep", 0.26, 10.0)


def test_the_limit_is_below_that_of_the_method():
    """|1 + z + z^2/2 + z^3/6 + z^4/24| <= 1 for every z of the left half-plane with |z| <= the limit."""
    angles = np.linspace(np.pi / 2, np.pi, 200)
    z = STABILITY_LIMIT * np.exp(1j * angles)
    growth = np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)
    assert growth.max() < 1.0
