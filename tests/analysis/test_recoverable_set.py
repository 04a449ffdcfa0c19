"""The recoverable set: no controller saves what is outside, its own steering saves what is inside, it converges."""

import math
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion

import bicycle_env
from bicycle_env import analysis, control, simulate, tires, vehicles
from bicycle_env.control.design.gains import continuous_gain

DATA = Path(__file__).parents[1] / "data"
CAR = vehicles["oversteer"]
SPEED = 1.3 * CAR.critical_speed
PUBLISHED = {"tire": "tanh", "friction": 0.9, "steer_limits": (0.1, 0.1)}
BOX = (0.4, 1.0)
NEIGHBOURS = np.ones((3, 3), dtype=bool)


def lqr_gain(speed=SPEED, sideslip=0.1, yaw_rate=0.1):
    weights = np.diag([1.0 / (sideslip * speed) ** 2, 1.0 / yaw_rate**2])
    a, b = analysis.state_matrix(CAR, speed), analysis.input_matrix(CAR, speed)
    return continuous_gain(a, b, weights, np.eye(2))[0]


@pytest.fixture(scope="module")
def plane():
    return analysis.recoverable_set(CAR, SPEED, **PUBLISHED, grid=(121, 121))


@pytest.fixture(scope="module")
def lane():
    return analysis.recoverable_set(CAR, SPEED, **PUBLISHED, lane=1.75, lane_grid=(41, 41, 21, 13))


def inside(found):
    return np.isfinite(found.least_time)


def test_the_share_of_the_prototype(plane):
    """73 to 75 % of |sideslip| <= 0.4, |yaw rate| <= 1 inside; a saturated LQR saves 72.9 %."""
    assert 0.73 <= plane.share(*BOX) <= 0.75
    assert plane.saved_share(lqr_gain(), *BOX) == pytest.approx(0.729, abs=0.01)


@pytest.mark.exhaustive
def test_refinement_converges(plane):
    shares = [analysis.recoverable_set(CAR, SPEED, **PUBLISHED, grid=(n, n)).share(*BOX) for n in (41, 81)] + [
        plane.share(*BOX)
    ]
    fine = analysis.recoverable_set(CAR, SPEED, **PUBLISHED, grid=(321, 321)).share(*BOX)
    assert abs(shares[-1] - fine) < 0.002
    assert abs(shares[0] - fine) < 0.02


@pytest.mark.exhaustive
def test_linear_feedback_saves_nothing_outside(plane):
    for gain in (lqr_gain(), 3.0 * lqr_gain(sideslip=0.02)):
        saved = plane.saved_by(gain)
        assert np.sum(saved) > 0.6 * np.sum(inside(plane))
        assert not np.any(saved & ~binary_dilation(inside(plane), NEIGHBOURS))


@pytest.mark.exhaustive
def test_its_own_steering_saves_what_is_inside(plane):
    """Replayed by `simulate`; including states that linear feedback loses."""
    core = binary_erosion(inside(plane), NEIGHBOURS)
    lost_by_lqr = np.argwhere(core & ~plane.saved_by(lqr_gain()))
    assert len(lost_by_lqr) > 0
    rng = np.random.default_rng(0)
    anywhere = np.argwhere(core)
    chosen = [*anywhere[rng.choice(len(anywhere), 4)], *lost_by_lqr[rng.choice(len(lost_by_lqr), 2)]]
    for i, j in chosen:
        run = plane.rescue(plane.lateral_velocity[i], plane.yaw_rate[j])
        assert plane.is_recovered(run["lateral_velocity"][-1], run["yaw_rate"][-1])
        assert np.max(np.abs(run["sideslip"])) <= plane.sideslip_limit
        assert np.max(np.abs(run["yaw_rate"])) <= plane.yaw_rate_limit
        assert np.max(np.abs(run["front_steer"])) <= 0.1
        assert np.max(np.abs(run["rear_steer"])) <= 0.1
        # Beside the edge the time is smeared with that of states outside: too long, never too short.
        assert run["time"][-1] <= 1.1 * plane.least_time[i, j] + 0.05


def test_extreme_steering_cannot_save_what_is_outside(plane):
    """Bang-bang steering with one switch, by `simulate`, from states two cells outside: all lost."""
    outside = np.argwhere(~binary_dilation(inside(plane), NEIGHBOURS, iterations=2))
    rng = np.random.default_rng(1)
    for i, j in outside[rng.choice(len(outside), 12)]:
        start = {"lateral_velocity": plane.lateral_velocity[i], "yaw_rate": plane.yaw_rate[j]}
        for front in (-0.1, 0.1):
            for rear in (-0.1, 0.1):
                for switch in (0.1, 0.3, 10.0):
                    steer = np.where(np.arange(200)[:, None] * 0.01 < switch, [front, rear], [-front, -rear])
                    run = simulate(CAR, SPEED, steer, 2.0, "tanh", 0.9, initial_state=start, timestep=0.01)
                    out = np.argmax(
                        (np.abs(run["sideslip"]) > 0.8) | (np.abs(run["yaw_rate"]) > 2.0) | (run["time"] >= 2.0)
                    )
                    there = (np.abs(run["sideslip"]) < 0.03) & (np.abs(run["yaw_rate"]) < 0.08)
                    assert not np.any(there[:out])


def test_mirror_symmetry(plane):
    np.testing.assert_allclose(plane.value, plane.value[::-1, ::-1], rtol=0.0, atol=1e-5)


@pytest.mark.exhaustive
def test_more_authority_more_grip_or_a_longer_horizon_saves_no_less(plane):
    small = {"grid": (81, 81)}
    base = analysis.recoverable_set(CAR, SPEED, "tanh", friction=0.6, steer_limits=(0.06, 0.03), **small)
    for more in (
        {"steer_limits": (0.1, 0.03)},
        {"steer_limits": (0.06, 0.06)},
        {"friction": 0.9},
        {"horizon": 8.0},
        {"sideslip_limit": 0.8, "yaw_rate_limit": 2.0},
    ):
        keywords = {"friction": 0.6, "steer_limits": (0.06, 0.03), **more}
        other = analysis.recoverable_set(CAR, SPEED, "tanh", **keywords, **small)
        assert other.share(*BOX) >= base.share(*BOX) - 1e-6, more


def test_one_axle_saves_less_than_two():
    shares = {
        steer: analysis.recoverable_set(CAR, SPEED, steer=steer, grid=(81, 81)).share(*BOX)
        for steer in ("front", "rear", "both")
    }
    assert shares["rear"] < shares["front"] < shares["both"]


def test_a_car_that_needs_no_help_is_saved_nearly_everywhere():
    """Far below any limit the goal is reached from the whole neighbourhood of straight running."""
    found = analysis.recoverable_set("understeer", 10.0, grid=(81, 81))
    assert found.share(0.3, 0.5) == 1.0


def test_without_steering_the_set_is_what_returns_by_itself():
    found = analysis.recoverable_set("understeer", 30.0, steer_limits=(0.0, 0.0), grid=(81, 81))
    free = found.saved_by(np.zeros((2, 2)))
    assert np.mean(free != inside(found)) < 0.01
    assert not np.any(free & ~binary_dilation(inside(found), NEIGHBOURS))


def test_contains_interpolates_and_broadcasts(plane):
    i, j = 60, 60
    assert plane.contains(plane.lateral_velocity[i], plane.yaw_rate[j])
    assert plane.contains(0.0, 0.0).shape == ()
    assert plane.contains(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4)
    assert not plane.contains(1.01 * plane.lateral_velocity[-1], 0.0)
    np.testing.assert_array_equal(
        plane.contains(plane.lateral_velocity[:, None], plane.yaw_rate[None, :]), inside(plane)
    )


@pytest.mark.parametrize("tire", sorted(tires.LAWS))
def test_every_tire(tire):
    found = analysis.recoverable_set(CAR, SPEED, tire, grid=(41, 41))
    assert 0.0 < found.share(*BOX) <= 1.0
    assert found.geometry == ("small_angle" if tire == "linear" else "exact")


@pytest.mark.exhaustive
def test_a_lane_saves_less(plane, lane):
    v, r = np.meshgrid(lane.lateral_velocity, lane.yaw_rate, indexing="ij")
    assert not np.any(lane.contains(v, r) & ~plane.contains(v, r))
    assert 0.3 < lane.share(*BOX) < plane.share(*BOX)
    wide = analysis.recoverable_set(CAR, SPEED, **PUBLISHED, lane=3.5, lane_grid=(31, 31, 17, 11))
    assert wide.share(*BOX) > lane.share(*BOX)


@pytest.mark.exhaustive
def test_the_lane_set_converges_within_two_hundredths(lane):
    coarse = analysis.recoverable_set(CAR, SPEED, **PUBLISHED, lane=1.75, lane_grid=(31, 31, 17, 11))
    assert abs(lane.share(*BOX) - coarse.share(*BOX)) < 0.02


@pytest.fixture(scope="module")
def bound_of_the_environment():
    """Of BicycleStab-v0, with its lane, angle limits and time."""
    plant = gym.make("BicycleStab-v0").unwrapped
    return analysis.recoverable_set(
        plant.vehicle,
        plant.speed,
        plant.tire,
        steer_limits=(plant.front_actuator.angle_limit, plant.rear_actuator.angle_limit),
        lane=1.75 + 0.5 * plant.vehicle.body_width,
        horizon=8.0,
        grid=(81, 81),
        lane_grid=(31, 31, 17, 11),
    )


def test_its_own_steering_keeps_the_lane(bound_of_the_environment):
    """From starts well inside: the least time has room and all neighbours are inside too."""
    bound = bound_of_the_environment
    v, r = np.meshgrid(np.linspace(-0.3, 0.3, 13) * bound.speed, np.linspace(-0.8, 0.8, 13), indexing="ij")
    starts = bound.contains(v, r, -v / bound.speed, 0.0)
    core = binary_erosion(starts, NEIGHBOURS)
    rng = np.random.default_rng(2)
    places = np.argwhere(core)
    for i, j in places[rng.choice(len(places), 6)]:
        run = bound.rescue(v[i, j], r[i, j], -v[i, j] / bound.speed, 0.0)
        last = [run[name][-1] for name in ("lateral_velocity", "yaw_rate", "heading", "lateral_position")]
        assert bound.is_recovered(*last)
        assert np.max(np.abs(run["lateral_position"])) <= bound.lane


@pytest.mark.parametrize("policy", ["lqr", "ppo_stab"])
def test_no_start_that_a_policy_saves_in_the_environment_lies_outside(bound_of_the_environment, policy):
    """LQR, and a policy that `make demo` trained (tests/data/ppo_stab); beyond half a cell of the edge."""
    bound = bound_of_the_environment
    env = gym.make("BicycleStab-v0", telemetry=True)
    plant = env.unwrapped
    driver = control.load(DATA / policy) if (DATA / policy).is_dir() else control.make(policy, plant)
    states, saved = [], []
    for seed in range(60):
        observation, _ = env.reset(seed=seed)
        state, over = plant.state, False
        while not over:
            observation, _, terminated, truncated, _ = env.step(driver.act(observation))
            over = terminated or truncated
        states.append((state.lateral_velocity, state.yaw_rate, state.heading, state.lateral_position))
        saved.append(plant.is_success)
    states, saved = np.array(states), np.array(saved)
    assert 0.5 < np.mean(saved) < 0.9
    half = 0.5 * np.array(bound.resolution)
    near = np.zeros(len(states), dtype=bool)
    for shift in np.ndindex(3, 3, 3, 3):
        v, r, heading, y = states.T + ((np.array(shift) - 1) * half)[:, None]
        near |= bound.contains(v, r, heading, y)
    assert not np.any(saved & ~near)
    assert np.mean(bound.contains(*states.T)) < 0.85, "a bound that says nothing"


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"speed": math.nan}, "speed"),
        ({"friction": -1.0}, "friction"),
        ({"steer": "front_wheels"}, "steer must be one of"),
        ({"steer_limits": (0.1, -0.1)}, r"steer_limits\[1\]"),
        ({"steer_limits": 0.1}, "steer_limits must be a pair"),
        ({"grid": (161,)}, "grid must be 2"),
        ({"grid": (161, 3)}, r"grid\[1\]"),
        ({"grid": (8, 8)}, "too coarse"),
        ({"sideslip_limit": 0.01}, "sideslip_limit"),
        ({"yaw_rate_limit": 0.0}, "yaw_rate_limit"),
        ({"horizon": 0.0}, "horizon"),
        ({"lane": -1.0}, "lane"),
        ({"lane": 1.75, "lane_grid": (41, 41)}, "lane_grid must be 4"),
        ({"vehicle": "oversteering"}, "did you mean 'oversteer'"),
        ({"tire": "brush"}, "tire must be one of"),
        ({"geometry": "round"}, "geometry"),
    ],
)
def test_bad_arguments_are_named(keywords, words):
    arguments = {"vehicle": "oversteer", "speed": 40.0, **keywords}
    with pytest.raises((ValueError, TypeError), match=words):
        analysis.recoverable_set(**arguments)


def test_bad_questions_are_named(plane, bound_of_the_environment):
    lane = bound_of_the_environment
    with pytest.raises(ValueError, match="yaw_rate must be finite"):
        plane.contains(0.0, math.nan)
    with pytest.raises(ValueError, match="belong to a set with a lane"):
        plane.contains(0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="both or neither"):
        lane.contains(0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match=r"gain must have shape \(2, 2\)"):
        plane.saved_by(np.zeros((2, 4)))
    with pytest.raises(ValueError, match=r"gain must have shape \(2, 4\)"):
        lane.saved_by(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="sideslip"):
        plane.share(-0.1, 1.0)


def test_it_is_public():
    assert bicycle_env.analysis.recoverable_set is analysis.recoverable_set
    assert isinstance(analysis.recoverable_set(CAR, SPEED, grid=(41, 41)), analysis.RecoverableSet)


def test_its_text_is_one_line():
    grid = np.zeros(3)
    common = {
        **{"vehicle": CAR, "speed": 40.0, "tire": tires.Tanh(), "geometry": "exact", "friction": 0.9},
        **{"steer_limits": (0.1, 0.1), "sideslip_limit": 0.5, "yaw_rate_limit": 1.0, "horizon": 2.0},
        **{"lateral_velocity": grid, "yaw_rate": grid, "course": None, "lateral_position": None},
        "steer_angles": np.zeros((1, 2)),
    }
    found = repr(analysis.RecoverableSet(**common, lane=None, value=np.zeros((401, 301))))
    assert found == (
        "RecoverableSet(vehicle='oversteer', speed=40, tire=Tanh(), friction=0.9, horizon=2, 401 x 301 nodes)"
    )
    assert "lane=1.75, 3 x 3 x 2 x 2 nodes" in repr(
        analysis.RecoverableSet(**common, lane=1.75, value=np.zeros((3, 3, 2, 2)))
    )


def test_recovered_is_what_the_documentation_says(plane):
    """|sideslip| < 0.03 rad and |yaw rate| < 0.08 rad/s."""
    for sideslip, yaw_rate, expected in (
        (0.0, 0.079, True),
        (0.0, -0.079, True),
        (0.0, 0.081, False),
        (0.0, -0.081, False),
        (0.029, 0.0, True),
        (-0.031, 0.0, False),
    ):
        assert plane.is_recovered(sideslip * SPEED, yaw_rate) == expected
