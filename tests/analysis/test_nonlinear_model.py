"""Jacobians of the nonlinear car: exact, and equal to the linear matrices at straight running."""

import itertools

import numpy as np
import pytest

from bicycle_env import analysis, tires, vehicles
from bicycle_env.analysis.nonlinear_model import NonlinearModel
from bicycle_env.physics.lateral import GEOMETRIES

COMBINATIONS = list(itertools.product(tires.LAWS, GEOMETRIES))


@pytest.mark.parametrize(("tire", "geometry"), COMBINATIONS)
@pytest.mark.parametrize("name", vehicles)
def test_straight_running_is_the_linear_model(name, tire, geometry):
    for speed in (7.0, 43.0):
        found = analysis.jacobians(name, speed, tire=tire, friction=0.4, geometry=geometry)
        np.testing.assert_allclose(found.state, analysis.state_matrix(vehicles[name], speed), rtol=1e-13, atol=1e-12)
        np.testing.assert_allclose(found.input, analysis.input_matrix(vehicles[name], speed), rtol=1e-13)


@pytest.mark.parametrize(("tire", "geometry"), COMBINATIONS)
def test_any_state_against_differences(tire, geometry):
    model = NonlinearModel("oversteer", 31.0, tire, 0.8, geometry)
    rng = np.random.default_rng(1)
    point = rng.uniform(-1.0, 1.0, (300, 4)) * [6.0, 0.6, 0.15, 0.1]
    found = model.jacobians(*point.T)
    matrix = np.concatenate([found.state, found.input], axis=-1)
    assert matrix.shape == (300, 2, 4)
    for k, step in enumerate([1e-4, 1e-5, 1e-6, 1e-6]):
        ahead, behind = (model.rates(*(point + sign * step * np.eye(4)[k]).T) for sign in (1.0, -1.0))
        difference = (np.array(ahead) - np.array(behind)).T / (2.0 * step)
        np.testing.assert_allclose(matrix[:, :, k], difference, rtol=1e-5, atol=1e-4)


def test_a_sliding_car_by_hand():
    """Both axles far beyond sliding: the forces do not change with the state; only m r U and the cosines are left."""
    vehicle, speed = vehicles["oversteer"], 20.0
    found = analysis.jacobians(vehicle, speed, lateral_velocity=-12.0, yaw_rate=0.1, steer=(0.1, 0.05), tire="fiala")
    np.testing.assert_allclose(found.state, [[0.0, -speed], [0.0, 0.0]], atol=1e-12)
    sines = -vehicle.front_axle_load * np.sin(0.1), -vehicle.rear_axle_load * np.sin(0.05)
    expected = [
        [sines[0] / vehicle.mass, sines[1] / vehicle.mass],
        [1.4 * sines[0] / vehicle.yaw_inertia, -1.3 * sines[1] / vehicle.yaw_inertia],
    ]
    np.testing.assert_allclose(found.input, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"vehicle": "oversteeer"}, "did you mean 'oversteer'"),
        ({"speed": 0.0}, "speed must be"),
        ({"lateral_velocity": float("nan")}, "lateral_velocity must be"),
        ({"yaw_rate": float("inf")}, "yaw_rate must be"),
        ({"steer": (0.1,)}, r"steer must be a pair \(front, rear\)"),
        ({"steer": (0.1, 1.6)}, "steer must be a pair"),
        ({"steer": "left"}, "steer must be a pair"),
        ({"tire": "fial"}, "did you mean 'fiala'"),
        ({"friction": -1.0}, "friction must be"),
        ({"geometry": "round"}, "geometry must be"),
    ],
)
def test_bad_input(keywords, message):
    with pytest.raises(ValueError, match=message):
        analysis.jacobians(**{"vehicle": "oversteer", "speed": 30.0} | keywords)
