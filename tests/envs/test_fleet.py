"""Keywords given once per car: the fleet's numbers are those of each car made by itself."""

import math

import numpy as np
import pytest

from bicycle_env import Vehicle, vehicles
from bicycle_env.envs.configuration import configure
from bicycle_env.envs.fleet import ConfiguredFleet, configure_fleet
from bicycle_env.envs.origin import origin_of
from bicycle_env.envs.setup import Setup
from bicycle_env.physics.linear_single_track import fastest_rate
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.stabilise import Stabilise

TASKS = [Stabilise, LaneChange]


def fleet_of(num_envs=4, task=Stabilise, **keywords):
    return configure_fleet(origin_of(task(), keywords), num_envs)


def assert_each_is(fleet, alone):
    """Row by row what `configure` gives for that car."""
    for row, one in enumerate(alone):
        assert [column[row] for column in fleet.car] == list(one.car)
        assert [np.broadcast_to(column, len(alone))[row] for column in fleet.settings] == list(one.settings)
        np.testing.assert_array_equal(fleet.observation_scale[row], one.observation_scale)
        assert (fleet.vehicle[row], fleet.speed[row], fleet.friction[row]) == (one.vehicle, one.speed, one.friction)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize(
    "varied",
    [
        {"friction": [1.0, 0.5, 0.25, 0.8]},
        {"speed": np.array([30.0, 40.0, 43.0, 20.0])},
        {"speed_ratio": (1.1, 1.2, 0.9, 1.5)},
        {"vehicle": ["oversteer", vehicles["me303"], "oversteer", vehicles["oversteer"]], "speed_ratio": 1.1},
        {
            "vehicle": ["oversteer", "civic", "civic", "me303"],
            "speed": [40.0, 30.0, 31.0, 20.0],
            "friction": [1, 1, 2, 1],
        },
        {"vehicle": ["me303", "oversteer", "me303", "oversteer"], "speed_ratio": [1.1, 1.2, 1.3, 1.4]},
        {"vehicle": ["oversteer", "me303", "oversteer", "oversteer"]},
        {"vehicle": ["oversteer", "civic", "neutral", "oversteer"]},
    ],
    ids=lambda varied: "-".join(varied),
)
def test_each_car_is_the_one_made_by_itself(task, varied):
    fleet = fleet_of(task=task, **varied)
    alone = []
    for row in range(4):
        own = {
            name: value[row] if isinstance(value, (list, tuple, np.ndarray)) else value
            for name, value in varied.items()
        }
        alone.append(configure(task(), Setup(**own)))
    assert fleet.varied
    assert_each_is(fleet, alone)


@pytest.mark.parametrize("task", TASKS)
def test_without_sequences_all_is_the_single_configuration(task):
    fleet = fleet_of(task=task, friction=0.7)
    one = configure(task(), Setup(friction=0.7))
    assert not fleet.varied
    assert fleet.car == one.car
    assert fleet.settings == one.settings
    assert (fleet.vehicle, fleet.speed, fleet.friction) == (one.vehicle, one.speed, 0.7)
    assert fleet.observation_scale.shape == (len(one.observation_entries),)


FAST = {"physics_timestep": 0.02, "vehicle": "neutral"}


@pytest.mark.parametrize(
    ("keywords", "error", "match"),
    [
        ({"friction": [1.0, 1.0, -0.5, 1.0]}, ValueError, r"car 2: friction must be a finite number in .*, got -0.5"),
        ({"friction": [1.0, math.nan, 1.0, 1.0]}, ValueError, r"car 1: friction .* got nan"),
        ({"friction": [1.0, 1.0, 1.0, math.inf]}, ValueError, r"car 3: friction .* got inf"),
        ({"friction": [1.0, 1.0]}, ValueError, r"friction must be one number or .* = 4 of them, got shape \(2,\)"),
        ({"friction": np.ones((4, 1))}, ValueError, r"friction .* got shape \(4, 1\)"),
        ({"friction": ["a", "b", "c", "d"]}, TypeError, r"friction must be one number or num_envs = 4 of them"),
        ({"friction": [[1.0], [1.0, 2.0], 1.0, 1.0]}, TypeError, "friction must be one number"),
        ({"friction": [True, True, False, True]}, TypeError, "friction must be one number"),
        ({"speed": [30.0, 0.01, 30.0, 30.0]}, ValueError, r"car 1: speed must be a finite number in \[0.1, 1000\]"),
        ({"speed": [30.0, 30.0, 30.0, 2000.0]}, ValueError, "car 3: speed must be"),
        ({"speed": [30.0] * 4, "speed_ratio": 1.2}, ValueError, "give speed or speed_ratio, not both"),
        ({"speed_ratio": [1.1, 1.2, 100.0, 1.0]}, ValueError, "car 2: speed_ratio x critical speed must be"),
        ({"vehicle": ["me303"] * 3 + ["civic"], "speed_ratio": 1.1}, ValueError, "car 3: speed_ratio must not"),
        ({"vehicle": ["oversteer"]}, ValueError, "vehicle must be one vehicle or num_envs = 4 of them, got 1"),
        ({"vehicle": ["oversteer", "me303", "oversteeer", "me303"]}, ValueError, "did you mean 'oversteer'"),
        ({"vehicle": [1, 2, 3, 4]}, TypeError, "vehicle must be one of"),
        ({"tire": ["fiala"] * 4}, TypeError, "tire"),
        ({**FAST, "speed": [40.0, 40.0, 0.2, 40.0]}, ValueError, r"car 2: physics_timestep must be <= .* got 0.02"),
    ],
)  # fmt: skip
def test_bad_values_are_named_with_their_car(keywords, error, match):
    with pytest.raises(error, match=match):
        fleet_of(**keywords)


@pytest.mark.filterwarnings("ignore::bicycle_env.physics.vehicle.UnitWarning")
def test_the_slowest_car_has_the_fastest_mode():
    """Why the ends of an interval of speeds stand for all of it."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        mass, inertia, front, rear = rng.uniform([500, 300, 1e4, 1e4], [3000, 9000, 3e5, 3e5])
        a, b = rng.uniform(0.5, 2.5, 2)
        car = Vehicle(
            mass=mass,
            yaw_inertia=inertia,
            cg_to_front=a,
            cg_to_rear=b,
            front_cornering_stiffness=front,
            rear_cornering_stiffness=rear,
        )
        rates = np.array([fastest_rate(car, speed) for speed in np.geomspace(0.1, 1000.0, 40)])
        assert np.all(np.diff(rates) <= 1e-9 * rates[:-1])


def test_what_belongs_to_one_car_is_refused_where_they_differ():
    class Cars(ConfiguredFleet):
        def __init__(self, fleet):
            self._adopt_options(4, None, "NextStep", "float64", False, "raise", False)
            self._adopt_fleet(fleet)

    alike, different = Cars(fleet_of()), Cars(fleet_of(friction=[1.0, 0.9, 0.8, 0.7]))
    assert alike.stability.speed_ratio == pytest.approx(1.2)
    assert alike.linear_model().A.shape[0] == 6
    assert different.friction.tolist() == [1.0, 0.9, 0.8, 0.7]
    assert different.observation_scale.shape == (4, 8)
    with pytest.raises(ValueError, match="the cars of this environment differ"):
        _ = different.stability
    with pytest.raises(ValueError, match="the cars of this environment differ"):
        different.linear_model()
