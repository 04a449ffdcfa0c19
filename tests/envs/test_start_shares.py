"""How hard the default environments are: shares of seeded starts that a controller saves. Run with -s to see them."""

import itertools
import sys

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env.control import make

LENGTHS = {"BicycleStab-v0": 400, "BicycleLaneChange-v0": 300}


def drive(env, policy, observation, steps):
    """(success at the time-out, steps driven)."""
    for k in range(steps):
        observation, _, terminated, _, _ = env.step(policy.act(observation))
        if terminated:
            return False, k + 1
    return env.is_success, steps


def outcomes(env_id, name, starts):
    env = gym.make(env_id).unwrapped
    policy = make(name, env)
    driven = [drive(env, policy, env.reset(seed=seed)[0], LENGTHS[env_id]) for seed in range(starts)]
    share = float(np.mean([success for success, _ in driven]))
    sys.stdout.write(
        f"\n{env_id} {name}: {100 * share:.1f} % of {starts} starts; {min(n for _, n in driven)} steps at least\n"
    )
    return share, [steps for _, steps in driven]


@pytest.fixture(scope="module")
def uncontrolled():
    return outcomes("BicycleStab-v0", "zero", 500)


def test_no_start_is_over_within_half_a_second(uncontrolled):
    assert min(uncontrolled[1]) > 25


def test_no_corner_of_the_start_box_is_over_within_half_a_second():
    env = gym.make("BicycleStab-v0").unwrapped
    box = env.task.settings(env.speed)
    policy = make("zero", env)
    for y, course, sideslip, yaw_rate in itertools.product(*((-width, 0.0, width) for width in box)):
        state = {
            "lateral_position": y,
            "heading": course - sideslip,
            "lateral_velocity": sideslip * env.speed,
            "yaw_rate": yaw_rate,
        }
        observation, _ = env.reset(options={"state": state})
        assert drive(env, policy, observation, 25)[1] == 25
        assert env.end == ""


def test_almost_no_start_saves_itself(uncontrolled):
    assert uncontrolled[0] <= 0.05


def test_the_lqr_saves_about_half_of_the_starts():
    assert 0.4 <= outcomes("BicycleStab-v0", "lqr", 250)[0] <= 0.8


def test_the_lqr_changes_lanes():
    assert outcomes("BicycleLaneChange-v0", "lqr", 100)[0] >= 0.9


def test_doing_nothing_changes_no_lane():
    share, _ = outcomes("BicycleLaneChange-v0", "zero", 100)
    assert share == 0.0


def test_the_lqr_of_the_mirror_image_changes_no_lane():
    """It steers to the wrong side."""
    env = gym.make("BicycleLaneChange-v0").unwrapped
    policy = make("lqr", env)
    wins = 0
    for seed in range(20):
        observation, _ = env.reset(seed=seed)
        for _ in range(300):
            observation, _, terminated, _, _ = env.step(-policy.act(observation))
            if terminated:
                break
        else:
            wins += env.is_success
    assert wins == 0
