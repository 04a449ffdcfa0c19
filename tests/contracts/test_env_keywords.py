"""Constructor keywords: each bad value is refused with a message that names the keyword."""

import importlib
import math

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all

from bicycle_env import Actuator, tires, vehicles
from bicycle_env.envs.configuration import DEFAULT_SPEED
from bicycle_env.envs.single.single_track_env import keyword_names
from bicycle_env.registration import ENVIRONMENTS
from bicycle_env.tasks import checking


def env_class(env_id):
    module, name = next(row.entry_point for row in ENVIRONMENTS if row.id == env_id).split(":")
    return getattr(importlib.import_module(module), name)


IDS = [row.id for row in ENVIRONMENTS]
NO_NUMBERS = ["30", [1.0], np.array([1.0, 2.0]), 1j, True, {}]
NOT_FINITE = [math.nan, math.inf, -math.inf]


def values(*bad, error=ValueError):
    return [(value, error) for value in bad]


def a_range(*bad):
    return values(*bad, (math.nan, 1.0)) + values(
        None, 1.0, "low", (0.1,), (0.1, 0.2, 0.3), ("0.1", 0.2), error=TypeError
    )


POSITIVE = values(*NOT_FINITE, 0.0, 0, -1.0) + values(*NO_NUMBERS, error=TypeError)
REQUIRED = POSITIVE + values(None, error=TypeError)
AN_ACTUATOR = values(None, 0.1, "front", (0.1, 0.7, 0.05), {"angle_limit": "0.1"}, Actuator, error=TypeError)

BAD = {
    "vehicle": values("oversteerr", "", "Oversteer", {"mass": 1500.0}) + values(None, 3, error=TypeError),
    "tire": values("fialaa", "", "Fiala") + values(None, 3, tires.Fiala, lambda xp: xp, error=TypeError),
    "speed": POSITIVE,
    "speed_ratio": POSITIVE,
    "steer": values("", "left", "Both") + values(None, 2, ["front", "rear"], error=TypeError),
    "friction": REQUIRED,
    "geometry": values("", "exakt", "small-angle") + values(1, True, error=TypeError),
    "relaxation_length": values(*NOT_FINITE, 0.0, -1.0, 11.0) + values(*NO_NUMBERS, error=TypeError),
    "front_actuator": AN_ACTUATOR,
    "rear_actuator": AN_ACTUATOR,
    "control_timestep": REQUIRED,
    "physics_timestep": REQUIRED,
    "reward": values("", "sparse", "Default") + values(None, 1, error=TypeError),
    "horizon": values(0, -400) + values(1.5, 400.0, math.nan, "400", True, [400], error=TypeError),
    "randomise": values({"grip": (0.3, 1.0)}, {"mass": (2.0, 1.0)}) + values(3, {"mass": 1.0}, error=TypeError),
    "disturbances": values([{"name": "gusts"}]) + values(3, "gust", [3], error=TypeError),
    "driver": values("", "sine") + values(3, ["step"], error=TypeError),
    "action_delay": values(-1, 51) + values(None, 1.5, "1", True, error=TypeError),
    "observation_delay": values(-1, 51) + values(None, 1.5, "1", True, error=TypeError),
    "action_repeat": values(0, -1, 1001) + values(None, 1.5, "1", True, error=TypeError),
    "sensors": values({"noise": {"yawrate": 0.1}}, {"noise": {"yaw_rate": -1.0}}) + values(3, "noisy", error=TypeError),
    "history": values(0, -1, 51) + values(None, 1.5, "1", True, error=TypeError),
    "level": values("hrad", "Hard", "") + values(3, ["easy"], error=TypeError),
    "telemetry": values(None, 0, 1, "yes", np.True_, error=TypeError),
    "render_mode": values("", "ansi", "Human") + values(3, True, error=TypeError),
    "course": values("", "iso3888", "ISO3888-1") + values(None, 1, error=TypeError),
    "direction": values("", "up", "Left") + values(None, 1, -1.0, error=TypeError),
    "change_start": values(*NOT_FINITE, -0.001, 100.1) + values(*NO_NUMBERS, error=TypeError),
    "duration": POSITIVE,
    "length": POSITIVE,
    "lane_width": REQUIRED,
    "preview_length": values(*NOT_FINITE, -0.1) + values(*NO_NUMBERS, None, error=TypeError),
    "preview_spacing": REQUIRED,
    "relative_speed": a_range((0.4, 1.0), (0.9, 2.1), (1.0, 0.9)),
    "relative_friction": a_range((0.0, 1.0), (0.5, 2.1), (1.0, 0.9)),
    "amplitude": a_range((-0.1, 0.1), (0.1, 1.6), (0.1, 0.05)),
    "frequency": a_range((0.1, 0.7), (0.7, 4.0), (0.8, 0.7), (0.3, 0.7)),
    "obstacle_time": a_range((0.1, 1.0), (1.0, 2.6), (1.0, 0.9)),
    "obstacle_length": a_range((0.0, 0.5), (0.5, 1.6), (0.6, 0.5)),
    "return_time": a_range((0.1, 1.0), (1.0, 2.3), (1.0, 0.9)),
    "dwell": a_range((-0.1, 0.5), (0.5, 2.1), (0.6, 0.5)),
    "observed": values("", "all", "State") + values(None, 1, error=TypeError),
}

OF_IDS = {
    keyword: [env_id for env_id in IDS if keyword in keyword_names(env_class(env_id))]
    for keyword in BAD  # one id each in `make test`: all take a keyword by the same function
}
CASES = [
    (env_id, keyword, value, error) if env_id == ids[0] else only_all(env_id, keyword, value, error)
    for keyword, ids in OF_IDS.items()
    for env_id in ids
    for value, error in BAD[keyword]
]


def test_bad_values_are_listed_for_every_keyword():
    known = {name for env_id in IDS for name in keyword_names(env_class(env_id))}
    assert known == set(BAD)


@pytest.mark.parametrize(("env_id", "keyword", "value", "error"), CASES)
def test_a_bad_value_is_refused_by_name(env_id, keyword, value, error):
    with pytest.raises(error) as caught:
        env_class(env_id)(**{keyword: value})
    assert type(caught.value) is error
    assert str(caught.value).startswith(keyword), caught.value


@pytest.mark.parametrize(
    ("keyword", "value"),
    [("vehicle", "oversteerr"), ("tire", "fiala2"), ("steer", "rearr"), ("friction", -3.25), ("speed", "thirty")],
)
def test_the_message_shows_the_value(keyword, value):
    with pytest.raises((ValueError, TypeError)) as caught:
        env_class(IDS[0])(**{keyword: value})
    assert repr(value) in str(caught.value)


@pytest.mark.parametrize(
    ("env_id", "keyword", "value"),
    [
        ("BicycleStab-v0", "speed", 10**400),
        ("BicycleStab-v0", "horizon", 10**400),
        ("BicycleStab-v0", "speed", 1e-310),
        ("BicycleStab-v0", "speed_ratio", 1e308),
        ("BicycleStab-v0", "physics_timestep", 1e-320),
        ("BicycleLaneChange-v0", "preview_spacing", 1e-320),
        ("BicycleLaneChange-v0", "preview_length", 1e308),
    ],
    ids=lambda value: str(value)[:12],
)
def test_absurd_magnitudes_are_refused_as_clearly(env_id, keyword, value):
    with pytest.raises(ValueError, match=keyword):
        env_class(env_id)(**{keyword: value})


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    ("wrong", "nearest"),
    [
        ("speeed", "speed"),
        ("vehicel", "vehicle"),
        ("Friction", "friction"),
        ("rear_actuators", "rear_actuator"),
        ("dt", None),
        ("env_id", None),
    ],
)
def test_an_unknown_keyword_is_a_type_error_that_names_the_nearest(env_id, wrong, nearest):
    for make in (env_class(env_id), lambda **keywords: gym.make(env_id, **keywords)):
        with pytest.raises(TypeError, match=f"unknown keyword '{wrong}'") as caught:
            make(**{wrong: 1.0})
        assert nearest is None or f"did you mean '{nearest}'" in str(caught.value)


def test_a_keyword_of_the_other_task_is_unknown():
    with pytest.raises(TypeError, match="unknown keyword 'lane_width'"):
        gym.make("BicycleStab-v0", lane_width=3.0)
    with pytest.raises(TypeError, match="unknown keyword 'durations'; did you mean 'duration'"):
        gym.make("BicycleLaneChange-v0", durations=3.0)


@pytest.mark.parametrize("env_id", IDS)
def test_keywords_are_given_by_name(env_id):
    with pytest.raises(TypeError):
        env_class(env_id)("oversteer")


# Keywords that depend on each other


@pytest.mark.parametrize("env_id", IDS)
def test_speed_and_speed_ratio_together(env_id):
    with pytest.raises(ValueError, match=r"speed or speed_ratio, not both.*30.*1\.1"):
        gym.make(env_id, speed=30.0, speed_ratio=1.1)


@pytest.mark.parametrize("name", [name for name, car in vehicles.items() if math.isinf(car.critical_speed)])
@pytest.mark.parametrize("env_id", IDS)
def test_a_speed_ratio_needs_a_critical_speed(env_id, name):
    with pytest.raises(ValueError, match=r"speed_ratio.*no critical speed.*give speed"):
        gym.make(env_id, vehicle=name, speed_ratio=0.9)
    env = gym.make(env_id, vehicle=name, tire="linear").unwrapped
    assert env.speed == (env.task.usual_speed or DEFAULT_SPEED)
    assert gym.make(env_id, vehicle=name, speed=25.0, tire="linear").unwrapped.speed == 25.0


@pytest.mark.parametrize("env_id", IDS)
def test_the_speed_from_its_ratio(env_id):
    critical = vehicles["oversteer"].critical_speed
    env = gym.make(env_id, vehicle="oversteer").unwrapped
    assert env.speed == (env.task.usual_speed or 1.2 * critical)
    assert gym.make(env_id, vehicle="oversteer", speed_ratio=0.7).unwrapped.speed == 0.7 * critical
    assert gym.make(env_id, vehicle=vehicles["me303"], speed_ratio=2).unwrapped.speed == (
        2.0 * vehicles["me303"].critical_speed
    )


@pytest.mark.parametrize("bad", [0.003, 0.007, 0.0041, 0.02 * 1.5, 0.04, 1.0])
def test_the_physics_timestep_divides_the_control_timestep(bad):
    # A slow actuator and a fast car: no step in the list is refused for stability.
    slow = Actuator(0.1, time_constant=2.0)
    with pytest.raises(ValueError, match=r"physics_timestep must divide control_timestep = 0\.02"):
        gym.make(
            "BicycleStab-v0",
            physics_timestep=bad,
            vehicle="mendes",
            speed=90.0,
            front_actuator=slow,
            rear_actuator=slow,
        )


@pytest.mark.parametrize("substeps", [1, 2, 3, 5, 7, 10, 40])
def test_physics_timesteps_that_divide(substeps):
    env = gym.make("BicycleStab-v0", physics_timestep=0.02 / substeps).unwrapped
    assert env.substeps == substeps


def test_an_unstable_physics_timestep_is_refused():
    with pytest.raises(ValueError, match=r"physics_timestep must be <= .* got 0\.02"):
        gym.make("BicycleStab-v0", physics_timestep=0.02, front_actuator=Actuator(0.1, time_constant=0.007))
    with pytest.raises(ValueError, match="physics_timestep must be <="):
        gym.make("BicycleStab-v0", speed=0.3, control_timestep=0.4, physics_timestep=0.1)
    gym.make("BicycleStab-v0", physics_timestep=0.02, front_actuator=Actuator(0.1, time_constant=0.0081))


def test_duration_and_length_together():
    with pytest.raises(ValueError, match=r"duration or length.*not both; got 1\.5 and 60"):
        gym.make("BicycleLaneChange-v0", duration=1.5, length=60.0)


def test_too_many_preview_points(monkeypatch):
    with pytest.raises(ValueError, match="preview_length / preview_spacing must be <= 500, got 600"):
        gym.make("BicycleLaneChange-v0", preview_length=6.0, preview_spacing=0.01)
    # The laws are tried at every point; tests/tasks/test_checking.py says how.
    monkeypatch.setattr(checking, "_check_laws", lambda task, name, world: None)
    most = gym.make("BicycleLaneChange-v0", preview_length=5.0, preview_spacing=0.01, tire="linear")
    assert most.observation_space.shape == (510,)


# Keywords that reach the physics


@pytest.mark.parametrize(
    "keywords",
    [
        {"friction": 0.6},
        {"tire": tires.MagicFormula(shape=1.6, curvature=0.2)},
        {"vehicle": vehicles["me303"]},
        {"speed_ratio": 1.21},
        {"front_actuator": Actuator(0.1, 0.7, 0.1)},
        {"rear_actuator": Actuator(0.05)},
        {"geometry": "small_angle"},
        {"relaxation_length": 0.5},
        {"physics_timestep": 0.01},
        {"control_timestep": 0.01, "physics_timestep": 0.002},
        {"reward": "quadratic"},
    ],
    ids=lambda keywords: next(iter(keywords)),
)
def test_a_keyword_changes_what_happens(keywords, interpreted):
    def rollout(**given):
        env = gym.make("BicycleStab-v0", **given)
        env.reset(seed=3, options={"state": {"lateral_velocity": 4.0, "yaw_rate": 0.3}})
        return [env.step(np.array([0.4, -0.6], np.float32))[:2] for _ in range(10)]

    default, changed = rollout(), rollout(**keywords)
    if "reward" in keywords:
        assert all(np.array_equal(a[0], b[0]) and a[1] != b[1] for a, b in zip(default, changed, strict=True))
    else:
        assert any(not np.array_equal(a[0], b[0]) for a, b in zip(default, changed, strict=True))


def test_a_name_and_its_object_are_the_same(interpreted):
    named = gym.make("BicycleStab-v0", tire="magic_formula", vehicle="me303", speed=20.0)
    given = gym.make("BicycleStab-v0", tire=tires.MagicFormula(), vehicle=vehicles["me303"], speed=np.float64(20.0))
    named.reset(seed=1)
    given.reset(seed=1)
    for _ in range(20):
        assert np.array_equal(named.step(np.ones(2, np.float32))[0], given.step(np.ones(2, np.float32))[0])


@pytest.mark.parametrize("tire", tires.LAWS)
def test_the_default_geometry(tire):
    expected = "small_angle" if tire == "linear" else "exact"
    assert gym.make("BicycleStab-v0", tire=tire).unwrapped.geometry == expected


def test_frames_per_second_follow_the_control_timestep():
    assert gym.make("BicycleStab-v0").metadata["render_fps"] == 50
    fast = gym.make("BicycleStab-v0", control_timestep=0.01, physics_timestep=0.002)
    assert fast.metadata["render_fps"] == 100
    assert gym.make("BicycleStab-v0").metadata["render_fps"] == 50


@pytest.mark.parametrize(
    ("keyword", "place"), [("threads", "make_vec"), ("dtype", "make_vec"), ("seed", r"reset\(seed")]
)
def test_a_keyword_of_another_place_says_where(keyword, place):
    with pytest.raises(TypeError, match=rf"^{keyword} is no keyword of one car: give it to .*{place}"):
        gym.make("BicycleStab-v0", **{keyword: 2})
