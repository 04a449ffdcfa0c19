"""The double lane change: its corridor, its path, what passes it and what does not."""

import dataclasses
import math
from types import MappingProxyType

import gymnasium as gym
import numpy as np
import pytest
import torch

import bicycle_env
from bicycle_env import control
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY, PYTHON
from bicycle_env.tasks.double_lane_change import COURSES, DoubleLaneChange, Side
from bicycle_env.tasks.ends import clearance
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.stabilise import Stabilise

ID = "BicycleDoubleLaneChange-v0"
every_course = pytest.mark.parametrize("course", COURSES)
SIDES = {"left": 1.0, "right": -1.0}


def made(course, **keywords):
    return gym.make(ID, course=course, **keywords).unwrapped


def world_of(env):
    return World(env.configuration.car, env.rules, env.configuration.settings)


def reference_at(env, x, side=1.0):
    zero = 0.0 * x
    return env.task.reference(NUMPY)(CarState(x, *[zero] * 6), Side(side), world_of(env))


@every_course
def test_a_body_on_the_path_keeps_a_tenth_of_a_metre_from_all_cones(course):
    env = made(course)
    cones, world = env.configuration.settings, world_of(env)
    x = np.arange(0.0, cones.end_5 + 10.0, 0.02)
    path = reference_at(env, x)
    zero = 0.0 * x
    state = CarState(x, path.lateral_position, path.heading, *[zero] * 4)
    episode = EpisodeState(zero, zero, zero, zero, Side(1.0))
    clear = clearance(NUMPY, env.task)(state, path, episode, world)
    in_a_lane = path.road_half_width < env.task.road_half_width
    assert 0.1 <= np.min(clear) == np.min(clear[in_a_lane]) < 0.13


@every_course
def test_the_path_is_smooth_and_meets_the_middles_of_all_lanes(course):
    env = made(course)
    cones = env.configuration.settings
    step = 0.005
    x = np.arange(0.0, cones.end_5 + 10.0, step)
    path = reference_at(env, x)
    for begin, end in ((cones.begin_1, cones.end_1), (cones.begin_3, cones.end_3), (cones.begin_5, cones.end_5)):
        inside = (x > begin) & (x < end)
        middle = path.road_centre[inside]
        assert np.all(middle == middle[0])
        assert np.min(abs(path.lateral_position[inside] - middle)) < 2e-3
    slope = np.gradient(path.lateral_position, step)
    np.testing.assert_allclose(np.tan(path.heading), slope, rtol=0.0, atol=1e-4)
    curvature = np.gradient(slope, step)
    assert np.max(abs(np.diff(curvature))) < 2e-4 * np.max(abs(curvature)) / step  # no jump of it
    assert path.lateral_position[-1] == pytest.approx(path.road_centre[x < cones.end_5][-1], abs=1e-12)


@every_course
@pytest.mark.parametrize("side", SIDES)
def test_a_corner_beyond_a_cone_ends_the_episode_and_one_between_the_lanes_does_not(course, side):
    env, sign = made(course), SIDES[side]
    cones, car = env.configuration.settings, env.configuration.car
    begin, end = cones.begin_3 - car.front_extent, cones.end_3 + car.rear_extent
    there = reference_at(env, np.array([cones.begin_3]), sign)
    beside = float(there.road_centre[0] + sign * (there.road_half_width[0] - 0.5 * car.body_width))  # bodies touch here
    law, episode = env.task.end(PYTHON), EpisodeState(0.0, 0.0, 0.0, 0.0, Side(sign))

    def ended(x, beyond):
        state = CarState(x, beside + sign * beyond, *[0.0] * 5)
        here = env.task.reference(PYTHON)(state, episode.task_state, world_of(env))
        return env.task.end_names[law(state, here, episode, world_of(env))]

    for x, inside in ((begin - 0.01, False), (begin + 0.01, True), (end - 0.01, True), (end + 0.01, False)):
        assert ended(x, 0.01) == ("left_course" if inside else "")
        assert ended(x, -0.01) == ""
        assert ended(x, 10.0) == "left_course"


@every_course
def test_success_is_to_have_passed_the_last_cone_with_the_whole_body(course):
    env = made(course)
    cones, car = env.configuration.settings, env.configuration.car
    law = env.task.success(PYTHON)
    for heading in (0.0, 0.3, -0.3):
        corner = car.rear_extent * math.cos(heading) + 0.5 * car.body_width * abs(math.sin(heading))
        for ahead, expected in ((-1e-9, False), (1e-9, True)):
            state = CarState(cones.end_5 + corner + ahead, 0.0, heading, *[0.0] * 4)
            assert bool(law(state, None, None, world_of(env))) is expected


@every_course
@pytest.mark.parametrize("side", SIDES)
def test_lqr_passes_at_the_default_speed_and_nobody_does_not(course, side):
    env = gym.make(ID, course=course, direction=side, telemetry=True)
    for name, passes in (("lqr", True), ("zero", False)):
        policy = control.make(name, env)
        observation, info = env.reset(seed=4)
        over = False
        while not over:
            assert not env.unwrapped.is_success or info["goal_error"] == pytest.approx(0.0, abs=1.0)
            observation, _, terminated, truncated, info = env.step(policy.act(observation))
            over = terminated or truncated
        assert env.unwrapped.is_success is passes
        assert info["end"] == ("" if passes else "left_course")
        assert info["cost"] == float(not passes)
        assert (info["clearance"] >= 0.0) is passes


def test_both_sides_are_drawn_and_one_can_be_asked_for():
    many = gym.make_vec(ID, 200)
    many.reset(seed=0)
    assert 70 < np.sum(many.unwrapped.state.direction == 1.0) < 130
    assert set(many.unwrapped.state.direction) == {1.0, -1.0}
    for side, sign in SIDES.items():
        assert np.all(reset_of(many, {"direction": side}).direction == sign)
        env = made("iso3888-1", direction=side)
        env.reset(seed=0)
        assert env.state.direction == sign


def reset_of(env, options):
    env.reset(seed=0, options=options)
    return env.unwrapped.state


@every_course
def test_torch_drives_the_same_manoeuvre(course):
    given = {"course": course, "autoreset_mode": "Disabled", "tire": "linear"}
    tensors, many = TorchVectorEnv(ID, 3, **given), gym.make_vec(ID, 3, **given)
    options = {"state": {"longitudinal_position": 20.0, "lateral_position": 0.05}, "direction": "left"}
    policy = control.make("lqr", gym.make(ID, course=course, tire="linear"))
    tensors.reset(seed=0, options=options)
    observation, _ = many.reset(seed=0, options=options)
    for _ in range(60):
        action = policy.act(observation)
        observation, reward, terminated, _, _ = many.step(action)
        mine = tensors.step(torch.from_numpy(action))
        assert np.array_equal(mine[2].numpy(), terminated)
        np.testing.assert_allclose(mine[1].numpy(), reward, rtol=1e-9)
        np.testing.assert_allclose(
            tensors.state.lateral_position.numpy(), many.unwrapped.state.lateral_position, rtol=1e-10
        )


def test_the_figures_of_an_episode():
    steps = {"clearance": np.array([0.5, 0.2, 3.0]), "yaw_rate": np.array([0.1, -0.4, 0.2])}
    run = bicycle_env.tasks.metrics.Run(steps, True, None)
    found = {metric.name: metric.law(run) for metric in DoubleLaneChange().metrics if metric.name in NEW}
    assert found == {"least_clearance": 0.2, "peak_yaw_rate": 0.4}


NEW = ("least_clearance", "peak_yaw_rate")


# A task's own defaults


@every_course
def test_the_speed_is_the_courses_unless_one_is_given(course):
    assert made(course).speed == COURSES[course].speed
    assert made(course, speed=12.0).speed == 12.0
    oversteering = made(course, vehicle="oversteer", speed_ratio=0.5)
    assert oversteering.speed == 0.5 * oversteering.vehicle.critical_speed
    assert np.all(gym.make_vec(ID, 3, course=course, friction=[0.5, 0.7, 1.0]).unwrapped.speed == COURSES[course].speed)


def test_the_car_is_the_tasks_unless_one_is_given():
    assert made("iso3888-1").vehicle == bicycle_env.vehicles["understeer"]
    assert made("iso3888-1", vehicle="civic").vehicle == bicycle_env.vehicles["civic"]
    assert gym.make_vec(ID, 2).unwrapped.vehicle == bicycle_env.vehicles["understeer"]
    assert TorchVectorEnv(ID, 2).vehicle == bicycle_env.vehicles["understeer"]


@dataclasses.dataclass(frozen=True)
class Town(Stabilise):
    defaults = MappingProxyType({"steer": "front", "vehicle": "civic"})
    usual_speed = 13.0


@dataclasses.dataclass(frozen=True)
class Misspelt(Stabilise):
    defaults = MappingProxyType({"vehicel": "civic"})


def test_a_task_of_ones_own_has_defaults_too():
    bicycle_env.register("Mine/Town-v0", Town)
    try:
        for env in (gym.make("Mine/Town-v0").unwrapped, gym.make_vec("Mine/Town-v0", 2).unwrapped):
            assert (env.speed, env.steer, env.vehicle.name) == (13.0, "front", "civic")
        assert gym.make("Mine/Town-v0", steer="rear", speed=20.0).unwrapped.speed == 20.0
    finally:
        gym.registry.pop("Mine/Town-v0")
    with pytest.raises(ValueError, match="default of the task Misspelt 'vehicel'; did you mean 'vehicle'"):
        bicycle_env.register("Mine/Misspelt-v0", Misspelt)
