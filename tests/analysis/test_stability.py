"""The closed forms of stability and balance against numpy's eigenvalues and roots, and against figures by hand."""

import math

import control
import numpy as np
import pytest

from bicycle_env import Vehicle, analysis, simulate, vehicles

SPEEDS = (3.0, 12.0, 25.0, 36.0, 50.0, 90.0)
COORDINATES = ("body", "inertial")


def random_vehicles(count=60):
    """Half of them oversteer, roughly."""
    rng = np.random.default_rng(2)
    return [
        Vehicle(
            mass=rng.uniform(800, 3000),
            yaw_inertia=rng.uniform(1000, 6000),
            cg_to_front=rng.uniform(0.9, 2.0),
            cg_to_rear=rng.uniform(0.9, 2.0),
            front_cornering_stiffness=rng.uniform(3e4, 2e5),
            rear_cornering_stiffness=rng.uniform(3e4, 2e5),
        )
        for _ in range(count)
    ]


# a = 2, b = 1, Cf = Cr = 1, m = 1: a Cf - b Cr = 1, so U_crit = 3 and the criterion at 3 is 9/9 - 1 = 0 exactly
UNIT = Vehicle(
    mass=1.0,
    yaw_inertia=2.0,
    cg_to_front=2.0,
    cg_to_rear=1.0,
    front_cornering_stiffness=1.0,
    rear_cornering_stiffness=1.0,
)


def test_matrices_by_hand():
    # (Cf + Cr)/(m U) = 1, (a Cf - b Cr)/(m U) = 1/2, (a^2 Cf + b^2 Cr)/(Iz U) = 5/4 at U = 2
    np.testing.assert_allclose(analysis.state_matrix(UNIT, 2.0), [[-1.0, -0.5 - 2.0], [-0.25, -1.25]], rtol=1e-15)
    np.testing.assert_allclose(analysis.input_matrix(UNIT, 2.0), [[1.0, 1.0], [1.0, -0.5]], rtol=1e-15)


@pytest.mark.parametrize("speed", SPEEDS)
def test_characteristic_polynomial_is_that_of_the_matrix(speed):
    for vehicle in random_vehicles():
        polynomial = analysis.characteristic_polynomial(vehicle, speed)
        assert polynomial[0] == vehicle.mass * vehicle.yaw_inertia
        matrix = analysis.state_matrix(vehicle, speed)
        expected = np.poly(matrix) * vehicle.mass * vehicle.yaw_inertia
        scale = vehicle.mass * vehicle.yaw_inertia * np.array([1.0, *np.cumprod([np.linalg.norm(matrix)] * 2)])
        np.testing.assert_allclose(polynomial / scale, expected / scale, rtol=0.0, atol=1e-12)


def test_characteristic_polynomial_is_the_determinant():
    """(6.25), (6.26) written out from (6.22), (6.23) without steering: V and r both as exp(s t)."""
    for vehicle in random_vehicles():
        speed = 31.0
        a, b = vehicle.cg_to_front, vehicle.cg_to_rear
        front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
        coupling, turning = (a * front - b * rear) / speed, (a * a * front + b * b * rear) / speed
        for s in (0.3 + 0.7j, -2.0 + 0.1j, 5.0):
            rows = np.array(
                [
                    [vehicle.mass * s + (front + rear) / speed, vehicle.mass * speed + coupling],
                    [coupling, vehicle.yaw_inertia * s + turning],
                ]
            )
            polynomial = analysis.characteristic_polynomial(vehicle, speed)
            assert np.polyval(polynomial, s) == pytest.approx(np.linalg.det(rows), rel=1e-9)
            weights = np.diag([vehicle.mass, vehicle.yaw_inertia])
            np.testing.assert_allclose(
                weights @ (s * np.eye(2) - analysis.state_matrix(vehicle, speed)), rows, rtol=1e-12, atol=1e-6
            )


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_eigenvalues_are_the_roots_of_the_polynomial(coordinates):
    for vehicle in random_vehicles(30):
        for speed in SPEEDS:
            polynomial = analysis.characteristic_polynomial(vehicle, speed, coordinates)
            values = analysis.eigenvalues(vehicle, speed, coordinates)
            assert values.dtype == np.complex128
            # values of the polynomial at its roots, against the size of its terms there
            for value in values:
                terms = polynomial * value ** np.arange(len(polynomial) - 1, -1, -1)
                assert abs(terms.sum()) <= 1e-11 * np.abs(terms).sum()
            assert values.sum().real == pytest.approx(-polynomial[1] / polynomial[0], rel=1e-12)


@pytest.mark.parametrize("speed", SPEEDS)
def test_inertial_coordinates_add_two_zeros(speed):
    for vehicle in random_vehicles(10):
        body = analysis.eigenvalues(vehicle, speed)
        inertial = analysis.eigenvalues(vehicle, speed, coordinates="inertial")
        np.testing.assert_array_equal(inertial, [*body, 0.0, 0.0])
        polynomial = analysis.characteristic_polynomial(vehicle, speed, "inertial")
        np.testing.assert_array_equal(polynomial, [*analysis.characteristic_polynomial(vehicle, speed), 0.0, 0.0])


def test_inertial_coordinates_against_equation_6_9():
    """m q'' + D q' + K q = 0 with q = (y, psi), written out here from the book, has the same polynomial."""
    for vehicle in random_vehicles(20):
        speed = 31.0
        a, b = vehicle.cg_to_front, vehicle.cg_to_rear
        front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
        both, coupling, turning = front + rear, a * front - b * rear, a * a * front + b * b * rear
        mass = np.diag([vehicle.mass, vehicle.yaw_inertia])
        system = np.zeros((4, 4))
        system[:2, 2:] = np.eye(2)
        system[2:, :2] = -np.linalg.solve(mass, [[0.0, -both], [0.0, -coupling]])
        system[2:, 2:] = -np.linalg.solve(mass, np.array([[both, coupling], [coupling, turning]]) / speed)
        polynomial = analysis.characteristic_polynomial(vehicle, speed, "inertial")
        np.testing.assert_allclose(
            np.poly(system)[:3], polynomial[:3] / polynomial[0], rtol=1e-9, atol=1e-9 * np.linalg.norm(system)
        )
        assert np.all(np.abs(np.poly(system)[3:]) <= 1e-9 * np.linalg.norm(system) ** 3)


def test_stability_criterion_is_the_sign_of_the_largest_real_part():
    signs = set()
    for vehicle in random_vehicles():
        for speed in SPEEDS:
            growth = analysis.eigenvalues(vehicle, speed).real.max()
            assert analysis.is_stable(vehicle, speed) == (growth < 0.0)
            assert np.sign(analysis.stability_criterion(vehicle, speed)) == -np.sign(growth)
            signs.add(growth < 0.0)
    assert signs == {True, False}


def test_only_the_last_coefficient_can_be_negative():
    """Why (6.14) alone decides: it is (6.13) for the constant term, which is the criterion."""
    for vehicle in random_vehicles():
        for speed in SPEEDS:
            assert np.all(analysis.characteristic_polynomial(vehicle, speed)[:2] > 0.0)
        assert analysis.stability_criterion(vehicle, 20.0) == analysis.characteristic_polynomial(vehicle, 20.0)[-1]


def test_both_sides_of_the_critical_speed():
    some = 0
    for vehicle in [*random_vehicles(), UNIT, vehicles["oversteer"], vehicles["me303"]]:
        critical = analysis.critical_speed(vehicle)
        assert critical == vehicle.critical_speed
        if math.isinf(critical):
            assert analysis.is_stable(vehicle, 1e4)
            continue
        some += 1
        assert analysis.is_stable(vehicle, critical * (1.0 - 1e-9))
        assert not analysis.is_stable(vehicle, critical * (1.0 + 1e-9))
        values = analysis.eigenvalues(vehicle, critical)
        assert np.abs(values).min() <= 1e-9 * np.abs(values).max()  # one eigenvalue passes through zero
    assert some > 10


def test_exactly_at_the_limit_is_not_stable():
    assert analysis.critical_speed(UNIT) == 3.0
    assert analysis.stability_criterion(UNIT, 3.0) == 0.0
    answer = analysis.is_stable(UNIT, 3.0)
    assert answer is False
    assert analysis.is_stable(UNIT, math.nextafter(3.0, 0.0)) is True


def test_neutral_is_stable_at_every_speed_and_ever_more_slowly():
    slowest = [np.abs(analysis.eigenvalues(vehicles["neutral"], speed).real).min() for speed in (20.0, 80.0, 320.0)]
    assert slowest[0] > slowest[1] > slowest[2] > 0.0
    assert analysis.is_stable(vehicles["neutral"], 1e4)


def test_characteristic_speed():
    """There, an understeering car's yaw-rate gain is half that of a neutral one, and at its greatest."""
    vehicle = vehicles["understeer"]
    speed = analysis.characteristic_speed(vehicle)
    # L^2 Cf Cr / (m (b Cr - a Cf)) with 2.7, 90e3, 110e3, 1500, 143e3 - 126e3
    assert speed == pytest.approx(math.sqrt(2.7**2 * 90e3 * 110e3 / (1500 * 17e3)), rel=1e-13)
    gain = analysis.steady_state_gain(vehicle, speed)
    assert gain == pytest.approx(0.5 * speed / vehicle.wheelbase, rel=1e-12)
    for other in (0.97 * speed, 1.03 * speed):
        assert analysis.steady_state_gain(vehicle, other) < gain
    for name in ("neutral", "oversteer"):
        assert analysis.characteristic_speed(vehicles[name]) == math.inf


def test_understeer_gradient_and_static_margin_by_hand():
    oversteer = vehicles["oversteer"]  # b Cr - a Cf = 117e3 - 154e3
    assert analysis.understeer_gradient(oversteer) == pytest.approx(1500 * -37e3 / (2.7 * 110e3 * 90e3), rel=1e-12)
    assert analysis.static_margin(oversteer) == pytest.approx(37e3 / (2.7 * 200e3), rel=1e-12)
    assert str(analysis.static_margin(vehicles["neutral"])) == "0.0"  # and not -0.0
    assert analysis.static_margin(vehicles["understeer"]) < 0.0 < analysis.understeer_gradient(vehicles["understeer"])


def test_gradient_and_critical_speed_say_the_same():
    for vehicle in random_vehicles():
        gradient = analysis.understeer_gradient(vehicle)
        assert np.sign(gradient) == -np.sign(analysis.static_margin(vehicle))
        if gradient < 0.0:
            assert analysis.critical_speed(vehicle) == pytest.approx(math.sqrt(-vehicle.wheelbase / gradient), rel=1e-9)
            assert analysis.characteristic_speed(vehicle) == math.inf
        else:
            assert analysis.critical_speed(vehicle) == math.inf


def test_classification():
    words = {"understeer": "understeer", "neutral": "neutral", "oversteer": "oversteer", "me303": "oversteer"}
    for name, word in {**words, **dict.fromkeys(("mendes", "cabrol", "civic", "tsx"), "understeer")}.items():
        assert analysis.classification(vehicles[name]) == word, name


def test_every_car_is_stable_at_low_speed_and_an_understeering_one_at_all():
    understeering = 0
    for vehicle in random_vehicles():
        assert analysis.is_stable(vehicle, 1.0)
        if vehicle.cg_to_rear * vehicle.rear_cornering_stiffness > (
            vehicle.cg_to_front * vehicle.front_cornering_stiffness
        ):
            understeering += 1
            for speed in (10.0, 100.0, 1e4):
                assert np.all(analysis.eigenvalues(vehicle, speed).real < 0.0)
    assert 10 < understeering < 50


# Modes


@pytest.mark.parametrize("name", ["understeer", "cabrol", "tsx"])
def test_modes_are_those_that_python_control_finds(name):
    vehicle, speed = vehicles[name], 30.0
    found = analysis.modes(vehicle, speed)
    frequencies, ratios, poles = control.damp(
        analysis.transfer_function(vehicle, speed, "front_steer", "yaw_rate"), doprint=False
    )
    assert np.all(np.imag(poles) != 0.0)
    np.testing.assert_allclose(frequencies, found.natural_frequency, rtol=1e-9)
    np.testing.assert_allclose(ratios, found.damping_ratio, rtol=1e-9)
    assert found.time_to_double == math.inf


def test_modes_that_do_not_oscillate():
    """Two real eigenvalues: their product is the frequency squared. An unstable car has neither figure."""
    slow, fast = sorted(-analysis.eigenvalues(vehicles["oversteer"], 30.0).real)
    found = analysis.modes(vehicles["oversteer"], 30.0)
    assert found.natural_frequency == pytest.approx(math.sqrt(slow * fast), rel=1e-12)
    assert found.damping_ratio == pytest.approx((slow + fast) / (2.0 * math.sqrt(slow * fast)), rel=1e-12)
    assert found.damping_ratio > 1.0
    unstable = analysis.modes(vehicles["oversteer"], 43.0)
    assert math.isnan(unstable.natural_frequency)
    assert math.isnan(unstable.damping_ratio)
    assert unstable.time_to_double == analysis.stability(vehicles["oversteer"], 43.0).time_to_double


@pytest.mark.parametrize("tire", ["linear", "tanh", "fiala", "magic_formula"])
def test_the_simulated_car_takes_that_time_to_double(tire):
    """The nonlinear model near straight running, once the decaying mode has died out."""
    vehicle, speed = vehicles["oversteer"], 45.0
    doubling = analysis.stability(vehicle, speed).time_to_double
    run = simulate(
        vehicle, speed, (0.0, 0.0), 3.0, tire, initial_state={"lateral_velocity": 1e-6}, timestep=doubling / 200
    )
    begin = np.searchsorted(run["time"], 2.0)
    for name in ("lateral_velocity", "yaw_rate"):
        later = np.interp(run["time"][begin] + doubling, run["time"], run[name])
        assert later / run[name][begin] == pytest.approx(2.0, rel=1e-4)


# Steady state


@pytest.mark.parametrize("speed", SPEEDS)
def test_gains_are_those_of_the_transfer_functions(speed):
    """The table of equations.md at s = 0."""
    for vehicle in random_vehicles(20):
        m, length = vehicle.mass, vehicle.wheelbase
        a, b = vehicle.cg_to_front, vehicle.cg_to_rear
        front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
        last = analysis.stability_criterion(vehicle, speed)
        yaw = length * front * rear / speed / last
        expected = {
            ("front_steer", "yaw_rate"): yaw,
            ("rear_steer", "yaw_rate"): -yaw,
            ("front_steer", "lateral_acceleration"): yaw * speed,
            ("rear_steer", "lateral_acceleration"): -yaw * speed,
            ("front_steer", "lateral_velocity"): (length * b * front * rear / speed - m * a * speed * front) / last,
            ("rear_steer", "lateral_velocity"): (length * a * front * rear / speed + m * b * speed * rear) / last,
        }
        for (steer, output), value in expected.items():
            assert analysis.steady_state_gain(vehicle, speed, input=steer, output=output) == pytest.approx(
                value, rel=1e-9
            )
        for steer in ("front_steer", "rear_steer"):
            assert analysis.steady_state_gain(vehicle, speed, input=steer, output="sideslip") == pytest.approx(
                expected[steer, "lateral_velocity"] / speed, rel=1e-9
            )


def test_gradient_is_the_steer_beyond_geometry():
    """steer = L/R + K ay: what K means."""
    for vehicle in random_vehicles(20):
        for speed in SPEEDS:
            per_acceleration = 1.0 / analysis.steady_state_gain(vehicle, speed, output="lateral_acceleration")
            expected = vehicle.wheelbase / speed**2 + analysis.understeer_gradient(vehicle)
            assert per_acceleration == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("tire", ["fiala", "magic_formula"])
@pytest.mark.parametrize(("steer", "input"), [((1e-6, 0.0), "front_steer"), ((0.0, 1e-6), "rear_steer")])
def test_the_simulated_car_settles_at_the_gains(tire, steer, input):
    run = simulate("understeer", 25.0, steer, 8.0, tire)
    for output in ("lateral_velocity", "yaw_rate", "lateral_acceleration", "sideslip"):
        gain = analysis.steady_state_gain("understeer", 25.0, input=input, output=output)
        assert run[output][-1] / 1e-6 == pytest.approx(gain, rel=1e-4)


def test_both_axles_steered_alike_leave_the_car_straight():
    vehicle = vehicles["understeer"]
    assert analysis.steady_state_gain(vehicle, 20.0, input="front_steer", output="yaw_rate") == pytest.approx(
        -analysis.steady_state_gain(vehicle, 20.0, input="rear_steer", output="yaw_rate"), rel=1e-12
    )


def test_sideslip_changes_sign_at_the_tangent_speed():
    for vehicle in random_vehicles(20):
        speed = analysis.tangent_speed(vehicle)
        if abs(speed / analysis.critical_speed(vehicle) - 1.0) < 0.1:
            continue
        a, b, rear = vehicle.cg_to_front, vehicle.cg_to_rear, vehicle.rear_cornering_stiffness
        assert speed == pytest.approx(math.sqrt(b * vehicle.wheelbase * rear / (a * vehicle.mass)), rel=1e-12)
        around = [analysis.steady_state_gain(vehicle, k * speed, output="sideslip") for k in (0.999, 1.001)]
        assert around[0] * around[1] < 0.0


def test_no_steady_state_exactly_at_the_critical_speed():
    with pytest.raises(ValueError, match="speed must differ from the critical speed 3 m/s, got 3"):
        analysis.steady_state_gain(UNIT, 3.0)


def test_low_speed_gains_are_geometry():
    """Ackermann: r = U steer / L."""
    assert analysis.steady_state_gain(vehicles["oversteer"], 0.1) == pytest.approx(0.1 / 2.7, rel=1e-4)


# Figures of an environment


def test_open_loop_figures():
    vehicle = vehicles["oversteer"]
    speed = 1.2 * vehicle.critical_speed
    figures = analysis.stability(vehicle, speed)
    assert figures.critical_speed == vehicle.critical_speed
    assert figures.speed_ratio == pytest.approx(1.2, rel=1e-14)
    np.testing.assert_array_equal(figures.eigenvalues, analysis.eigenvalues(vehicle, speed))
    growth = figures.eigenvalues.real.max()
    assert growth > 0.0
    assert math.exp(growth * figures.time_to_double) == pytest.approx(2.0, rel=1e-12)


def test_open_loop_figures_of_a_stable_car():
    assert analysis.stability(vehicles["oversteer"], 20.0).time_to_double == math.inf
    figures = analysis.stability(vehicles["understeer"], 50.0)
    assert figures.critical_speed == figures.time_to_double == math.inf
    assert figures.speed_ratio == 0.0


# Errors


@pytest.mark.parametrize(
    "function",
    [
        analysis.is_stable,
        analysis.stability_criterion,
        analysis.state_matrix,
        analysis.input_matrix,
        analysis.eigenvalues,
        analysis.characteristic_polynomial,
        analysis.steady_state_gain,
        analysis.stability,
    ],
)
def test_a_bad_speed_is_named(function):
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="speed must be a finite number > 0"):
            function(UNIT, bad)
    for bad in ("fast", None, True, [3.0]):
        with pytest.raises(TypeError, match="speed must be a finite number > 0"):
            function(UNIT, bad)


@pytest.mark.parametrize("function", [analysis.eigenvalues, analysis.characteristic_polynomial])
def test_bad_coordinates_are_named(function):
    with pytest.raises(ValueError, match=r"coordinates must be one of 'body', 'inertial', got 'inertia'; did you mean"):
        function(UNIT, 2.0, coordinates="inertia")
    with pytest.raises(TypeError, match="coordinates must be one of"):
        function(UNIT, 2.0, coordinates=2)


def test_bad_input_and_output_are_named():
    with pytest.raises(ValueError, match=r"input must be one of .*got 'front_ster'; did you mean 'front_steer'\?"):
        analysis.steady_state_gain(UNIT, 2.0, input="front_ster")
    with pytest.raises(ValueError, match=r"output must be one of .*got 'heading'"):
        analysis.steady_state_gain(UNIT, 2.0, output="heading")
