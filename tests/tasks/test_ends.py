"""The laws of an episode's end, on numbers: each limit and tolerance on both sides of zero."""

import math

import pytest

from bicycle_env import vehicles
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.tasks.ends import LEFT, RUNNING, SPUN, Limits, Tolerances, end_code, settled
from bicycle_env.tasks.episode import Reference, World

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
    assert SETTLED(REST, GOAL, WORLD)
    for share, expected in ((0.0, True), (0.999, True), (1.001, False), (50.0, False)):
        away = getattr(REST, name) + side * share * TOLERANCES[name]
        assert SETTLED(REST._replace(**{name: away}), GOAL, WORLD) == expected, (name, away)


@SIDES
@pytest.mark.parametrize("name", LIMITS)
def test_an_episode_ends_beyond_each_limit_on_both_sides(name, side):
    limit, end = LIMITS[name]
    middle = GOAL.road_centre if name == "lateral_position" else 0.0
    for share, expected in ((0.0, RUNNING), (0.999, RUNNING), (1.001, end), (50.0, end)):
        state = REST._replace(**{name: middle + side * share * limit})
        assert END(state, GOAL, WORLD) == expected


def test_a_number_that_is_none_does_not_count_as_settled():
    for name in TOLERANCES:
        assert not SETTLED(REST._replace(**{name: math.nan}), GOAL, WORLD)
