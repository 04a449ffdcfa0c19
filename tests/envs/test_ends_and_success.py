"""How episodes end, and when one counts as a success."""

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import vehicles
from bicycle_env.wrappers import RecordSuccess

STILL = np.zeros(2, np.float32)
STABLE = {"vehicle": "understeer", "speed": 20.0}
HALF_BODY = 0.5 * vehicles["oversteer"].body_width


def first_step(env_id, state, **options):
    env = gym.make(env_id)
    env.reset(seed=0, options={"state": state, **options})
    _, _, terminated, truncated, info = env.step(STILL)
    assert not truncated
    assert terminated is (info["end"] != "")
    return info["end"]


def speed():
    return gym.make("BicycleStab-v0").unwrapped.speed


@pytest.mark.parametrize("env_id", ["BicycleStab-v0", "BicycleLaneChange-v0"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_spun(env_id, sign):
    assert first_step(env_id, {"heading": sign * 1.201}) == "spun"
    assert first_step(env_id, {"heading": sign * 1.199}) == ""
    assert first_step(env_id, {"yaw_rate": sign * 2.3}) == "spun"
    assert first_step(env_id, {"yaw_rate": sign * 1.8}) == ""
    assert first_step(env_id, {"lateral_velocity": sign * 0.9 * speed()}) == "spun"
    # Not at once; a little later, the side forces have turned it further.
    assert first_step(env_id, {"lateral_velocity": sign * 0.75 * speed(), "heading": -sign * 0.5}) == ""


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_left_lane(sign):
    edge = 1.75 + HALF_BODY
    assert first_step("BicycleStab-v0", {"lateral_position": sign * (edge + 1e-9)}) == "left_lane"
    assert first_step("BicycleStab-v0", {"lateral_position": sign * (edge - 1e-9)}) == ""


@pytest.mark.parametrize(("direction", "sign"), [("left", 1.0), ("right", -1.0)])
def test_left_road(direction, sign):
    far, near = 1.5 * 3.5 + HALF_BODY, -0.5 * 3.5 - HALF_BODY
    for y, end in ((far + 1e-9, "left_road"), (far - 1e-9, ""), (near - 1e-9, "left_road"), (near + 1e-9, "")):
        assert first_step("BicycleLaneChange-v0", {"lateral_position": sign * y}, direction=direction) == end


def test_the_lane_width_moves_the_edges_of_the_road():
    env = gym.make("BicycleLaneChange-v0", lane_width=5.0, direction="left")
    for y, end in ((7.5 + HALF_BODY + 1e-9, "left_road"), (7.5 + HALF_BODY - 1e-9, "")):
        env.reset(options={"state": {"lateral_position": y}})
        assert env.step(STILL)[4]["end"] == end


def test_a_spin_is_named_before_the_lane():
    assert first_step("BicycleStab-v0", {"lateral_position": 5.0, "heading": 1.3}) == "spun"


def test_a_car_left_alone_spins_and_one_below_the_critical_speed_does_not():
    ends = {}
    for ratio in (1.2, 0.8):
        env = gym.make("BicycleStab-v0", speed_ratio=ratio)
        env.reset(options={"state": {"yaw_rate": 0.02}})
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(STILL)
            over = terminated or truncated
        ends[ratio] = info["end"], env.unwrapped.state.yaw_rate
    assert ends[1.2][0] != ""
    assert abs(ends[1.2][1]) > 0.04
    assert abs(ends[0.8][1]) < 0.02


# Success


def settle(env, steps):
    return [(env.step(STILL), env.unwrapped.is_success)[1] for _ in range(steps)]


def test_a_second_of_rest_is_needed():
    env = gym.make("BicycleStab-v0", **STABLE)
    env.reset(options={"state": {}})
    assert env.unwrapped.is_success is False
    told = settle(env, 60)
    assert told == [False] * 49 + [True] * 11


@pytest.mark.parametrize("control_timestep", [0.01, 0.05, 0.1])
def test_a_second_is_a_second_at_every_control_timestep(control_timestep):
    env = gym.make("BicycleStab-v0", control_timestep=control_timestep, physics_timestep=0.005, **STABLE)
    env.reset(options={"state": {}})
    needed = round(1.0 / control_timestep)
    assert settle(env, needed + 3) == [False] * (needed - 1) + [True] * 4


def test_even_with_long_control_steps_a_success_needs_a_settled_step():
    env = gym.make("BicycleStab-v0", control_timestep=2.5, physics_timestep=0.005, **STABLE)
    env.reset(options={"state": {"lateral_position": 1.0}})
    assert not env.unwrapped.is_success
    env.step(STILL)
    assert not env.unwrapped.is_success


@pytest.mark.parametrize("env_id", ["BicycleStab-v0", "BicycleLaneChange-v0"])
def test_straight_running_at_the_goal_is_a_success_at_the_time_out(env_id):
    goal = {"lateral_position": 3.5} if "Lane" in env_id else {}
    options = {"state": goal, "direction": "left"} if "Lane" in env_id else {"state": goal}
    env = gym.make(env_id, **STABLE)
    _, info = env.reset(options=options)
    assert info["is_success"] is False
    truncated = False
    while not truncated:
        _, _, terminated, truncated, info = env.step(STILL)
        assert not terminated
    assert env.unwrapped.is_success is True
    assert info["is_success"] is True


@pytest.mark.parametrize(
    ("state", "success"),
    [
        ({"lateral_position": 0.49}, True),
        ({"lateral_position": -0.49}, True),
        ({"lateral_position": 0.51}, False),
        ({"lateral_position": -0.51}, False),
    ],
)
def test_the_lateral_tolerance_of_stab(state, success):
    env = gym.make("BicycleStab-v0", **STABLE)
    env.reset(options={"state": state})
    assert settle(env, 60)[-1] is success


@pytest.mark.parametrize(("y", "success"), [(3.79, True), (3.21, True), (3.81, False), (3.19, False), (0.0, False)])
@pytest.mark.parametrize(("direction", "sign"), [("left", 1.0), ("right", -1.0)])
def test_the_lateral_tolerance_of_the_lane_change(direction, sign, y, success):
    env = gym.make("BicycleLaneChange-v0", **STABLE)
    env.reset(options={"state": {"lateral_position": sign * y}, "direction": direction})
    assert settle(env, 60)[-1] is success


def test_the_wrong_neighbouring_lane_is_no_success():
    env = gym.make("BicycleLaneChange-v0", **STABLE)
    env.reset(options={"state": {"lateral_position": -1.0}, "direction": "right"})
    assert settle(env, 60)[-1] is False


@pytest.mark.parametrize(("name", "value"), [("heading", 0.021), ("lateral_velocity", 0.5), ("yaw_rate", 0.06)])
def test_each_tolerance_interrupts_the_second(name, value):
    """With a control step so short that the deviation is still there after it."""
    env = gym.make("BicycleStab-v0", control_timestep=0.002, physics_timestep=0.002, **STABLE)
    plant = env.unwrapped
    tolerance = {"heading": 0.02, "lateral_velocity": 0.02 * 20.0, "yaw_rate": 0.05}[name]
    env.reset(options={"state": {name: value}})
    told = settle(env, 1)
    assert abs(getattr(plant.state, name)) > tolerance, "the deviation has gone: the test tests nothing"
    told += settle(env, 499)
    assert told[-1] is False, "499 settled steps and one that was not"
    if name != "heading":  # which stays
        while abs(getattr(plant.state, name)) > 0.2 * tolerance:
            env.step(STILL)
        assert settle(env, 500)[-1] is True
    env.reset(options={"state": {name: 0.9 * tolerance}})
    env.step(STILL)
    assert abs(getattr(plant.state, name)) < tolerance


def test_a_disturbance_in_the_last_second_is_no_success():
    env = gym.make("BicycleStab-v0", **STABLE)
    env.reset(options={"state": {}})
    assert settle(env, 100)[-1] is True
    for _ in range(10):
        env.step(np.array([1.0, 0.0], np.float32))
    assert env.unwrapped.is_success is False


def test_an_episode_that_has_ended_is_no_success():
    env = gym.make("BicycleStab-v0").unwrapped
    env.reset(options={"state": {}})
    assert settle(env, 60)[-1] is True
    terminated = False
    while not terminated:
        terminated = env.step(np.array([1.0, -1.0], np.float32))[2]
    assert env.is_success is False


def test_a_reset_forgets_the_last_success():
    env = gym.make("BicycleStab-v0", **STABLE)
    env.reset(options={"state": {}})
    assert settle(env, 60)[-1] is True
    env.reset(options={"state": {}})
    assert env.unwrapped.is_success is False
    assert settle(env, 49)[-1] is False


@pytest.mark.parametrize("telemetry", [False, True])
def test_info_tells_it_in_every_step(telemetry):
    env = gym.make("BicycleStab-v0", telemetry=telemetry, **STABLE)
    _, info = env.reset(options={"state": {}})
    assert info["is_success"] is False
    told = [env.step(STILL)[4]["is_success"] for _ in range(60)]
    assert told == [False] * 49 + [True] * 11
    assert all(type(value) is bool for value in told)
    assert env.reset(options={"state": {}})[1]["is_success"] is False


def test_record_success_is_no_longer_needed():
    with pytest.warns(DeprecationWarning, match="RecordSuccess is deprecated: info has is_success without it"):
        env = RecordSuccess(gym.make("BicycleStab-v0", **STABLE))
    assert env.reset(seed=0)[1] == env.env.reset(seed=0)[1]
    assert env.step(STILL)[4].keys() == env.env.step(STILL)[4].keys()


def test_render_without_a_mode_warns():
    env = gym.make("BicycleStab-v0").unwrapped
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


def test_rendering_before_the_first_reset_raises():
    with pytest.raises(gym.error.ResetNeeded):
        gym.make("BicycleStab-v0", render_mode="rgb_array").unwrapped.render()


def test_closing_twice_is_fine():
    env = gym.make("BicycleStab-v0")
    env.reset(seed=0)
    env.close()
    env.close()
