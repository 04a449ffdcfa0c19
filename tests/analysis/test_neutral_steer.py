"""Neutral steer: one rule decides, and every part of the package says the same of the same car."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from combinations import only_all

from bicycle_env import Vehicle, analysis, report
from bicycle_env.envs.configuration import DEFAULT_SPEED, resolve_speed
from bicycle_env.physics.vehicle import GRAVITY, NEUTRAL
from bicycle_env.report.words import summary


def neutral_cars(number, seed=0):
    """Cars with C = a coefficient x the axle's load, which makes a Cf = b Cr but for rounding, of all sizes."""
    rng = np.random.default_rng(seed)
    for _ in range(number):
        mass, a, b = np.exp(rng.uniform(np.log([3.0, 0.1, 0.1]), np.log([4e4, 4.0, 4.0])))
        coefficient = rng.uniform(3.0, 60.0) * mass * GRAVITY / (a + b)
        yield Vehicle(
            mass=mass,
            yaw_inertia=mass * a * b,
            cg_to_front=a,
            cg_to_rear=b,
            front_cornering_stiffness=coefficient * b,
            rear_cornering_stiffness=coefficient * a,
        )


def parted(car):
    """Whether rounding makes a Cf and b Cr differ."""
    return car.cg_to_front * car.front_cornering_stiffness != car.cg_to_rear * car.rear_cornering_stiffness


BMW = Vehicle(
    mass=1093.2952334674046,
    yaw_inertia=1791.5995120,
    cg_to_front=1.1561957064,
    cg_to_rear=1.4227170936,
    front_cornering_stiffness=21.92 * (1093.2952334674046 * GRAVITY * 1.4227170936 / 2.5789128),
    rear_cornering_stiffness=21.92 * (1093.2952334674046 * GRAVITY * 1.1561957064 / 2.5789128),
    source="CommonRoad, vehicle 2 (BMW 320i): C = 21.92 F_z on both axles.",
)


def test_2000_neutral_cars_are_neutral_everywhere():
    cars = list(neutral_cars(2000))
    assert sum(map(parted, cars)) > 500
    for car in cars:
        assert car.yaw_stiffness == 0.0
        assert car.critical_speed == analysis.critical_speed(car) == math.inf
        assert analysis.characteristic_speed(car) == math.inf
        assert analysis.classification(car) == "neutral"
        assert analysis.understeer_gradient(car) == analysis.static_margin(car) == 0.0
        assert all(analysis.is_stable(car, speed) for speed in (0.1, 30.0, 1000.0))
        told = analysis.stability(car, 1000.0)
        assert (told.critical_speed, told.speed_ratio, told.time_to_double) == (math.inf, 0.0, math.inf)
        assert resolve_speed(car, None, None) == DEFAULT_SPEED
        with pytest.raises(ValueError, match="no critical speed"):
            resolve_speed(car, None, 1.2)


@pytest.mark.parametrize("tire", ["linear", "tanh", "fiala", only_all("magic_formula")])
def test_the_handling_diagram_of_neutral_cars_is_neutral(tire):
    for car in itertools.islice(filter(parted, neutral_cars(100, seed=1)), 12):
        diagram = analysis.handling_diagram(car, tire=tire, points=9)
        assert diagram.limit == "neutral"
        assert np.all(np.isinf(diagram.curves[0].critical_speed[:-1]))


def test_the_report_says_it_of_neutral_cars():
    for car in [BMW, *neutral_cars(200, seed=2)]:
        study = report.study(car)
        study.__dict__["why_unknown"] = ""
        study.__dict__["shares"] = dict.fromkeys(
            ("recoverable", "lqr", "straight"), 1.0
        )  # takes long, and is not asked
        assert study.speed == DEFAULT_SPEED
        assert summary(study).startswith("This car is neutral; it is stable at every speed.")


def test_the_car_that_oversteered_by_rounding():
    assert BMW.cg_to_front * BMW.front_cornering_stiffness > BMW.cg_to_rear * BMW.rear_cornering_stiffness
    assert analysis.classification(BMW) == "neutral"


@pytest.mark.parametrize(
    ("share", "word"), [(2.0, "oversteer"), (0.5, "neutral"), (-0.5, "neutral"), (-2.0, "understeer")]
)
def test_the_rule_is_relative(share, word):
    for car in neutral_cars(50, seed=3):
        changed = dataclasses.replace(
            car, front_cornering_stiffness=car.front_cornering_stiffness * (1.0 + share * NEUTRAL)
        )
        assert analysis.classification(changed) == word
        assert math.isfinite(changed.critical_speed) == (word == "oversteer")
        assert math.isfinite(analysis.characteristic_speed(changed)) == (word == "understeer")
        assert (
            analysis.handling_diagram(changed, tire="linear", points=3).limit
            == {
                "oversteer": "spins",
                "neutral": "neutral",
                "understeer": "plows",
            }[word]
        )
