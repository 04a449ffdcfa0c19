"""Closed-form transfer functions against an independent path, against simulation, and their zeros."""

from __future__ import annotations

import control
import numpy as np
import pytest

from bicycle_env import analysis, simulate, vehicles
from bicycle_env.analysis.transfer_functions import INPUTS, OUTPUTS

CASES = [("oversteer", 25.0), ("oversteer", 43.0), ("understeer", 30.0), ("neutral", 20.0), ("mendes", 16.7)]
FREQUENCIES = np.logspace(-1, 2, 13)


@pytest.mark.parametrize(("name", "speed"), CASES)
@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("input", INPUTS)
def test_equal_to_the_state_spaces_own(name, speed, input, output):
    vehicle = vehicles[name]
    closed = analysis.transfer_function(vehicle, speed, input=input, output=output)
    independent = analysis.state_space(vehicle, speed)[output, input]
    at = 1j * FREQUENCIES
    np.testing.assert_allclose(closed(at), independent(at), rtol=1e-9)
    assert closed.input_labels == [input]
    assert closed.output_labels == [output]


def test_the_matrix_holds_all_of_them():
    matrix = analysis.transfer_matrix(vehicles["oversteer"], 43.0)
    assert matrix.ninputs == 2
    assert matrix.noutputs == 6
    one = analysis.transfer_function(vehicles["oversteer"], 43.0, "rear_steer", "yaw_rate")
    np.testing.assert_allclose(matrix["yaw_rate", "rear_steer"](2j), one(2j))


@pytest.mark.parametrize(("name", "speed"), CASES)
def test_rear_steer_is_non_minimum_phase(name, speed):
    vehicle = vehicles[name]
    rear = analysis.zeros(vehicle, speed, "rear_steer", "lateral_acceleration")
    assert np.sum(rear.real > 0) == 1
    for output in ("lateral_acceleration", "yaw_rate"):
        assert analysis.is_minimum_phase(vehicle, speed, "front_steer", output)
    above = speed > analysis.tangent_speed(vehicle)
    assert analysis.is_minimum_phase(vehicle, speed, "front_steer", "lateral_velocity") is not above


def test_rear_steered_car_first_accelerates_the_wrong_way():
    """The nonlinear model, at a small angle: the zero is seen in the response."""
    run = simulate(vehicles["understeer"], 30.0, (0.0, 1e-4), 6.0)
    start, end = run["lateral_acceleration"][0], run["lateral_acceleration"][-1]
    assert start > 0 > end
    front = simulate(vehicles["understeer"], 30.0, (1e-4, 0.0), 6.0)["lateral_acceleration"]
    assert np.all(front > 0)


@pytest.mark.parametrize("input", INPUTS)
def test_step_response_equals_the_simulation_of_the_nonlinear_model(input):
    vehicle, speed, angle = vehicles["understeer"], 25.0, 1e-5
    steer = (angle, 0.0) if input == "front_steer" else (0.0, angle)
    run = simulate(vehicle, speed, steer, 2.0, tire="magic_formula")
    for output in OUTPUTS:
        _, response = control.step_response(analysis.transfer_function(vehicle, speed, input, output), run["time"])
        scale = np.max(np.abs(response))
        np.testing.assert_allclose(run[output] / angle, response, atol=2e-5 * scale)


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"input": "front"}, "input must be one of"),
        ({"output": "yawrate"}, "did you mean 'yaw_rate'"),
        ({"speed": 0.0}, "speed must be"),
    ],
)
def test_bad_words(keywords, text):
    values = {"speed": 20.0, "input": "front_steer", "output": "yaw_rate", **keywords}
    with pytest.raises(ValueError, match=text):
        analysis.transfer_function(vehicles["oversteer"], **values)
