"""The fourth-order formulation, and the four-wheel slip angles whose half-tracks drop out."""

from __future__ import annotations

import numpy as np
import pytest

from bicycle_env import analysis, vehicles


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


def test_track_drops_out_to_first_order():
    """Half the perturbation leaves a quarter of what the book's (6.3), (6.5) miss."""
    vehicle, speed = vehicles["oversteer"], 30.0

    def remainder(size):
        lateral_rate, heading, yaw_rate = 1.0 * size, 0.05 * size, 0.4 * size
        slips = analysis.wheel_slip_angles(vehicle, speed, lateral_rate, heading, yaw_rate)
        front = (lateral_rate + vehicle.cg_to_front * yaw_rate) / speed - heading
        rear = (lateral_rate - vehicle.cg_to_rear * yaw_rate) / speed - heading
        return np.array(
            [slips.front_left - front, slips.front_right - front, slips.rear_left - rear, slips.rear_right - rear]
        )

    np.testing.assert_allclose(remainder(1e-3) / remainder(5e-4), 4.0, rtol=0.01)
    # Left and right differ by the half-track x yaw rate / speed, relative to the slip angle itself.
    slips = analysis.wheel_slip_angles(vehicle, speed, 1.0, 0.0, 0.4)
    difference = (slips.front_left - slips.front_right) / slips.front_left
    assert difference == pytest.approx(2 * vehicle.front_half_track * 0.4 / speed, rel=0.02)


def test_modes_and_classification():
    understeer = analysis.modes(vehicles["understeer"], 30.0)
    pair = analysis.eigenvalues(vehicles["understeer"], 30.0)
    assert understeer.natural_frequency == pytest.approx(np.abs(pair[0]))
    assert understeer.damping_ratio == pytest.approx(-pair[0].real / np.abs(pair[0]))
    assert understeer.time_to_double == np.inf
    unstable = analysis.modes(vehicles["oversteer"], 43.0)
    assert np.isnan(unstable.natural_frequency)
    assert unstable.time_to_double == pytest.approx(
        np.log(2) / max(analysis.eigenvalues(vehicles["oversteer"], 43.0).real)
    )
    assert [analysis.classification(vehicles[name]) for name in ("understeer", "neutral", "oversteer")] == [
        "understeer",
        "neutral",
        "oversteer",
    ]
