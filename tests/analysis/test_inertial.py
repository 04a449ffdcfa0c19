"""The fourth-order formulation, and the four-wheel slip angles whose half-tracks drop out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from bicycle_env import analysis, simulate, vehicles


@pytest.mark.parametrize("name", list(vehicles))
@pytest.mark.parametrize("speed", [8.0, 30.0, 60.0])
def test_same_spectrum_and_two_zeros(name, speed):
    vehicle = vehicles[name]
    four = np.linalg.eigvals(analysis.inertial_state_matrix(vehicle, speed))
    by_size = four[np.argsort(np.abs(four))]
    scale = np.max(np.abs(four))
    np.testing.assert_allclose(by_size[:2], 0.0, atol=1e-6 * scale)
    body = analysis.eigenvalues(vehicle, speed)
    for value in body:
        assert np.min(np.abs(by_size[2:] - value)) < 1e-6 * scale


def test_fourth_order_polynomial_is_the_determinant():
    vehicle, speed = vehicles["oversteer"], 43.0
    matrices = analysis.inertial_matrices(vehicle, speed)
    polynomial = analysis.characteristic_polynomial(vehicle, speed, coordinates="inertial")
    for s in (0.3 + 0.7j, -2.0 + 0.1j, 5.0):
        determinant = np.linalg.det(matrices.mass * s**2 + matrices.damping * s + matrices.stiffness)
        assert np.polyval(polynomial, s) == pytest.approx(determinant, rel=1e-10)


def test_inertial_and_body_fixed_motion_agree():
    """y'' = V' + U r and the forces of (6.7) from the same state."""
    vehicle, speed = vehicles["oversteer"], 43.0
    lateral_velocity, yaw_rate, heading = 0.4, -0.1, 0.02
    rate = analysis.inertial_state_matrix(vehicle, speed) @ [
        0.3,
        heading,
        lateral_velocity + speed * heading,
        yaw_rate,
    ]
    body = analysis.state_matrix(vehicle, speed) @ [lateral_velocity, yaw_rate]
    assert rate[2] == pytest.approx(body[0] + speed * yaw_rate, rel=1e-12)
    assert rate[3] == pytest.approx(body[1], rel=1e-12)


def test_both_formulations_drive_the_same_path():
    """The simulated body-fixed car, seen from the road, is the matrix exponential of the inertial form."""
    vehicle, speed = vehicles["understeer"], 30.0
    start = {"lateral_position": 0.3, "heading": -0.02, "lateral_velocity": 0.5, "yaw_rate": -0.1}
    run = simulate(vehicle, speed, (0.0, 0.0), 2.0, tire="linear", initial_state=start)
    inertial = [0.3, -0.02, 0.5 + speed * -0.02, -0.1]
    for k in (1, 500, 2000):
        expected = expm(analysis.inertial_state_matrix(vehicle, speed) * run["time"][k]) @ inertial
        lateral_rate = run["lateral_velocity"][k] + speed * run["heading"][k]
        got = [run["lateral_position"][k], run["heading"][k], lateral_rate, run["yaw_rate"][k]]
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-10)


# The four wheels

UNEQUAL = dataclasses.replace(vehicles["oversteer"], front_half_track=0.9, rear_half_track=0.6)
WHEELS = {
    "front_left": (UNEQUAL.cg_to_front, UNEQUAL.front_half_track),
    "front_right": (UNEQUAL.cg_to_front, -UNEQUAL.front_half_track),
    "rear_left": (-UNEQUAL.cg_to_rear, UNEQUAL.rear_half_track),
    "rear_right": (-UNEQUAL.cg_to_rear, -UNEQUAL.rear_half_track),
}


@pytest.mark.parametrize("wheel", WHEELS)
def test_slip_angle_is_the_direction_in_which_the_wheel_travels(wheel):
    """Rolling and lateral velocity, (6.1) and (6.2): each wheel's place on the road is followed for a moment."""
    speed, lateral_rate, heading, yaw_rate, moment = 20.0, 3.0, -0.4, 0.8, 1e-5

    def place(time):
        angle = heading + yaw_rate * time
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.array([speed, lateral_rate]) * time + turn @ WHEELS[wheel]

    x, y = (place(moment) - place(-moment)) / (2.0 * moment)
    slips = analysis.wheel_slip_angles(UNEQUAL, speed, lateral_rate, heading, yaw_rate)
    assert getattr(slips, wheel) == pytest.approx(np.arctan2(y, x) - heading, rel=1e-9)


@pytest.mark.parametrize(("axle", "arm"), [("front", UNEQUAL.cg_to_front), ("rear", -UNEQUAL.cg_to_rear)])
def test_track_drops_out_to_first_order(axle, arm):
    """What the book's (6.3), (6.5) miss: the slip angle x half-track x yaw rate / speed; of that, a third order."""
    speed, half_track = 30.0, getattr(UNEQUAL, f"{axle}_half_track")

    def remainders(size):
        lateral_rate, heading, yaw_rate = 1.0 * size, 0.05 * size, 0.4 * size
        slips = analysis.wheel_slip_angles(UNEQUAL, speed, lateral_rate, heading, yaw_rate)
        left, right = getattr(slips, f"{axle}_left"), getattr(slips, f"{axle}_right")
        book = (lateral_rate + arm * yaw_rate) / speed - heading
        second = half_track * yaw_rate / speed * book
        return np.array([left - book, right - book]), np.array([left - book - second, right - book + second])

    whole, beyond = remainders(0.01)
    half, half_beyond = remainders(0.005)
    np.testing.assert_allclose(whole / half, 4.0, rtol=0.02)
    np.testing.assert_allclose(beyond / half_beyond, 8.0, rtol=0.02)
    # The axle's force is that of the mean: no second order is left there.
    assert np.sum(whole) / np.sum(half) == pytest.approx(8.0, rel=0.02)


def test_four_wheels_with_half_an_axles_stiffness_give_equation_6_9():
    """The linear force law at every wheel, Newton and Euler, (6.6)-(6.8), differentiated at straight running."""
    speed, step = 30.0, 1e-4
    front, rear = UNEQUAL.front_cornering_stiffness / 2.0, UNEQUAL.rear_cornering_stiffness / 2.0

    def loads(lateral_rate, heading, yaw_rate):
        slips = analysis.wheel_slip_angles(UNEQUAL, speed, lateral_rate, heading, yaw_rate)
        forces = [
            -front * slips.front_left,
            -front * slips.front_right,
            -rear * slips.rear_left,
            -rear * slips.rear_right,
        ]
        arms = [x for x, _ in WHEELS.values()]
        return np.array([np.sum(forces) * np.cos(heading), np.dot(arms, forces)])

    by_rate, by_heading, by_yaw_rate = ((loads(*each) - loads(*-each)) / (2.0 * step) for each in step * np.eye(3))
    matrices = analysis.inertial_matrices(UNEQUAL, speed)
    np.testing.assert_array_equal(matrices.mass, [[UNEQUAL.mass, 0.0], [0.0, UNEQUAL.yaw_inertia]])
    np.testing.assert_allclose(np.column_stack([by_rate, by_yaw_rate]), -matrices.damping, rtol=1e-7)
    np.testing.assert_allclose(by_heading, -matrices.stiffness[:, 1], rtol=1e-7)
    np.testing.assert_array_equal(matrices.stiffness[:, 0], 0.0)
