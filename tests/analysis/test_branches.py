"""Branches of steady turns: folds by closed form and by an independent search, symmetry, completeness, simulation."""

import functools
import itertools
import math

import numpy as np
import pytest
from combinations import pairwise, some_of
from scipy.optimize import minimize_scalar

from bicycle_env import Vehicle, analysis, simulate, vehicles
from bicycle_env.analysis.continuation import SteerPlane, branch_through, changes
from bicycle_env.analysis.equilibria import RearBalance, root
from bicycle_env.analysis.nonlinear_model import NonlinearModel

GRAVITY = 9.81
OVERSTEER = vehicles["oversteer"]
CRITICAL = OVERSTEER.critical_speed


@functools.cache
def branches_at_25(tire):
    return analysis.equilibrium_branches("oversteer", 25.0, tire=tire, steer_limit=0.1)


def of_kind(branches, kind):
    return [found for branch in branches for found in branch.bifurcations if found.kind == kind]


def column(branch, input):
    return branch.front_steer if input == "front_steer" else branch.rear_steer


def count_at(branches, input, steer):
    """How often the branches pass a steer angle."""
    return sum(np.count_nonzero(np.diff(np.sign(column(branch, input) - steer))) for branch in branches)


# Folds


@pytest.mark.parametrize(
    ("input", "speed_ratio", "friction"), pairwise(["front_steer", "rear_steer"], [0.5, 0.8, 0.97], [1.0, 0.4])
)
def test_tanh_folds_are_the_closed_form(input, speed_ratio, friction):
    """Small angles: steer = (L mu g / U^2) (tanh x - q^2 x), q = speed / critical speed: its extremum is cosh x = 1/q.

    Rear steer is the same with the other sign.
    """
    speed = speed_ratio * CRITICAL
    branches = analysis.equilibrium_branches(
        "oversteer", speed, input, tire="tanh", friction=friction, geometry="small_angle", steer_limit=0.06
    )
    x = math.acosh(1.0 / speed_ratio)
    steer = 2.7 * friction * GRAVITY / speed**2 * (math.tanh(x) - speed_ratio**2 * x)
    folds = sorted(of_kind(branches, "fold"), key=lambda fold: fold.equilibrium.yaw_rate)
    assert len(folds) == 2
    for fold, sign in zip(folds, (-1.0, 1.0), strict=True):
        angle = fold.front_steer if input == "front_steer" else -fold.rear_steer
        assert angle == pytest.approx(sign * steer, abs=1e-13)
        assert fold.equilibrium.lateral_acceleration == pytest.approx(
            sign * friction * GRAVITY * math.tanh(x), abs=1e-9
        )


def fiala_fold(vehicle, speed, friction):
    """Steer and z of the fold in small angles, by maximising the steer over z = C tan(alpha) / (3 mu Fz)."""
    front = 3.0 * friction * vehicle.front_axle_load / vehicle.front_cornering_stiffness
    rear = 3.0 * friction * vehicle.rear_axle_load / vehicle.rear_cornering_stiffness

    def steer(z):
        turning = vehicle.wheelbase * friction * GRAVITY * (1.0 - (1.0 - z) ** 3) / speed**2
        return turning + math.atan(front * z) - math.atan(rear * z)

    best = minimize_scalar(lambda z: -steer(z), bounds=(0.0, 0.9), method="bounded", options={"xatol": 1e-12})
    return -best.fun, best.x


@pytest.mark.parametrize(("name", "ratio"), [("oversteer", 0.7), ("oversteer", 0.95), ("me303", 0.7)])
def test_fiala_folds_against_an_independent_search(name, ratio):
    vehicle = vehicles[name]
    speed = ratio * vehicle.critical_speed
    steer, z = fiala_fold(vehicle, speed, 0.8)
    branches = analysis.equilibrium_branches(name, speed, friction=0.8, geometry="small_angle", steer_limit=0.06)
    right, left = sorted(of_kind(branches, "fold"), key=lambda fold: fold.front_steer)
    assert left.front_steer == pytest.approx(steer, abs=1e-13)
    assert right.front_steer == pytest.approx(-steer, abs=1e-13)
    # the search finds a maximum to the root of the rounding unit
    assert left.equilibrium.yaw_rate * speed == pytest.approx(0.8 * GRAVITY * (1.0 - (1.0 - z) ** 3), rel=1e-6)


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
def test_a_fold_solves_the_extended_system(tire):
    """V' = r' = 0 and det J = 0; a stable turn and a saddle meet there (or two unstable turns)."""
    model = NonlinearModel("oversteer", 25.0, tire)
    branches = branches_at_25(tire)
    assert of_kind(branches, "fold")
    for branch in branches:
        for fold in branch.bifurcations:
            if fold.kind != "fold":
                continue
            state = fold.equilibrium.lateral_velocity, fold.equilibrium.yaw_rate
            steer = fold.front_steer, fold.rear_steer
            np.testing.assert_allclose(model.rates(*state, *steer), 0.0, atol=1e-12)
            jacobian = model.jacobians(*state, *steer).state
            assert abs(np.linalg.det(jacobian)) < 1e-10 * np.linalg.norm(jacobian) ** 2
            assert branch.kind[fold.row] == fold.equilibrium.kind == "degenerate"
            assert not branch.is_stable[fold.row]
            assert branch.front_steer[fold.row] == fold.front_steer
            neighbours = branch.kind[[fold.row - 1, fold.row + 1]]
            assert np.count_nonzero(neighbours == "saddle") == 1
            turns = np.sign(branch.front_steer[[fold.row - 1, fold.row + 1]] - fold.front_steer)
            assert turns[0] == turns[1]  # the branch comes back


def test_the_turn_is_lost_at_the_fold():
    """Steered a little less than the fold the simulated car settles in a turn before it; a little more and it spins."""
    folds = [fold for fold in of_kind(branches_at_25("fiala"), "fold") if fold.equilibrium.yaw_rate > 0.0]
    fold = min(folds, key=lambda fold: fold.equilibrium.yaw_rate)
    for share, lost in ((0.95, False), (1.05, True)):
        run = simulate("oversteer", 25.0, (share * fold.front_steer, 0.0), 20.0)
        assert (np.max(run["yaw_rate"]) > 1.3 * fold.equilibrium.yaw_rate) == lost
        assert (np.max(run["yaw_rate"]) < fold.equilibrium.yaw_rate) == (not lost)


def test_hopf_points_have_an_imaginary_pair():
    branches = branches_at_25("magic_formula")
    found = of_kind(branches, "hopf")
    assert len(found) == 4
    for hopf in found:
        values = hopf.equilibrium.eigenvalues
        assert np.max(np.abs(values.real)) < 1e-9
        assert np.min(np.abs(values.imag)) > 0.1
    for branch in branches:
        for hopf in branch.bifurcations:
            if hopf.kind == "hopf":
                assert set(branch.kind[[hopf.row - 1, hopf.row + 1]]) == {"stable focus", "unstable focus"}


# Branches as a whole


@pytest.mark.parametrize("input", ["front_steer", "rear_steer"])
def test_linear_tire_is_one_straight_line(input):
    (branch,) = analysis.equilibrium_branches(
        "understeer", 30.0, input, other_steer=0.01, tire="linear", steer_limit=0.1
    )
    other = {"front_steer": "rear_steer", "rear_steer": "front_steer"}[input]
    gains = [analysis.steady_state_gain(vehicles["understeer"], 30.0, name) for name in (input, other)]
    np.testing.assert_allclose(
        branch.yaw_rate, gains[0] * column(branch, input) + gains[1] * 0.01, rtol=1e-9, atol=1e-12
    )
    assert branch.bifurcations == ()
    assert np.all(branch.is_stable)
    assert branch.ends == ("steer limit", "steer limit")
    np.testing.assert_allclose(np.sort(column(branch, input)[[0, -1]]), [-0.1, 0.1], atol=1e-12)
    np.testing.assert_array_equal(column(branch, other), 0.01)


def test_arrays_and_their_shapes():
    for branch in branches_at_25("fiala"):
        n = len(branch.front_steer)
        for name in (
            "rear_steer",
            "lateral_velocity",
            "yaw_rate",
            "sideslip",
            "lateral_acceleration",
            "kind",
            "is_stable",
        ):
            assert getattr(branch, name).shape == (n,), name
        assert branch.eigenvalues.shape == (n, 2)
        np.testing.assert_array_equal(branch.sideslip, branch.lateral_velocity / 25.0)
        np.testing.assert_array_equal(branch.lateral_acceleration, branch.yaw_rate * 25.0)
        np.testing.assert_array_equal(branch.is_stable, np.char.startswith(branch.kind, "stable"))
        # a smooth line, each point on its own
        steps = np.diff(branch.front_steer) + 1j * np.diff(branch.sideslip)
        assert np.all((np.abs(steps) > 0.0) & (np.abs(steps) < 0.1))
        assert np.max(np.abs(np.angle(steps[1:] / steps[:-1]))) < 0.25


def test_understeering_car_has_one_stable_branch():
    (branch,) = analysis.equilibrium_branches("understeer", 30.0)
    assert np.all(branch.is_stable)
    assert np.all(np.diff(branch.front_steer) * np.sign(branch.front_steer[-1]) > 0.0)
    assert branch.bifurcations == ()


def test_above_the_critical_speed_the_branch_through_straight_running_is_unstable():
    branch = analysis.equilibrium_branches("oversteer", 1.2 * CRITICAL, steer_limit=0.05)[0]
    middle = np.argmin(np.abs(branch.front_steer) + np.abs(branch.yaw_rate))
    assert abs(branch.yaw_rate[middle]) < 1e-12
    assert branch.kind[middle] == "saddle"
    # steered to the left it turns to the right: the steady-state gain is negative
    assert (branch.yaw_rate[middle + 1] - branch.yaw_rate[middle - 1]) / (
        branch.front_steer[middle + 1] - branch.front_steer[middle - 1]
    ) == pytest.approx(analysis.steady_state_gain(OVERSTEER, 1.2 * CRITICAL), rel=0.02)


def test_folds_come_together_at_the_critical_speed():
    """The extent of the stable turns shrinks as (critical speed - speed)^(3/2): the pitchfork, seen along the steer."""
    steers = []
    for distance in (1e-2, 1e-3):
        (branch,) = analysis.equilibrium_branches(
            "oversteer", (1.0 - distance) * CRITICAL, tire="tanh", geometry="small_angle", steer_limit=0.05
        )
        steers.append(max(fold.front_steer for fold in branch.bifurcations))
    assert steers[0] / steers[1] == pytest.approx(10.0**1.5, rel=0.02)


def test_two_folds_close_to_each_other_are_both_found():
    """Coming from afar, with long steps, to the S that is left at 0.9999 of the critical speed."""
    model = NonlinearModel("oversteer", 0.9999 * CRITICAL, "tanh", 1.0, "small_angle")
    plane = SteerPlane(RearBalance(model), True, 0.0, 0.2, 1.0)
    start = np.array([3.0, 0.0])
    start[1] = root(lambda steer: plane.value(np.array([3.0, steer])), -3.0, 3.0)
    rows, _ = branch_through(plane, start)
    folds = changes(plane, rows, plane.determinant)
    assert len(folds) == 2
    expected = model.rear_slip_scale * math.acosh(1.0 / 0.9999)  # 0.014 slip scales on either side
    np.testing.assert_allclose([abs(x[0]) * plane.scale for _, x in folds], expected, rtol=1e-6)


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
def test_mirror_symmetry(tire):
    branches = branches_at_25(tire)
    for kind in ("fold", "hopf"):
        steers = np.sort([found.front_steer for found in of_kind(branches, kind)])
        np.testing.assert_allclose(steers, -steers[::-1], atol=1e-9)
    ends = sorted(round(steer, 6) for branch in branches for steer in branch.front_steer[[0, -1]])
    assert ends == sorted(-steer for steer in ends)


def test_a_short_branch_between_two_ends_in_full_sliding_is_found():
    """Slippery road, fast, both axles steered: all turns are within 0.02 rad of front = rear steer."""
    vehicle, other = vehicles["oversteer"], -0.0731
    (branch,) = analysis.equilibrium_branches(vehicle, 50.0, "rear_steer", other, friction=0.1, geometry="small_angle")
    assert branch.ends == ("full sliding", "full sliding")
    assert np.ptp(branch.rear_steer) < 0.02
    assert np.min(branch.rear_steer) < other < np.max(branch.rear_steer)
    assert set(branch.kind) == {"saddle"}


@pytest.mark.parametrize("seed", some_of(range(6), (0,)))
def test_branches_hold_exactly_the_equilibria(seed):
    """At random steer angles they pass as many turns as the search at that angle finds; all solve the equations."""
    rng = np.random.default_rng(seed)
    vehicle = Vehicle(
        mass=rng.uniform(800, 2500),
        yaw_inertia=rng.uniform(1000, 5000),
        cg_to_front=rng.uniform(0.9, 2.0),
        cg_to_rear=rng.uniform(0.9, 2.0),
        front_cornering_stiffness=rng.uniform(3e4, 2e5),
        rear_cornering_stiffness=rng.uniform(3e4, 2e5),
    )
    speed, friction = rng.uniform(8.0, 50.0), rng.choice([1.0, 0.5])
    tire = ("tanh", "fiala", "magic_formula", "fiala")[seed % 4]
    input, other = ("front_steer", "rear_steer")[seed // 2 % 2], rng.choice([0.0, 0.05])
    branches = analysis.equilibrium_branches(vehicle, speed, input, other, tire, friction)
    model = NonlinearModel(vehicle, speed, tire, friction)
    for branch in branches:
        rates = model.rates(branch.lateral_velocity, branch.yaw_rate, branch.front_steer, branch.rear_steer)
        np.testing.assert_allclose(rates, 0.0, atol=1e-10)
        assert np.all(np.abs(branch.sideslip) < 1.0 + 1e-9)
        assert np.all(np.abs(column(branch, input)) < 0.2 + 1e-9)
    for steer in rng.uniform(-0.2, 0.2, 4):
        pair = (steer, other) if input == "front_steer" else (other, steer)
        turns = analysis.equilibria(vehicle, speed, pair, tire, friction)
        assert count_at(branches, input, steer) == len(turns)
    for this, following in itertools.combinations(branches, 2):  # none twice
        ends = this.yaw_rate[len(this.yaw_rate) // 2], this.lateral_velocity[len(this.yaw_rate) // 2]
        apart = np.hypot(following.yaw_rate - ends[0], following.lateral_velocity - ends[1])
        assert np.min(apart) > 1e-9


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"vehicle": "oversteeer"}, "did you mean 'oversteer'"),
        ({"speed": 0.0}, "speed must be"),
        ({"input": "front"}, "input must be one of 'front_steer', 'rear_steer'"),
        ({"other_steer": 1.6}, "other_steer must be"),
        ({"steer_limit": 0.0}, "steer_limit must be"),
        ({"sideslip_limit": -1.0}, "sideslip_limit must be"),
        ({"friction": 0.0}, "friction must be"),
        ({"speed": CRITICAL, "tire": "linear"}, "speed must differ from the critical speed"),
    ],
)
def test_bad_input(keywords, message):
    with pytest.raises(ValueError, match=message):
        analysis.equilibrium_branches(**{"vehicle": "oversteer", "speed": 30.0} | keywords)
