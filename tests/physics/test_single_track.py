"""The equations of motion against closed forms: matrix exponential, Jacobian, mirror symmetry, figures by hand."""

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import expm

from bicycle_env import analysis, simulate, tires, vehicles
from bicycle_env.analysis.linear_model import continuous_model
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.lateral import GEOMETRIES, path_rates
from bicycle_env.physics.single_track import SingleTrack

COMBINATIONS = list(itertools.product(tires.LAWS, GEOMETRIES))
AT_REST = CarState(*[0.0] * 7)
# x keeps its sign in a mirror, all else changes it
MIRROR = CarState(1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0)


def car_of(name="oversteer", speed=43.0, friction=1.0):
    return car_on_road(vehicles[name], speed, friction, FRONT, REAR)


def random_states(count, seed=0):
    """Cars all over the place: spinning, sliding, at large steer angles."""
    rng = np.random.default_rng(seed)
    widths = CarState(50.0, 3.0, 3.0, 20.0, 3.0, 0.3, 0.2)
    return CarState(*(rng.uniform(-width, width, count) for width in widths))


def mirrored(state):
    return CarState(*(sign * value for sign, value in zip(MIRROR, state, strict=True)))


# Linear response


@pytest.mark.parametrize("name", ["oversteer", "understeer", "neutral"])
@pytest.mark.parametrize("speed", [8.0, 25.0, 43.0])
def test_linear_response_is_the_matrix_exponential(name, speed):
    """Lateral position and heading included: y' = V + U psi, psi' = r."""
    vehicle, steer = vehicles[name], np.array([0.01, -0.004])
    start = {"lateral_position": 0.3, "heading": -0.02, "lateral_velocity": 0.5, "yaw_rate": -0.1}
    a = np.zeros((6, 6))
    a[0, 1], a[0, 2], a[1, 3] = speed, 1.0, 1.0
    a[2:4, 2:4] = analysis.state_matrix(vehicle, speed)
    a[2:4, 4:6] = analysis.input_matrix(vehicle, speed)
    run = simulate(vehicle, speed, steer, 1.5, tire="linear", initial_state=start, timestep=5e-4)
    for k in (1, 700, 3000):
        expected = expm(a * run["time"][k]) @ [*start.values(), *steer]
        got = [run[name][k] for name in (*start, "front_steer", "rear_steer")]
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
        assert run["longitudinal_position"][k] == pytest.approx(speed * run["time"][k], rel=1e-12)


# Linearisation


@pytest.mark.parametrize(("tire", "geometry"), COMBINATIONS)
@pytest.mark.parametrize("name", ["oversteer", "understeer"])
def test_jacobian_at_straight_running_is_the_linear_model(tire, geometry, name):
    vehicle, speed = vehicles[name], 30.0
    rates = SingleTrack.of(tire, geometry).rates(PYTHON)
    car = car_of(name, speed)
    step = 1e-7

    def change(at):
        state = AT_REST._replace(lateral_velocity=speed * at[0], yaw_rate=at[1])
        rate = rates(state, (at[2], at[3]), car)
        return np.array([rate.lateral_velocity, rate.yaw_rate])

    jacobian = np.column_stack([(change(e) - change(-e)) / (2.0 * step) for e in step * np.eye(4)])
    expected = np.hstack([analysis.state_matrix(vehicle, speed), analysis.input_matrix(vehicle, speed)])
    expected[:, 0] *= speed
    # the brush law has a kink in its curvature at zero slip: an error of the order of the step
    np.testing.assert_allclose(jacobian, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("tire", "geometry"), COMBINATIONS)
def test_jacobian_with_path_and_actuators_is_the_continuous_model(tire, geometry):
    vehicle, speed = vehicles["oversteer"], 30.0
    rates = SingleTrack.of(tire, geometry).actuated_rates(PYTHON)
    car = car_of("oversteer", speed)
    step = 1e-7

    def change(at):
        return np.array(rates(CarState(0.0, *at[:6]), (at[6], at[7]), car), dtype=float)

    jacobian = np.column_stack([(change(e) - change(-e)) / (2.0 * step) for e in step * np.eye(8)])
    a, b = continuous_model(vehicle, speed, (FRONT, REAR))
    np.testing.assert_allclose(jacobian[1:], np.hstack([a, b]), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(jacobian[0], 0.0, atol=1e-6)  # x' = U to first order
    assert change(np.zeros(8))[0] == speed


# Symmetry


@pytest.mark.parametrize(("tire", "geometry"), COMBINATIONS)
def test_mirror_symmetry_of_the_rates_to_the_bit(tire, geometry):
    rates = SingleTrack.of(tire, geometry).rates(NUMPY)
    state, car = random_states(3000), CarParameters(*map(np.float64, car_of()))
    steer = (state.front_steer, state.rear_steer)
    here = rates(state, steer, car)
    there = rates(mirrored(state), (-steer[0], -steer[1]), car)
    for name, a, b in zip(CarState._fields, mirrored(here), there, strict=True):
        assert np.array_equal(a, b), name
    assert np.all(np.abs(here.yaw_rate) > 0.0)


@pytest.mark.parametrize(("tire", "geometry"), COMBINATIONS)
def test_mirror_symmetry_of_a_compiled_run_to_the_bit(tire, geometry):
    start = {"lateral_position": 0.2, "heading": -0.1, "lateral_velocity": 2.0, "yaw_rate": -0.4}

    def run(side):
        return simulate(
            "oversteer",
            40.0,
            lambda t: (side * 0.05 * math.sin(3.0 * t), side * -0.02 * math.cos(2.0 * t)),
            2.0,
            tire=tire,
            geometry=geometry,
            initial_state={name: side * value for name, value in start.items()},
            timestep=2e-3,
        )

    right, left = run(1.0), run(-1.0)
    for name in right:
        sign = 1.0 if name in ("time", "longitudinal_position") else -1.0
        assert np.array_equal(sign * left[name], right[name]), name


# Figures by hand


def test_slip_angles_and_forces_by_hand_small_angle():
    vehicle = vehicles["oversteer"]  # a = 1.4, b = 1.3, Cf = 110e3, Cr = 90e3, m = 1500, Iz = 2500
    state = AT_REST._replace(lateral_velocity=2.0, yaw_rate=0.5, front_steer=0.04, rear_steer=-0.02)
    acting = SingleTrack(tires.Linear(), "small_angle").axles(PYTHON)(state, car_of("oversteer", 25.0))
    assert acting.front_slip_angle == pytest.approx((2.0 + 1.4 * 0.5) / 25.0 - 0.04, rel=1e-14)  # 0.068
    assert acting.rear_slip_angle == pytest.approx((2.0 - 1.3 * 0.5) / 25.0 + 0.02, rel=1e-14)  # 0.074
    assert acting.front_lateral_force == pytest.approx(-7480.0, rel=1e-13)
    assert acting.rear_lateral_force == pytest.approx(-6660.0, rel=1e-13)
    assert acting.lateral_acceleration == pytest.approx(-14140.0 / 1500.0, rel=1e-13)
    assert acting.yaw_acceleration == pytest.approx((1.4 * -7480.0 + 1.3 * 6660.0) / 2500.0, rel=1e-12)
    rates = SingleTrack(tires.Linear(), "small_angle").rates(PYTHON)(state, (0.04, -0.02), car_of("oversteer", 25.0))
    assert rates.lateral_velocity == pytest.approx(-14140.0 / 1500.0 - 0.5 * 25.0, rel=1e-13)
    assert rates.yaw_rate == acting.yaw_acceleration
    assert rates.heading == 0.5
    assert vehicle.wheelbase == pytest.approx(2.7)


def test_slip_angles_and_forces_by_hand_exact():
    state = AT_REST._replace(lateral_velocity=6.0, yaw_rate=1.0, front_steer=0.3, rear_steer=-0.2)
    car = car_of("oversteer", 20.0, friction=0.5)
    acting = SingleTrack(tires.Tanh(), "exact").axles(PYTHON)(state, car)
    front = math.atan(7.4 / 20.0) - 0.3
    rear = math.atan(4.7 / 20.0) + 0.2
    assert acting.front_slip_angle == pytest.approx(front, rel=1e-13)
    assert acting.rear_slip_angle == pytest.approx(rear, rel=1e-13)
    front_peak, rear_peak = 0.5 * 1500 * 9.81 * 1.3 / 2.7, 0.5 * 1500 * 9.81 * 1.4 / 2.7
    front_force = -front_peak * math.tanh(110e3 * front / front_peak)
    rear_force = -rear_peak * math.tanh(90e3 * rear / rear_peak)
    assert acting.front_lateral_force == pytest.approx(front_force, rel=1e-12)
    assert acting.rear_lateral_force == pytest.approx(rear_force, rel=1e-12)
    sideways = front_force * math.cos(0.3), rear_force * math.cos(0.2)
    assert acting.lateral_acceleration == pytest.approx(sum(sideways) / 1500.0, rel=1e-12)
    assert acting.yaw_acceleration == pytest.approx((1.4 * sideways[0] - 1.3 * sideways[1]) / 2500.0, rel=1e-11)


def test_the_path_by_hand():
    state = AT_REST._replace(heading=0.4, lateral_velocity=3.0)
    car = car_of("oversteer", 20.0)
    assert path_rates(PYTHON, "small_angle")(state, car) == (20.0, 3.0 + 20.0 * 0.4)
    forward, sideways = path_rates(PYTHON, "exact")(state, car)
    assert forward == pytest.approx(20.0 * math.cos(0.4) - 3.0 * math.sin(0.4), rel=1e-14)
    assert sideways == pytest.approx(20.0 * math.sin(0.4) + 3.0 * math.cos(0.4), rel=1e-14)


def test_the_exact_path_keeps_the_speed():
    """x'^2 + y'^2 = U^2 + V^2: the path is the body's velocity, turned by the heading."""
    state, car = random_states(500, 4), CarParameters(*map(np.float64, car_of()))
    rate = SingleTrack(tires.Fiala(), "exact").rates(NUMPY)(state, (state.front_steer, state.rear_steer), car)
    np.testing.assert_allclose(
        np.hypot(rate.longitudinal_position, rate.lateral_position), np.hypot(43.0, state.lateral_velocity), rtol=1e-13
    )


def test_the_steer_in_the_state_does_not_matter_when_it_is_prescribed():
    rates = SingleTrack(tires.Fiala(), "exact").rates(PYTHON)
    a = rates(AT_REST._replace(yaw_rate=0.3, front_steer=0.2, rear_steer=0.1), (0.01, 0.02), car_of())
    b = rates(AT_REST._replace(yaw_rate=0.3), (0.01, 0.02), car_of())
    assert a == b
    assert a.front_steer == a.rear_steer == 0.0


def test_peak_forces_are_friction_times_the_static_load():
    car = car_of("oversteer", 20.0, friction=0.6)
    assert car.front_peak_force == pytest.approx(0.6 * 1500 * 9.81 * 1.3 / 2.7, rel=1e-14)
    assert car.rear_peak_force == pytest.approx(0.6 * 1500 * 9.81 * 1.4 / 2.7, rel=1e-14)


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
def test_no_lateral_acceleration_beyond_the_friction(tire):
    acting = SingleTrack.of(tire, "exact").axles(NUMPY)(
        random_states(3000, 2), CarParameters(*map(np.float64, car_of("oversteer", 40.0, friction=0.7)))
    )
    assert np.all(np.abs(acting.lateral_acceleration) <= 0.7 * 9.81 * (1.0 + 1e-12))


def test_a_row_does_not_depend_on_its_neighbours():
    """Several cars at once give, to the bit, what each gives alone."""
    advance = rk4(NUMPY, CarState, SingleTrack(tires.Fiala(), "exact").actuated_rates(NUMPY))
    car, command = CarParameters(*map(np.float64, car_of())), (np.float64(0.02), np.float64(-0.01))
    states = random_states(50, 9)
    together = advance(states, command, command, command, car, 0.004)
    for k in range(50):
        alone = advance(CarState(*(v[k : k + 1] for v in states)), command, command, command, car, 0.004)
        assert [v[k] for v in together] == [v[0] for v in alone]
