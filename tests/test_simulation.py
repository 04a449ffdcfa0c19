"""``bicycle_env.simulate``: its three kinds of steer, what it returns, and what it refuses."""

import math

import numpy as np
import pytest

from bicycle_env import Vehicle, simulate, tires, vehicles
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.lateral import GEOMETRIES
from bicycle_env.physics.single_track import SingleTrack

GOOD = {"vehicle": "oversteer", "speed": 30.0, "steer": (0.02, -0.01), "duration": 0.5}
STATES = CarState._fields


def same(one, other):
    assert list(one) == list(other)
    for name in one:
        assert np.array_equal(one[name], other[name]), name


@pytest.mark.parametrize("tire", tires.LAWS)
def test_constant_array_and_callable_agree_to_the_bit(tire):
    start = {"lateral_velocity": 1.0, "yaw_rate": -0.2}
    constant = simulate(**GOOD, tire=tire, initial_state=start)
    array = simulate(**(GOOD | {"steer": np.tile([0.02, -0.01], (500, 1))}), tire=tire, initial_state=start)
    function = simulate(**(GOOD | {"steer": lambda t: (0.02, -0.01)}), tire=tire, initial_state=start)
    same(constant, array)
    same(constant, function)
    same(constant, simulate(**(GOOD | {"steer": [0.02, -0.01]}), tire=tire, initial_state=start))


def test_each_row_of_an_array_is_held_for_one_timestep():
    """Two runs of constant steer, one after the other, are one run with an array."""
    rows = np.array([[0.03, 0.0]] * 3 + [[-0.02, 0.01]] * 4)
    whole = simulate(**(GOOD | {"steer": rows, "duration": 0.07}), timestep=0.01)
    first = simulate(**(GOOD | {"steer": rows[0], "duration": 0.03}), timestep=0.01)
    middle = {name: first[name][-1] for name in STATES[:5]}
    second = simulate(**(GOOD | {"steer": rows[-1], "duration": 0.04}), timestep=0.01, initial_state=middle)
    for name in STATES[:5]:
        np.testing.assert_allclose(whole[name][:4], first[name], rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(whole[name][3:], second[name], rtol=1e-12, atol=1e-14)


def test_a_callable_sees_the_start_the_middle_and_the_end_of_each_step():
    times = []

    def steer(time):
        times.append(time)
        return (0.0, 0.0)

    simulate(**(GOOD | {"steer": steer, "duration": 0.4}), timestep=0.1, tire="linear")
    np.testing.assert_allclose(sorted(set(times)), np.linspace(0.0, 0.4, 9), atol=1e-15)
    assert all(type(time) is float for time in times)


def test_a_callable_and_a_fine_array_converge():
    def steer(time):
        return (0.02 * math.sin(6.0 * time), 0.01 * math.sin(4.0 * time))

    middles = (np.arange(5000) + 0.5) * 1e-4
    rows = np.array([steer(time) for time in middles])
    smooth = simulate(**(GOOD | {"steer": steer}))
    stairs = simulate(**(GOOD | {"steer": rows}), timestep=1e-4)
    assert smooth["yaw_rate"][-1] == pytest.approx(stairs["yaw_rate"][-1], abs=1e-7)


def test_both_ends_are_included():
    run = simulate(**GOOD, timestep=0.01, initial_state={"yaw_rate": 0.1})
    assert all(values.shape == (51,) for values in run.values())
    assert run["time"][0] == 0.0
    assert run["time"][-1] == 0.5
    assert run["yaw_rate"][0] == 0.1
    assert run["longitudinal_position"][-1] == pytest.approx(30.0 * 0.5, rel=1e-2)


@pytest.mark.parametrize(("duration", "steps"), [(0.5, 500), (0.3, 300), (0.0005, 1), (0.0011, 2), (1e-3, 1)])
def test_number_of_steps(duration, steps):
    run = simulate(**(GOOD | {"duration": duration}), tire="linear")
    assert len(run["time"]) == steps + 1
    assert run["time"][-1] == duration


def test_a_timestep_that_does_not_divide_the_duration_is_shortened():
    run = simulate(**(GOOD | {"duration": 0.1}), timestep=0.03, tire="linear")
    np.testing.assert_allclose(np.diff(run["time"]), 0.025, rtol=1e-12)


def test_names_and_ownership_of_what_it_returns():
    run = simulate(**GOOD)
    assert list(run) == [
        "time",
        "longitudinal_position",
        "lateral_position",
        "heading",
        "lateral_velocity",
        "yaw_rate",
        "front_steer",
        "rear_steer",
        "front_slip_angle",
        "rear_slip_angle",
        "front_lateral_force",
        "rear_lateral_force",
        "lateral_acceleration",
        "yaw_acceleration",
        "sideslip",
    ]
    for values in run.values():
        assert type(values) is np.ndarray
        assert values.dtype == np.float64
        assert values.ndim == 1
    names = list(run)
    assert all(run[name].flags.owndata for name in STATES)  # no view of one large table
    for k, name in enumerate(names):
        for other in names[k + 1 :]:
            assert not np.shares_memory(run[name], run[other]), (name, other)


@pytest.mark.parametrize("tire", tires.LAWS)
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_derived_histories_belong_to_the_states(tire, geometry):
    run = simulate(**GOOD, tire=tire, geometry=geometry, friction=0.8)
    vehicle = vehicles["oversteer"]
    car = car_on_road(vehicle, 30.0, 0.8, FRONT, REAR)
    acting = SingleTrack.of(tire, geometry).axles(NUMPY)(
        CarState(*(run[name] for name in STATES)), type(car)(*map(np.float64, car))
    )
    for name, values in acting._asdict().items():
        np.testing.assert_array_equal(run[name], values)
    np.testing.assert_array_equal(run["sideslip"], run["lateral_velocity"] / 30.0)
    # V' + U r from the states themselves, by central differences
    change = np.gradient(run["lateral_velocity"], run["time"])[2:-2]
    np.testing.assert_allclose(change + 30.0 * run["yaw_rate"][2:-2], run["lateral_acceleration"][2:-2], atol=2e-4)
    change = np.gradient(run["yaw_rate"], run["time"])[2:-2]
    np.testing.assert_allclose(change, run["yaw_acceleration"][2:-2], atol=5e-4)


def test_the_first_steer_is_that_of_the_input():
    rows = np.linspace([0.01, 0.0], [0.02, -0.01], 500)
    run = simulate(**(GOOD | {"steer": rows}), tire="linear")
    assert (run["front_steer"][0], run["rear_steer"][0]) == tuple(rows[0])
    run = simulate(**(GOOD | {"steer": lambda t: (0.1 * t, -0.1 * t)}), tire="linear")
    np.testing.assert_array_equal(run["front_steer"], 0.1 * run["time"])
    np.testing.assert_array_equal(run["rear_steer"], -0.1 * run["time"])


def test_the_inputs_are_left_alone():
    rows, start = np.full((500, 2), 0.01), {"yaw_rate": 0.1}
    simulate(**(GOOD | {"steer": rows}), initial_state=start, tire="linear")
    assert np.array_equal(rows, np.full((500, 2), 0.01))
    assert start == {"yaw_rate": 0.1}


def test_deterministic():
    same(simulate(**GOOD), simulate(**GOOD))


def test_defaults():
    same(simulate(**GOOD), simulate(**GOOD, tire="fiala", friction=1.0, geometry="exact", timestep=1e-3))
    same(simulate(**GOOD, tire="linear"), simulate(**GOOD, tire=tires.Linear(), geometry="small_angle"))
    same(simulate(**GOOD), simulate(**(GOOD | {"vehicle": vehicles["oversteer"]})))


def test_choices_matter():
    """Each argument reaches the equations."""
    base = simulate(**GOOD)["yaw_rate"][-1]
    for change in (
        {"vehicle": "understeer"},
        {"speed": 31.0},
        {"steer": (0.02, 0.0)},
        {"steer": (0.021, -0.01)},
        {"tire": "tanh"},
        {"tire": tires.MagicFormula(shape=1.5)},
        {"friction": 0.7},
        {"geometry": "small_angle"},
        {"initial_state": {"lateral_velocity": 0.5}},
        {"initial_state": {"yaw_rate": 0.1}},
    ):
        assert abs(simulate(**(GOOD | change))["yaw_rate"][-1] - base) > 1e-6, change


def test_an_initial_state_moves_the_path():
    start = {"longitudinal_position": 7.0, "lateral_position": -2.0, "heading": 0.3}
    base = simulate(**GOOD)
    run = simulate(**GOOD, initial_state=start)
    cosine, sine = math.cos(0.3), math.sin(0.3)
    x, y = base["longitudinal_position"], base["lateral_position"]
    np.testing.assert_allclose(run["longitudinal_position"], 7.0 + cosine * x - sine * y, rtol=1e-12)
    np.testing.assert_allclose(run["lateral_position"], -2.0 + sine * x + cosine * y, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(run["yaw_rate"], base["yaw_rate"], rtol=1e-12)


SPORTS = Vehicle(
    mass=1500.0,
    yaw_inertia=2500.0,
    cg_to_front=1.4,
    cg_to_rear=1.3,
    front_cornering_stiffness=110e3,
    rear_cornering_stiffness=90e3,
)


BAD = [
    ({"vehicle": "oversteerr"}, ValueError, r"vehicle must be one of .*did you mean 'oversteer'"),
    ({"vehicle": 3}, TypeError, "vehicle must be"),
    ({"vehicle": None}, TypeError, "vehicle must be"),
    ({"speed": 0.0}, ValueError, "speed must be"),
    ({"speed": -3.0}, ValueError, "speed must be"),
    ({"speed": math.nan}, ValueError, "speed must be"),
    ({"speed": math.inf}, ValueError, "speed must be"),
    ({"speed": "fast"}, TypeError, "speed must be"),
    ({"speed": True}, TypeError, "speed must be"),
    ({"duration": 0.0}, ValueError, "duration must be"),
    ({"duration": -1.0}, ValueError, "duration must be"),
    ({"duration": math.inf}, ValueError, "duration must be"),
    ({"duration": None}, TypeError, "duration must be"),
    ({"tire": "fiala2"}, ValueError, "tire must be one of .*did you mean 'fiala'"),
    ({"tire": 5}, TypeError, "tire must be"),
    ({"tire": tires.Fiala}, TypeError, "tire must be"),
    ({"friction": 0.0}, ValueError, "friction must be"),
    ({"friction": -0.5}, ValueError, "friction must be"),
    ({"friction": math.nan}, ValueError, "friction must be"),
    ({"friction": "icy"}, TypeError, "friction must be"),
    ({"geometry": "exakt"}, ValueError, "geometry must be one of .*did you mean 'exact'"),
    ({"geometry": 1}, TypeError, "geometry must be"),
    ({"timestep": 0.0}, ValueError, "timestep must be"),
    ({"timestep": -1e-3}, ValueError, "timestep must be"),
    ({"timestep": math.nan}, ValueError, "timestep must be"),
    ({"timestep": "short"}, TypeError, "timestep must be"),
    ({"steer": 0.1}, ValueError, "steer must be"),
    ({"steer": None}, ValueError, "steer must be"),
    ({"steer": "left"}, ValueError, "steer must be"),
    ({"steer": (0.1,)}, ValueError, r"steer must be .*got shape \(1,\)"),
    ({"steer": (0.1, 0.0, 0.0)}, ValueError, "steer must be"),
    ({"steer": np.zeros((499, 2))}, ValueError, r"steer must be .*steps = duration / timestep = 500.*\(499, 2\)"),
    ({"steer": np.zeros((2, 500))}, ValueError, "steer must be"),
    ({"steer": [[0.1, 0.0], [0.1]]}, ValueError, "steer must be"),
    ({"steer": (math.nan, 0.0)}, ValueError, "steer must be finite"),
    ({"steer": (0.0, math.inf)}, ValueError, "steer must be finite"),
    ({"steer": (1.6, 0.0)}, ValueError, r"steer must be finite angles in \(-pi/2, pi/2\)"),
    ({"steer": lambda t: 0.1}, ValueError, r"steer\(time\) must return a pair"),
    ({"steer": lambda t: None}, ValueError, r"steer\(time\) must return a pair"),
    ({"steer": lambda t: ("left", "right")}, ValueError, "steer"),
    ({"steer": lambda t: (0.1, 0.0) if t < 0.3 else (0.1,)}, ValueError, r"steer\(time\).* at time 0\.3 s"),
    ({"steer": lambda t: (math.nan, 0.0)}, ValueError, "steer must be finite"),
    ({"initial_state": {"yaw_rat": 0.1}}, ValueError, r"unknown state name 'yaw_rat'; did you mean 'yaw_rate'\?"),
    ({"initial_state": {"front_steer": 0.1}}, ValueError, "unknown state name 'front_steer'"),
    ({"initial_state": {"yaw_rate": math.nan}}, ValueError, r"initial_state\['yaw_rate'\] must be"),
    ({"initial_state": {"heading": "north"}}, TypeError, r"initial_state\['heading'\] must be"),
    ({"initial_state": [0.0, 0.1]}, (TypeError, ValueError), "initial_state|state name"),
    ({"initial_state": 3.0}, (TypeError, ValueError), "initial_state|state name"),
    ({"initial_state": ["yaw_rate"]}, (TypeError, ValueError), "initial_state|state name"),
]


@pytest.mark.parametrize(("keywords", "error", "named"), BAD)
def test_a_bad_argument_is_named(keywords, error, named):
    with pytest.raises(error, match=named):
        simulate(**(GOOD | keywords))


def test_an_unknown_keyword_is_refused():
    with pytest.raises(TypeError, match="fricton"):
        simulate(**GOOD, fricton=0.5)


def test_a_timestep_too_long_for_the_fastest_mode_is_refused_with_the_limit():
    with pytest.raises(ValueError, match=r"^timestep must be <= 0\.0\d+ s here, got 0\.1: the fastest mode"):
        simulate(SPORTS, 5.0, (0.0, 0.0), 1.0, timestep=0.1)
    # the longest that the message allows is accepted, and does not blow up
    run = simulate(SPORTS, 5.0, (0.02, 0.0), 20.0, tire="linear", timestep=0.04)
    assert np.all(np.abs(run["yaw_rate"]) < 1.0)
