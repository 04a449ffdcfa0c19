"""The phase portrait: field, trajectories, and manifolds that separate what `simulate` does on their two sides."""

import functools
import sys

import numpy as np
import pytest

from bicycle_env import analysis, simulate

BELOW, ABOVE = 30.0, 43.0  # of the oversteering car's critical speed of 36.06 m/s


@functools.cache
def portrait(name="oversteer", speed=BELOW, steer=(0.0, 0.0), tire="fiala", **keywords):
    return analysis.phase_portrait(name, speed, steer, tire, grid=(7, 5), trajectories=8, **keywords)


def stable_halves(result):
    return [half for half in result.manifolds if half.stability == "stable"]


def run_from(name, speed, steer, tire, state, duration):
    start = {"lateral_velocity": state[0], "yaw_rate": state[1]}
    return simulate(name, speed, steer, duration, tire=tire, initial_state=start)


def test_the_field_is_what_simulate_does():
    steer = (0.03, -0.01)
    result = portrait(steer=steer)
    assert result.lateral_velocity.shape == (7,)
    assert result.yaw_rate.shape == (5,)
    assert result.lateral_velocity_rate.shape == result.yaw_acceleration.shape == (5, 7)
    np.testing.assert_allclose(result.lateral_velocity[[0, -1]], [-0.4 * BELOW, 0.4 * BELOW])
    np.testing.assert_allclose(result.yaw_rate[[0, -1]], [-1.0, 1.0])
    for row, column in ((0, 0), (1, 5), (4, 2)):
        state = result.lateral_velocity[column], result.yaw_rate[row]
        run = run_from("oversteer", BELOW, steer, "fiala", state, 1e-3)
        rate = run["lateral_acceleration"][0] - BELOW * state[1]
        assert result.lateral_velocity_rate[row, column] == pytest.approx(rate, rel=1e-12)
        assert result.yaw_acceleration[row, column] == pytest.approx(run["yaw_acceleration"][0], rel=1e-12)


def test_trajectories_are_what_simulate_does():
    result = portrait()
    assert len(result.trajectories) == 8
    for orbit in result.trajectories:
        assert orbit.time.shape == orbit.lateral_velocity.shape == orbit.yaw_rate.shape
        assert orbit.time[0] == 0.0
        assert np.all(np.diff(orbit.time) > 0.0)
        assert orbit.time[-1] <= 4.0
        start = orbit.lateral_velocity[0], orbit.yaw_rate[0]
        run = run_from("oversteer", BELOW, (0.0, 0.0), "fiala", start, orbit.time[-1])
        assert orbit.lateral_velocity[-1] == pytest.approx(run["lateral_velocity"][-1], abs=1e-6)
        assert orbit.yaw_rate[-1] == pytest.approx(run["yaw_rate"][-1], abs=1e-7)


def test_trajectories_touch_the_edge_of_the_box_and_stay_inside():
    result = portrait()
    edges = set()
    for orbit in result.trajectories:
        share = np.maximum(np.abs(orbit.lateral_velocity) / (0.4 * BELOW), np.abs(orbit.yaw_rate))
        assert np.all(share <= 1.0 + 1e-9)
        on_edge = 0 if share[0] > 1.0 - 1e-9 else -1
        assert share[on_edge] == pytest.approx(1.0, abs=1e-9)
        edges.add((round(float(orbit.lateral_velocity[on_edge]), 6), round(float(orbit.yaw_rate[on_edge]), 6)))
        steps = np.hypot(np.diff(orbit.lateral_velocity) / (0.4 * BELOW), np.diff(orbit.yaw_rate))
        assert np.max(steps) < 0.03  # smooth lines
    assert len(edges) == 8


def test_equilibria_are_those_within_the_box():
    result = portrait()
    turns = analysis.equilibria("oversteer", BELOW)
    np.testing.assert_allclose([t.yaw_rate for t in result.equilibria], [t.yaw_rate for t in turns], atol=1e-12)
    assert [turn.kind for turn in result.equilibria] == ["saddle", "stable node", "saddle"]
    narrow = analysis.phase_portrait("oversteer", BELOW, yaw_rate_limit=0.1, grid=(2, 2), trajectories=0)
    assert [turn.kind for turn in narrow.equilibria] == ["stable node"]
    assert narrow.manifolds == narrow.trajectories == ()


@pytest.mark.parametrize(
    ("name", "speed", "steer", "tire"),
    [
        ("oversteer", BELOW, (0.0, 0.0), "fiala"),
        ("oversteer", ABOVE, (0.0, 0.0), "fiala"),
        ("understeer", BELOW, (0.03, 0.0), "magic_formula"),
    ],
)
def test_every_saddle_has_two_stable_and_two_unstable_halves(name, speed, steer, tire):
    result = portrait(name, speed, steer, tire)
    saddles = [turn for turn in result.equilibria if turn.kind == "saddle"]
    assert saddles
    for saddle in saddles:
        halves = [half for half in result.manifolds if half.saddle is saddle]
        assert sorted(half.stability for half in halves) == ["stable", "stable", "unstable", "unstable"]
        for half in halves:
            orbit = half.orbit
            assert (orbit.lateral_velocity[0], orbit.yaw_rate[0]) == (saddle.lateral_velocity, saddle.yaw_rate)
            assert np.all(np.diff(orbit.time[1:]) * (-1.0 if half.stability == "stable" else 1.0) > 0.0)
            # tangent to an eigenvector: the rate along the first points is the eigenvalue
            distance = np.hypot(orbit.lateral_velocity - saddle.lateral_velocity, orbit.yaw_rate - saddle.yaw_rate)
            near = (distance > 2e-5) & (distance < 1e-2)
            if np.count_nonzero(near) > 1:
                rate = np.polyfit(orbit.time[near], np.log(distance[near]), 1)[0]
                assert np.min(np.abs(saddle.eigenvalues.real - rate)) < 0.02 * abs(rate)


@pytest.mark.parametrize(("speed", "steer"), [(BELOW, (0.0, 0.0)), (ABOVE, (0.0, 0.0)), (ABOVE, (0.002, 0.0))])
def test_from_the_stable_manifold_the_car_comes_to_the_saddle(speed, steer):
    for half in stable_halves(portrait(speed=speed, steer=steer)):
        target = np.array([half.saddle.lateral_velocity / speed, half.saddle.yaw_rate])
        run = run_from(
            "oversteer", speed, steer, "fiala", (half.orbit.lateral_velocity[-1], half.orbit.yaw_rate[-1]), 4.0
        )
        distance = np.hypot(run["sideslip"] - target[0], run["yaw_rate"] - target[1])
        assert distance[0] > 0.2
        assert np.min(distance) < 1e-5  # then it is repelled


def beside(half, place, shift):
    """A state beside a point of a manifold, moved at a right angle by a share of the box."""
    box = np.array([12.0, 1.0])
    points = np.column_stack([half.orbit.lateral_velocity, half.orbit.yaw_rate]) / box
    k = int(place * (len(points) - 2))
    along = points[k + 1] - points[k]
    return (points[k] + shift * np.array([-along[1], along[0]]) / np.hypot(*along)) * box


@pytest.mark.parametrize("place", [0.5, 0.75, 1.0])
@pytest.mark.parametrize(
    ("name", "tire"), [("oversteer", "fiala"), ("oversteer", "tanh"), ("understeer", "magic_formula")]
)
def test_the_manifold_bounds_the_region_of_attraction(name, tire, place):
    """On one side the uncontrolled car comes back to straight running, on the other it does not."""
    halves = stable_halves(portrait(name, BELOW, tire=tire))
    assert len(halves) == 4
    for half in halves:
        fates = []
        for shift in (-2e-3, 2e-3):
            run = run_from(name, BELOW, (0.0, 0.0), tire, beside(half, place, shift), 15.0)
            fates.append(abs(run["sideslip"][-1]) < 0.01 and abs(run["yaw_rate"][-1]) < 0.01)
        assert sorted(fates) == [False, True]


@pytest.mark.parametrize("place", [0.5, 1.0])
def test_above_the_critical_speed_the_manifold_separates_spins_to_the_left_and_right(place):
    """Straight running is the saddle: beside its stable manifold the car spins, to one side or to the other."""
    for half in stable_halves(portrait(speed=ABOVE)):
        assert half.saddle.yaw_rate == 0.0
        spins = []
        for shift in (-1e-3, 1e-3):
            run = run_from("oversteer", ABOVE, (0.0, 0.0), "fiala", beside(half, place, shift), 25.0)
            assert abs(run["sideslip"][-1]) > 0.3
            spins.append(np.sign(run["yaw_rate"][-1]))
        assert sorted(spins) == [-1.0, 1.0]


def test_unstable_manifolds_lead_to_straight_running_or_out_of_the_box():
    for saddle in portrait().equilibria[::2]:
        ends = []
        for half in portrait().manifolds:
            if half.saddle is saddle and half.stability == "unstable":
                ends.append((abs(half.orbit.lateral_velocity[-1]) / BELOW, abs(half.orbit.yaw_rate[-1])))
        inner, outer = sorted(ends)
        assert max(inner) < 1e-6
        assert outer[0] == pytest.approx(0.4, abs=1e-9)


def test_manifolds_do_not_depend_on_the_offset(monkeypatch):
    module = sys.modules["bicycle_env.analysis.phase_plane"]
    reference = portrait()
    monkeypatch.setattr(module, "OFFSET", 1e-6)
    closer = analysis.phase_portrait("oversteer", BELOW, grid=(2, 2), trajectories=0)
    for one, other in zip(stable_halves(reference), stable_halves(closer), strict=True):
        assert one.orbit.lateral_velocity[-1] == pytest.approx(other.orbit.lateral_velocity[-1], abs=1e-6)
        assert one.orbit.yaw_rate[-1] == pytest.approx(other.orbit.yaw_rate[-1], abs=1e-7)


def test_mirror_symmetry():
    result = portrait()
    np.testing.assert_array_equal(result.yaw_acceleration, -result.yaw_acceleration[::-1, ::-1])
    ends = np.array([(half.orbit.lateral_velocity[-1], half.orbit.yaw_rate[-1]) for half in stable_halves(result)])
    for end in ends:
        assert np.min(np.max(np.abs(ends + end), axis=1)) < 1e-6


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"vehicle": "oversteeer"}, "did you mean 'oversteer'"),
        ({"speed": 0.0}, "speed must be"),
        ({"sideslip_limit": 0.0}, "sideslip_limit must be"),
        ({"yaw_rate_limit": -1.0}, "yaw_rate_limit must be"),
        ({"grid": (1, 41)}, r"grid\[0\] must be"),
        ({"grid": 41}, "grid must be two whole numbers"),
        ({"trajectories": -1}, "trajectories must be"),
        ({"duration": 0.0}, "duration must be"),
        ({"steer": (2.0, 0.0)}, "steer must be a pair"),
    ],
)
def test_bad_input(keywords, message):
    with pytest.raises(ValueError, match=message):
        analysis.phase_portrait(**{"vehicle": "oversteer", "speed": 30.0} | keywords)
