"""The laws of an episode's end, on numbers: each limit and tolerance on both sides of zero."""

import dataclasses
import math

import gymnasium as gym
import numpy as np
import pytest
import torch

import bicycle_env
from bicycle_env import vehicles
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.tasks.ends import LEFT, RUNNING, SPUN, Limits, Tolerances, clearance, end_code, settled
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.stabilise import Nothing, Stabilise

SPEED = 30.0
GOAL = Reference(lateral_position=2.0, heading=0.0, goal=2.0, road_centre=1.0, road_half_width=3.5)
WORLD = World(car_on_road(vehicles["oversteer"], SPEED, 1.0, FRONT, REAR), None, None)
REST = CarState(0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
END = end_code(PYTHON, Limits(sideslip=0.7, yaw_rate=1.9, heading=1.1))
SETTLED = settled(PYTHON, Tolerances(lateral=0.4, heading=0.01, sideslip=0.03, yaw_rate=0.06))
TOLERANCES = {"lateral_position": 0.4, "heading": 0.01, "lateral_velocity": 0.03 * SPEED, "yaw_rate": 0.06}
LIMITS = {
    "lateral_position": (GOAL.road_half_width + 0.5 * WORLD.car.body_width, LEFT),
    "heading": (1.1, SPUN),
    "lateral_velocity": (0.7 * SPEED, SPUN),
    "yaw_rate": (1.9, SPUN),
}
SIDES = pytest.mark.parametrize("side", [-1.0, 1.0], ids=["right", "left"])


@SIDES
@pytest.mark.parametrize("name", TOLERANCES)
def test_a_car_is_settled_within_each_tolerance_on_both_sides(name, side):
    assert SETTLED(REST, GOAL, None, WORLD)
    for share, expected in ((0.0, True), (0.999, True), (1.001, False), (50.0, False)):
        away = getattr(REST, name) + side * share * TOLERANCES[name]
        assert SETTLED(REST._replace(**{name: away}), GOAL, None, WORLD) == expected, (name, away)


@SIDES
@pytest.mark.parametrize("name", LIMITS)
def test_an_episode_ends_beyond_each_limit_on_both_sides(name, side):
    limit, end = LIMITS[name]
    middle = GOAL.road_centre if name == "lateral_position" else 0.0
    for share, expected in ((0.0, RUNNING), (0.999, RUNNING), (1.001, end), (50.0, end)):
        state = REST._replace(**{name: middle + side * share * limit})
        assert END(state, GOAL, None, WORLD) == expected


def test_a_number_that_is_none_does_not_count_as_settled():
    for name in TOLERANCES:
        assert not SETTLED(REST._replace(**{name: math.nan}), GOAL, None, WORLD)


@dataclasses.dataclass(frozen=True)
class Gate(Stabilise):
    """A narrow place of the road, not as long as the car, from 50 m on."""

    uniform_corridor = False
    road_half_width = 3.0

    def reference(self, xp):
        def reference(state, task_state, world):
            zero = 0.0 * state.lateral_position
            there = (state.longitudinal_position > 50.0) & (state.longitudinal_position < 51.0)
            return Reference(zero, zero, zero, zero, xp.where(there, 1.2 + zero, 3.0))

        return reference


@SIDES
def test_each_corner_is_judged_at_its_own_place(side):
    task, car = Gate(), WORLD.car
    law, cost = clearance(PYTHON, task), task.cost(PYTHON)
    here = Reference(0.0, 0.0, 0.0, 0.0, 3.0)
    half = 0.5 * car.body_width
    for heading in (0.0, 0.05 * side):
        for x in np.linspace(45.0, 56.0, 200):
            state = CarState(x, 0.1 * side, heading, 0.0, 0.0, 0.0, 0.0)
            corners = [
                (
                    x + forward * math.cos(heading) - left * math.sin(heading),
                    0.1 * side + forward * math.sin(heading) + left * math.cos(heading),
                )
                for forward in (car.front_extent, -car.rear_extent)
                for left in (half, -half)
            ]
            expected = min((1.2 if 50.0 < along < 51.0 else 3.0) - abs(across) for along, across in corners)
            episode = EpisodeState(0.0, 0.0, 0.0, 0.0, Nothing())
            assert law(state, here, episode, WORLD) == pytest.approx(expected, abs=1e-12)
            assert cost(state, here, episode, WORLD) == float(expected < 0.0)


@pytest.mark.exhaustive
def test_telemetry_and_cost_judge_alike_in_every_environment():
    bicycle_env.register("Gate-v0", Gate)
    try:
        given = {"tire": "linear", "telemetry": True, "speed": 30.0}
        many, tensors = gym.make_vec("Gate-v0", 4, **given), TorchVectorEnv("Gate-v0", 4, **given)
        alone = gym.make("Gate-v0", **given)
        options = {"state": {"longitudinal_position": 46.0, "lateral_position": 0.4, "heading": -0.02}}
        for env in (many, tensors, alone):
            env.reset(seed=0, options=options)
        seen = set()
        for _ in range(15):
            _, _, _, _, info = alone.step(np.zeros(2, np.float32))
            many_info = many.step(np.zeros((4, 2), np.float32))[4]
            torch_info = tensors.step(torch.zeros(4, 2))[4]
            assert info["cost"] == float(info["clearance"] < 0.0)
            assert (many_info["clearance"][2], many_info["cost"][2]) == (info["clearance"], info["cost"])
            assert torch_info["clearance"][1].item() == pytest.approx(info["clearance"], abs=1e-12)
            seen.add(info["cost"])
        assert seen == {0.0, 1.0}
    finally:
        gym.registry.pop("Gate-v0")
