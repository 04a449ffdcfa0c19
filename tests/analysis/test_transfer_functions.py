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


def coefficients(function):
    """Numerator and denominator without leading zeros, the denominator's first coefficient 1."""
    top, bottom = (np.trim_zeros(np.real(each[0][0]), "f") for each in (function.num, function.den))
    return top / bottom[0], bottom / bottom[0]


@pytest.mark.parametrize(("name", "speed"), CASES)
@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("input", INPUTS)
def test_coefficients_are_those_that_python_control_makes_of_the_matrices(name, speed, input, output):
    """The same rational function: each numerator times the other's denominator."""
    closed = coefficients(analysis.transfer_function(vehicles[name], speed, input, output))
    made = coefficients(control.ss2tf(analysis.state_space(vehicles[name], speed)[output, input]))
    left, right = np.polymul(closed[0], made[1]), np.polymul(made[0], closed[1])
    size = max(len(left), len(right))
    left, right = (np.pad(each, (size - len(each), 0)) for each in (left, right))
    np.testing.assert_allclose(left, right, atol=1e-9 * np.max(np.abs(right)))


@pytest.mark.parametrize(("name", "speed"), CASES)
@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("input", INPUTS)
def test_poles_and_zeros(name, speed, input, output):
    vehicle = vehicles[name]
    function = analysis.transfer_function(vehicle, speed, input, output)
    integrations = {"heading": 1, "lateral_position": 2}.get(output, 0)
    poles = [*analysis.eigenvalues(vehicle, speed), *[0.0] * integrations]
    np.testing.assert_allclose(np.sort_complex(function.poles()), np.sort_complex(poles), rtol=1e-9, atol=1e-9)
    zeros = np.sort_complex(analysis.zeros(vehicle, speed, input, output))
    np.testing.assert_allclose(np.sort_complex(function.zeros()), zeros, rtol=1e-9)
    np.testing.assert_allclose(np.abs(function(zeros)), 0.0, atol=1e-9 * abs(function(1j)))


def test_the_matrix_holds_all_of_them():
    matrix = analysis.transfer_matrix(vehicles["oversteer"], 43.0)
    assert (matrix.input_labels, matrix.output_labels) == (list(INPUTS), list(OUTPUTS))
    for input in INPUTS:
        for output in OUTPUTS:
            one = analysis.transfer_function(vehicles["oversteer"], 43.0, input, output)
            np.testing.assert_allclose(matrix[output, input](2j), one(2j), rtol=1e-12)


def test_the_signals_of_the_state_space_are_named():
    system = analysis.state_space(vehicles["oversteer"], 43.0)
    assert (system.input_labels, system.output_labels) == (list(INPUTS), list(OUTPUTS))
    assert system.state_labels == ["lateral_velocity", "yaw_rate", "heading", "lateral_position"]
    np.testing.assert_array_equal(system.A[:2, :2], analysis.state_matrix(vehicles["oversteer"], 43.0))
    np.testing.assert_array_equal(system.B[:2], analysis.input_matrix(vehicles["oversteer"], 43.0))


@pytest.mark.parametrize(("name", "speed"), CASES)
def test_rear_steer_is_non_minimum_phase(name, speed):
    vehicle = vehicles[name]
    rear = analysis.zeros(vehicle, speed, "rear_steer", "lateral_acceleration")
    assert np.sum(rear.real > 0) == 1
    for output in ("lateral_acceleration", "yaw_rate"):
        assert analysis.is_minimum_phase(vehicle, speed, "front_steer", output)
    above = speed > analysis.tangent_speed(vehicle)
    assert analysis.is_minimum_phase(vehicle, speed, "front_steer", "lateral_velocity") is not above


@pytest.mark.parametrize("name", list(vehicles))
def test_front_steered_sideslip_is_non_minimum_phase_above_the_tangent_speed(name):
    vehicle = vehicles[name]
    speed = analysis.tangent_speed(vehicle)
    for output in ("lateral_velocity", "sideslip"):
        assert analysis.is_minimum_phase(vehicle, 0.999 * speed, "front_steer", output)
        assert not analysis.is_minimum_phase(vehicle, 1.001 * speed, "front_steer", output)
        assert analysis.is_minimum_phase(vehicle, 1.001 * speed, "rear_steer", output)


def test_rear_steered_car_first_accelerates_the_wrong_way():
    """The nonlinear model, at a small angle: the zero is seen in the response."""
    run = simulate(vehicles["understeer"], 30.0, (0.0, 1e-4), 6.0)
    start, end = run["lateral_acceleration"][0], run["lateral_acceleration"][-1]
    assert start > 0 > end
    front = simulate(vehicles["understeer"], 30.0, (1e-4, 0.0), 6.0)["lateral_acceleration"]
    assert np.all(front > 0)


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
@pytest.mark.parametrize(("name", "speed"), [("understeer", 25.0), ("oversteer", 43.0)])
@pytest.mark.parametrize("input", INPUTS)
def test_step_response_equals_the_simulation_of_the_nonlinear_model(input, name, speed, tire):
    """Below and above the critical speed, with the exact geometry."""
    vehicle, angle = vehicles[name], 1e-6
    steer = (angle, 0.0) if input == "front_steer" else (0.0, angle)
    run = simulate(vehicle, speed, steer, 2.0, tire=tire)
    for output in OUTPUTS:
        _, response = control.step_response(analysis.transfer_function(vehicle, speed, input, output), run["time"])
        scale = np.max(np.abs(response))
        np.testing.assert_allclose(run[output] / angle, response, atol=1e-4 * scale)


@pytest.mark.parametrize("frequency", [2.0, 12.0])
@pytest.mark.parametrize("input", INPUTS)
def test_frequency_response_equals_the_simulation_of_the_nonlinear_model(input, frequency):
    """Slow and fast steering, once the beginning is forgotten: amplitude and phase of what returns to zero."""
    vehicle, speed, angle, period = vehicles["understeer"], 25.0, 1e-6, 2.0 * np.pi / frequency
    axle = INPUTS.index(input)
    settled = np.ceil(5.0 / period) * period

    def steer(time):
        return tuple(angle * np.sin(frequency * time) * np.eye(2)[axle])

    run = simulate(vehicle, speed, steer, settled + period, timestep=2e-3)
    last = run["time"] >= settled - 1e-9
    carrier = np.exp(1j * frequency * run["time"][last])
    for output in ("lateral_velocity", "yaw_rate", "lateral_acceleration", "sideslip"):
        # y = Im(G e^{jwt}): fitted by least squares
        table = np.column_stack([carrier.imag, carrier.real])
        (real, imaginary), *_ = np.linalg.lstsq(table, run[output][last] / angle, rcond=None)
        expected = analysis.transfer_function(vehicle, speed, input, output)(1j * frequency)
        assert real + 1j * imaginary == pytest.approx(expected, rel=1e-3)


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
