"""The lane-change path, seen through the public side of the environment."""

import math

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all

import bicycle_env  # noqa: F401  (registers the environments)

ID = "BicycleLaneChange-v0"
LANE = 3.5
BEGIN = 1.0  # s


@pytest.fixture(scope="module")
def env():
    return gym.make(ID).unwrapped


def path(env, x, direction="left", start=BEGIN):
    """(lateral position, heading, goal, road centre) of the reference at a longitudinal position."""
    env.reset(options={"state": {"longitudinal_position": x}, "direction": direction, "change_start": start})
    measured = env.measure()
    names = ("lateral_position", "heading", "goal", "road_centre")
    return tuple(measured[f"reference_{name}"] for name in names)


def at(env, share, direction="left"):
    """The path at a share of the change."""
    return path(env, env.speed * (BEGIN + 1.5 * share), direction)


def test_the_ends_and_the_middle(env):
    assert at(env, 0.0)[:2] == pytest.approx((0.0, 0.0), abs=1e-12)
    assert at(env, 1.0)[:2] == pytest.approx((LANE, 0.0), abs=1e-12)
    y, heading = at(env, 0.5)[:2]
    assert y == pytest.approx(LANE / 2.0, abs=1e-12)
    assert heading == pytest.approx(math.atan(1.875 * LANE / (1.5 * env.speed)), abs=1e-12)


def test_it_is_flat_before_and_after(env):
    for share in (-2.0, -0.5, -1e-6):
        assert at(env, share)[:2] == (0.0, 0.0)
    for share in (1.0 + 1e-6, 1.5, 5.0):
        assert at(env, share)[:2] == pytest.approx((LANE, 0.0), abs=1e-14)
        assert at(env, share)[1] == 0.0


def test_it_is_the_quintic(env):
    for s in np.linspace(0.0, 1.0, 41):
        assert at(env, s)[0] == pytest.approx(LANE * (10 * s**3 - 15 * s**4 + 6 * s**5), abs=1e-12)


def test_slope_and_curvature_vanish_at_both_ends(env):
    """s^3 beside the ends: a difference over h is of the order h^2, a second difference of the order h."""
    for end, sign in ((0.0, 1.0), (1.0, -1.0)):
        h = 1e-4
        y = [at(env, end + sign * k * h)[0] for k in range(3)]
        assert abs(y[1] - y[0]) / h < 20 * LANE * h**2
        assert abs(y[2] - 2 * y[1] + y[0]) / h**2 < 100 * LANE * h
    inside = [at(env, 0.2 + k * 1e-4)[0] for k in range(3)]
    assert abs(inside[1] - inside[0]) / 1e-4 > 1.0
    assert abs(inside[2] - 2 * inside[1] + inside[0]) / 1e-8 > 1.0


def test_the_heading_is_the_direction_of_the_path(env):
    for share in (0.1, 0.35, 0.5, 0.8):
        h = 1e-4
        ahead, behind = at(env, share + h)[0], at(env, share - h)[0]
        slope = (ahead - behind) / (2 * h * 1.5 * env.speed)
        assert at(env, share)[1] == pytest.approx(math.atan(slope), abs=1e-7)


def test_it_rises_all_the_way_and_is_point_symmetric(env):
    y = [at(env, share)[0] for share in np.linspace(0.0, 1.0, 101)]
    assert np.all(np.diff(y) > 0.0)
    np.testing.assert_allclose(np.array(y) + np.array(y)[::-1], LANE, atol=1e-12)


def test_the_mirror_image(env):
    for share in (-1.0, 0.0, 0.2, 0.5, 0.9, 2.0):
        assert at(env, share, "right") == tuple(-value for value in at(env, share, "left"))


def test_the_goal_and_the_middle_of_the_road(env):
    assert at(env, 0.3, "left")[2:] == (LANE, LANE / 2)
    assert at(env, 0.3, "right")[2:] == (-LANE, -LANE / 2)


# Keywords


def rollout(**keywords):
    env = gym.make(ID, **keywords)
    rng = np.random.default_rng(1)
    seen = [env.reset(seed=4)[0]]
    for _ in range(60):
        observation, reward, terminated, _, _ = env.step(rng.uniform(-0.4, 0.4, 2))
        seen.append(np.append(observation, reward))
        if terminated:
            break
    assert len(seen) > 30
    return seen


def same(one, other):
    return len(one) == len(other) and all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_length_is_speed_times_duration():
    speed = gym.make(ID).unwrapped.speed
    assert same(rollout(duration=2.0), rollout(length=2.0 * speed))
    assert same(rollout(), rollout(duration=1.5))
    assert not same(rollout(), rollout(duration=2.0))


def test_the_change_takes_the_length_of_road_that_was_asked_for():
    env = gym.make(ID, length=80.0, lane_width=3.0).unwrapped
    begin = env.speed * BEGIN
    assert path(env, begin + 80.0)[0] == pytest.approx(3.0, abs=1e-12)
    assert path(env, begin + 79.0)[0] < 3.0 - 1e-6
    assert path(env, begin + 40.0)[0] == pytest.approx(1.5, abs=1e-12)


@pytest.mark.parametrize(("direction", "sides"), [("left", {1.0}), ("right", {-1.0}), ("random", {-1.0, 1.0})])
def test_the_direction_keyword(direction, sides):
    env = gym.make(ID, direction=direction).unwrapped
    env.reset(seed=0)
    seen = set()
    for _ in range(40):
        env.reset()
        seen.add(env.state.direction)
    assert seen == sides


def test_the_change_start_keyword_and_its_option():
    env = gym.make(ID, change_start=0.8).unwrapped
    for seed in range(5):
        env.reset(seed=seed)
        assert env.state.change_start == pytest.approx(0.8 * env.speed, rel=1e-14)
    env.reset(options={"change_start": 2.0})
    assert env.state.change_start == pytest.approx(2.0 * env.speed, rel=1e-14)
    env.reset()
    assert env.state.change_start == pytest.approx(0.8 * env.speed, rel=1e-14)


# Preview


def expected_preview(env, time):
    state = env.state
    s = (state.longitudinal_position + env.speed * time - state.change_start) / (1.5 * env.speed)
    s = min(max(s, 0.0), 1.0)
    return state.direction * LANE * (10 * s**3 - 15 * s**4 + 6 * s**5) - state.lateral_position


def test_the_preview_is_the_path_ahead_minus_the_car():
    env = gym.make(ID).unwrapped
    largest = 0.0
    for seed in range(6):
        observation, _ = env.reset(seed=seed)
        for _ in range(60):
            expected = [expected_preview(env, 0.1 * (k + 1)) for k in range(12)]
            np.testing.assert_allclose(observation[10:], expected, rtol=1e-6, atol=1e-6)
            largest = max(largest, *map(abs, expected))
            observation, _, terminated, _, _ = env.step(np.zeros(2))
            if terminated:
                break
    assert largest > 3.0


def test_the_preview_sees_the_change_come():
    env = gym.make(ID).unwrapped
    observation, _ = env.reset(options={"state": {}, "direction": "left", "change_start": 0.55})
    preview = observation[10:]
    assert np.all(preview[:5] == 0.0)
    assert np.all(np.diff(preview[5:]) > 0.0)
    observation, _ = env.reset(options={"state": {}, "direction": "left", "change_start": 5.0})
    assert np.all(observation == 0.0)


def test_the_errors_in_the_observation():
    env = gym.make(ID, telemetry=True).unwrapped
    observation, info = env.reset(seed=3)
    for _ in range(60):
        assert observation[8] == pytest.approx(info["lateral_error"], abs=1e-6)
        assert observation[9] == pytest.approx(info["heading_error"] / 0.2, abs=1e-6)
        observation, _, terminated, _, info = env.step(np.array([0.1, 0.0]))
        if terminated:
            break
    assert abs(info["lateral_error"]) > 0.1


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize(
    ("length", "spacing", "names"),
    [
        (0.0, 0.1, []),
        (0.05, 0.1, []),
        only_all(1.0, 0.2, ["0.2", "0.4", "0.6", "0.8", "1"]),
        only_all(0.3, 0.1, ["0.1", "0.2", "0.3"]),
        only_all(0.7, 0.1, ["0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7"]),
        (0.39, 0.1, ["0.1", "0.2", "0.3"]),
        only_all(2, 1, ["1", "2"]),
    ],
)
def test_the_length_and_the_spacing_of_the_preview(length, spacing, names):
    env = gym.make(ID, preview_length=length, preview_spacing=spacing).unwrapped
    assert env.observation_names[10:] == tuple(f"preview_{name}s" for name in names)
    assert env.observation_space.shape == (10 + len(names),)
    observation, _ = env.reset(seed=5)
    expected = [expected_preview(env, spacing * (k + 1)) for k in range(len(names))]
    np.testing.assert_allclose(observation[10:], expected, rtol=1e-6, atol=1e-6)


def test_the_preview_does_not_change_the_car():
    env, blind = gym.make(ID), gym.make(ID, preview_length=0.0)
    env.reset(seed=6)
    blind.reset(seed=6)
    for _ in range(20):
        one, other = env.step(np.array([0.2, 0.3])), blind.step(np.array([0.2, 0.3]))
        assert np.array_equal(one[0][:10], other[0])
        assert one[1:] == other[1:]
