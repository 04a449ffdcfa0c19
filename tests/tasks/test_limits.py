"""Limits, tolerances and the road's width belong to a task: one of one's own says others, in every environment."""

import dataclasses
import math
import types

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import EnvSpec, registry

import bicycle_env
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.tasks.ends import Limits, Tolerances
from bicycle_env.tasks.episode import Reference, World
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.metrics import Run
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

ID = "Test/Strict-v0"
QUICK = {"tire": "linear", "geometry": "small_angle", "reward": "quadratic"}
CARS = 3
MANY = {"autoreset_mode": "Disabled", "on_invalid": "terminate"}


@dataclasses.dataclass(frozen=True)
class Strict(Stabilise):
    """Constants and two keywords."""

    episode_steps = 90
    tolerances = Tolerances(lateral=0.2, yaw_rate=0.03)
    limits: Limits = Limits(heading=0.5)  # noqa: RUF009 (frozen)
    road_half_width: float = 1.2


@pytest.fixture(autouse=True)
def registered():
    bicycle_env.register(ID, Strict)
    yield
    registry.pop(ID)


def worst(env, limits, half_width):
    """By hand, with the costs of BicycleStab-v0: the largest stage cost of a running episode."""
    lateral = 2.0 * half_width + 0.5 * env.vehicle.body_width
    return 0.25 * lateral**2 + 10.0 * (2.0 * limits.heading) ** 2 + 4.0 * limits.yaw_rate**2 + 0.1 + 0.1


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize(
    ("given", "limits", "half_width"),
    [
        ({}, Limits(heading=0.5), 1.2),
        only_all({"limits": Limits(yaw_rate=0.9)}, Limits(yaw_rate=0.9), 1.2),
        only_all({"road_half_width": 3, "action_delay": 1}, Limits(heading=0.5), 3.0),
    ],
)
@pytest.mark.parametrize(
    "start", [{"heading": 0.45, "yaw_rate": 0.7}, only_all({"lateral_position": 1.7, "heading": 0.3})]
)
def test_the_end_and_what_it_costs_follow_in_every_environment(given, limits, half_width, start):
    single, many = gym.make(ID, **QUICK, **given).unwrapped, gym.make_vec(ID, CARS, **QUICK, **given, **MANY)
    tensors = TorchVectorEnv(ID, CARS, **QUICK, **given, **MANY)
    edge = half_width + 0.5 * single.vehicle.body_width
    single.reset(seed=0, options={"state": start})
    many.reset(seed=0, options={"state": start})
    tensors.reset(seed=0, options={"state": start})
    for done in range(1, 90):
        before = single.state
        _, reward, terminated, _, info = single.step(np.zeros(2, np.float32))
        _, rewards, flags, _, infos = many.step(np.zeros((CARS, 2), np.float32))
        _, of_tensors, over, _, _ = tensors.step(torch.zeros(CARS, 2))
        state = single.state
        spun = abs(state.heading) > limits.heading or abs(state.yaw_rate) > limits.yaw_rate
        left = abs(state.lateral_position) > edge
        assert info["end"] == ("spun" if spun else "left_lane" if left else "")
        assert many.unwrapped.end_names[infos["end"][0]] == info["end"]
        assert flags.tolist() == over.tolist() == [terminated] * CARS == [spun or left] * CARS
        running = 0.25 * before.lateral_position**2 + 10.0 * before.heading**2 + 4.0 * before.yaw_rate**2
        forfeit = (90 - done) * worst(single, limits, half_width) if terminated else 0.0
        assert reward == pytest.approx(-running - forfeit, rel=1e-12)
        assert rewards.tolist() == [reward] * CARS
        np.testing.assert_allclose(of_tensors.numpy(), rewards, rtol=1e-12)
        if terminated:
            break
    assert terminated
    many.reset(seed=0)
    tensors.reset(seed=0)
    for envs in (many, tensors):
        wrong = np.full((CARS, 2), np.nan, np.float32)
        reward = np.asarray(envs.step(wrong if envs is many else torch.from_numpy(wrong))[1])
        np.testing.assert_allclose(reward, -90.0 * worst(single, limits, half_width), rtol=1e-12)


def test_the_tolerances_are_those_of_the_success_also_of_an_altered_task():
    goal, world = Reference(0.0, 0.0, 0.0, 0.0, 1.2), World(types.SimpleNamespace(speed=30.0), None, None)
    for task in (Strict(), altered(Strict(), action_delay=1)):
        assert task.tolerances == Strict.tolerances
        for y, yaw_rate, expected in ((0.19, 0.029, True), (0.21, 0.0, False), (0.0, 0.031, False)):
            assert task.success(PYTHON)(CarState(0.0, y, 0.0, 0.0, yaw_rate, 0.0, 0.0), goal, None, world) == expected


def test_the_settling_time_is_of_the_tasks_tolerance():
    class Coarse(LaneChange):
        tolerances = Tolerances(lateral=1.0)

    steps = {"goal_error": [-3.0, -0.8, 0.2], "time": [1.0, 2.0, 3.0], "change_start": [15.0] * 3}
    run = Run(
        {name: np.array(column) for name, column in steps.items()}, True, World(types.SimpleNamespace(speed=30.0), 0, 0)
    )
    times = [task.metrics[-1].law(run) for task in (LaneChange(), dataclasses.dataclass(frozen=True)(Coarse)())]
    assert times == [1.5, 0.5]


def test_the_road_of_the_lane_change_is_as_wide_as_its_task_says():
    class Shoulders(LaneChange):
        @property
        def road_half_width(self):
            return self.lane_width + 0.5

    law = dataclasses.dataclass(frozen=True)(Shoulders)(lane_width=3.0)
    world = World(None, None, law.settings(30.0))
    reference = law.reference(PYTHON)(CarState(*[0.0] * 7), law.TaskState(1.0, 15.0), world)
    assert (reference.goal, reference.road_centre, reference.road_half_width) == (3.0, 1.5, 3.5)


def test_the_plain_form_of_a_keyword_and_json():
    env = gym.make(ID, tire="linear", limits=Limits(yaw_rate=1.0))
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.task == env.unwrapped.task == Strict(Limits(yaw_rate=1.0))
    assert TorchVectorEnv(ID, 2, tire="linear", limits={"yaw_rate": 1.0}).task == env.unwrapped.task
    with pytest.raises(ValueError, match="field of limits 'yawrate'; did you mean 'yaw_rate'"):
        gym.make(ID, limits={"yawrate": 1.0})
    with pytest.raises(ValueError, match="limits: yaw_rate must be a finite number > 0, got -1"):
        gym.make(ID, limits={"yaw_rate": -1.0})


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: Limits(sideslip=0.0), ValueError, "^sideslip must be a finite number > 0, got 0"),
        (lambda: Limits(heading=math.inf), ValueError, "^heading must be a finite number > 0, got inf"),
        (lambda: Tolerances(lateral="wide"), TypeError, "^lateral must be a finite number > 0, got 'wide'"),
        (lambda: Tolerances(1.0, headin=0.1), TypeError, "keyword of Tolerances 'headin'; did you mean 'heading'"),
    ],
)
def test_what_is_no_limit_and_no_tolerance_is_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()
