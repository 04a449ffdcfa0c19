"""The car on tires that relax: the closed forms of the linear one, and what it becomes without relaxation."""

import itertools

import numpy as np
import pytest
import scipy.linalg
from combinations import some_of

from bicycle_env import Vehicle, analysis, simulate, tires, vehicles
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.physics.lateral import GEOMETRIES
from bicycle_env.physics.linear_single_track import relaxed_matrices, state_matrix, straight_running
from bicycle_env.physics.relaxed_single_track import RelaxedSingleTrack
from bicycle_env.physics.single_track import SingleTrack

LENGTH = 0.5
LINEAR = {"tire": "linear", "geometry": "small_angle"}
BODY = ("lateral_velocity", "yaw_rate", "front_transient_slip_angle", "rear_transient_slip_angle")


def car(speed=30.0, length=LENGTH):
    return car_on_road(vehicles["oversteer"], speed, 1.0, FRONT, REAR, length)


@pytest.mark.parametrize(("tire", "geometry"), list(itertools.product(tires.LAWS, GEOMETRIES)))
def test_jacobian_at_straight_running_is_the_closed_form(tire, geometry):
    rates = RelaxedSingleTrack.of(tire, geometry).rates(PYTHON)
    straight = dict.fromkeys(RelaxedSingleTrack.State._fields, 0.0)
    matrix, inputs = relaxed_matrices(vehicles["oversteer"], 30.0, LENGTH)
    small = 1e-7

    def moved(names, steer):
        rate = rates(RelaxedSingleTrack.State(**{**straight, **names}), steer, car())
        return np.array([getattr(rate, name) for name in BODY]) / small

    for column, name in enumerate(BODY):
        np.testing.assert_allclose(moved({name: small}, (0.0, 0.0)), matrix[:, column], rtol=1e-5, atol=1e-5)
    for column, steer in enumerate([(small, 0.0), (0.0, small)]):
        np.testing.assert_allclose(moved({}, steer), inputs[:, column], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("vehicle", ["understeer", "oversteer"])
def test_a_step_of_the_steer_is_the_matrix_exponential(vehicle):
    speed, steer = 30.0, np.array([0.01, -0.004])
    matrix, inputs = relaxed_matrices(vehicles[vehicle], speed, LENGTH)
    run = simulate(vehicle, speed, steer, 0.8, **LINEAR, relaxation_length=LENGTH, timestep=1e-4)
    whole = np.zeros((5, 5))
    whole[:4, :4], whole[:4, 4] = matrix, inputs @ steer
    for k in (10, 500, 3000, 8000):
        expected = scipy.linalg.expm(whole * run["time"][k])[:4, 4]
        np.testing.assert_allclose([run[name][k] for name in BODY], expected, rtol=1e-8, atol=1e-13)


def test_the_force_of_a_car_that_does_not_give_way_follows_over_the_relaxation_length():
    heavy = Vehicle(
        mass=1e6,
        yaw_inertia=1e8,
        cg_to_front=1.2,
        cg_to_rear=1.4,
        front_cornering_stiffness=1e3,
        rear_cornering_stiffness=1e3,
    )
    run = simulate(heavy, 20.0, (0.02, 0.0), 0.1, **LINEAR, relaxation_length=0.4)
    rolled = 20.0 * run["time"]
    np.testing.assert_allclose(run["front_lateral_force"], 20.0 * (1.0 - np.exp(-rolled / 0.4)), rtol=1e-4, atol=1e-6)


def test_without_a_length_to_roll_it_is_the_single_track():
    """The difference goes to zero as the length does, in proportion to it."""
    given = ("oversteer", 30.0, lambda t: (0.03 * np.sin(6.0 * t), 0.0), 1.0)
    at_once = simulate(*given, timestep=1e-4)
    apart = [
        np.max(np.abs(simulate(*given, timestep=1e-4, relaxation_length=length)["yaw_rate"] - at_once["yaw_rate"]))
        for length in (0.04, 0.02, 0.01)
    ]
    assert apart[0] / apart[1] == pytest.approx(2.0, abs=0.1)
    assert apart[1] / apart[2] == pytest.approx(2.0, abs=0.1)
    assert apart[0] > 1e-4


@pytest.mark.parametrize("geometry", some_of(GEOMETRIES, ["exact"]))
def test_a_steady_turn_does_not_know_of_it(geometry):
    given = ("understeer", 20.0, (0.03, 0.0), 20.0)
    relaxed, at_once = (simulate(*given, geometry=geometry, relaxation_length=length) for length in (LENGTH, None))
    for name in ("lateral_velocity", "yaw_rate", "front_lateral_force", "rear_slip_angle"):
        assert relaxed[name][-1] == pytest.approx(at_once[name][-1], rel=1e-9)
    assert relaxed["front_transient_slip_angle"][-1] == pytest.approx(relaxed["front_slip_angle"][-1], rel=1e-9)


def test_a_completed_state_has_the_forces_of_the_single_track():
    state = CarState(0.0, 0.3, 0.1, 2.0, -0.4, 0.02, -0.01)
    model = RelaxedSingleTrack.of("fiala")
    assert model.axles(PYTHON)(model.complete(PYTHON)(state, car()), car()) == SingleTrack.of("fiala").axles(PYTHON)(
        state, car()
    )


@pytest.mark.parametrize("pushed", [False, True])
def test_mirror_symmetry_to_the_bit(pushed):
    rng = np.random.default_rng(2)
    model = RelaxedSingleTrack.of("magic_formula")
    state = model.State(*rng.uniform(-0.5, 0.5, (len(model.State._fields), 50)))
    steer = tuple(rng.uniform(-0.1, 0.1, (2, 50)))
    gust = {"side_force": 300.0, "yaw_moment": 100.0}
    here = model.rates(NUMPY, pushed)(state, steer, car()._replace(**gust))
    image = model.State(state.longitudinal_position, *(-value for value in state[1:]))
    there = model.rates(NUMPY, pushed)(
        image, tuple(-angle for angle in steer), car()._replace(**{name: -gust[name] for name in gust})
    )
    np.testing.assert_array_equal(there[0], here[0])
    np.testing.assert_array_equal(np.array(there[1:]), -np.array(here[1:]))


def test_the_critical_speed_is_the_same_and_the_growth_another():
    critical = vehicles["oversteer"].critical_speed
    for length in (0.1, 1.0):
        matrix = relaxed_matrices(vehicles["oversteer"], critical, length)[0]
        assert np.min(np.abs(np.linalg.eigvals(matrix))) < 1e-9
        assert analysis.stability("oversteer", 0.99 * critical, length).time_to_double == np.inf
    fast, slow = (analysis.stability("oversteer", 1.3 * critical, length) for length in (0.01, 1.0))
    at_once = analysis.stability("oversteer", 1.3 * critical)
    assert fast.time_to_double == pytest.approx(at_once.time_to_double, rel=0.01)
    assert slow.time_to_double != pytest.approx(at_once.time_to_double, rel=0.01)
    assert slow.eigenvalues.shape == (4,)


def test_straight_running_of_either_kind():
    vehicle = vehicles["me303"]
    np.testing.assert_array_equal(straight_running(vehicle, 20.0), state_matrix(vehicle, 20.0))
    np.testing.assert_array_equal(straight_running(vehicle, 20.0, 0.3), relaxed_matrices(vehicle, 20.0, 0.3)[0])


@pytest.mark.parametrize(
    ("length", "error"),
    [(0.0, ValueError), (-1.0, ValueError), (11.0, ValueError), (np.nan, ValueError), ("1", TypeError)],
)
def test_a_bad_length_is_refused(length, error):
    with pytest.raises(error, match="relaxation_length must be a finite number in"):
        simulate("oversteer", 30.0, (0.0, 0.0), 1.0, relaxation_length=length)
    with pytest.raises(error, match="relaxation_length must be"):
        analysis.stability("oversteer", 30.0, length)


def test_the_timestep_follows_the_fastest_lag():
    with pytest.raises(ValueError, match=r"timestep must be <= 0\.00083"):
        simulate("oversteer", 30.0, (0.0, 0.0), 1.0, relaxation_length=0.01)
