"""The laws of an episode's end, on numbers: each limit and tolerance on both sides of zero."""

import math

import pytest

from bicycle_env import vehicles
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.tasks.ends import LEFT, RUNNING, SPUN, end_code, settled
from bicycle_env.tasks.episode import Reference, World
from bicycle_env.tasks.stabilise import Stabilise

SPEED = 30.0
GOAL = Reference(lateral_position=2.0, heading=0.0, goal=2.0, road_centre=1.0, road_half_width=3.5)
RULES = Stabilise().rules(control_timestep=0.02, substeps=5, horizon=400, steers_front=1.0, steers_rear=1.0)
WORLD = World(car_on_road(vehicles["oversteer"], SPEED, 1.0, FRONT, REAR), RULES, None)
REST = CarState(0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
TOLERANCES = {
    "lateral_position": RULES.lateral_tolerance,
    "heading": RULES.heading_tolerance,
    "lateral_velocity": RULES.sideslip_tolerance * SPEED,
    "yaw_rate": RULES.yaw_rate_tolerance,
}
LIMITS = {
    "lateral_position": (GOAL.road_half_width + 0.5 * WORLD.car.body_width, LEFT),
    "heading": (RULES.heading_limit, SPUN),
    "lateral_velocity": (RULES.sideslip_limit * SPEED, SPUN),
    "yaw_rate": (RULES.yaw_rate_limit, SPUN),
}
SIDES = pytest.mark.parametrize("side", [-1.0, 1.0], ids=["right", "left"])


@SIDES
@pytest.mark.parametrize("name", TOLERANCES)
def test_a_car_is_settled_within_each_tolerance_on_both_sides(name, side):
    law = settled(PYTHON)
    assert law(REST, GOAL, WORLD)
    for share, expected in ((0.0, True), (0.999, True), (1.001, False), (50.0, False)):
        away = getattr(REST, name) + side * share * TOLERANCES[name]
        assert law(REST._replace(**{name: away}), GOAL, WORLD) == expected, (name, away)


@SIDES
@pytest.mark.parametrize("name", LIMITS)
def test_an_episode_ends_beyond_each_limit_on_both_sides(name, side):
    law, (limit, end) = end_code(PYTHON), LIMITS[name]
    middle = GOAL.road_centre if name == "lateral_position" else 0.0
    for share, expected in ((0.0, RUNNING), (0.999, RUNNING), (1.001, end), (50.0, end)):
        state = REST._replace(**{name: middle + side * share * limit})
        assert law(state, GOAL, WORLD) == expected


def test_a_number_that_is_none_does_not_count_as_settled():
    for name in TOLERANCES:
        assert not settled(PYTHON)(REST._replace(**{name: math.nan}), GOAL, WORLD)
