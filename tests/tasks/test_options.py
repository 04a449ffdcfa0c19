"""What may be added to any task: drawn parameters, disturbances, a driver, delays; alike in every environment."""

import dataclasses
import math
import pickle
import types

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import EnvSpec

from bicycle_env import Sensors, vehicles
from bicycle_env.backends.compiled import ENTRY_POINTS
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics import actuators
from bicycle_env.physics.car import CarParameters, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.records import replaced
from bicycle_env.tasks import distributions, drivers
from bicycle_env.tasks.checking import check
from bicycle_env.tasks.control_step import command_of
from bicycle_env.tasks.disturbances import Disturbance, FrictionStep, Gust, IcePatch, StiffnessLoss
from bicycle_env.tasks.episode import EpisodeState, Rules, World
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
QUICK = {"tire": "linear", "geometry": "small_angle"}
CARS = 8
in_python = pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
OWN = ("mass", "yaw_inertia", "front_cornering_stiffness", "rear_cornering_stiffness")
PARAMETERS = ("friction", *OWN, "front_time_constant", "rear_time_constant")
EVERYTHING = {
    "randomise": {"friction": (0.3, 1.0), **dict.fromkeys(PARAMETERS[1:], (0.9, 1.2, "relative"))},
    "disturbances": (
        Gust(force=(200.0, 2000.0), start=(0.2, 0.6)),
        Gust(start=0.1, duration=0.1, side="left"),
        FrictionStep(at=0.4, front=0.7, rear=(0.5, 0.9)),
        StiffnessLoss(at=0.3),
        IcePatch(begin=(5.0, 20.0), edge=-0.5),
    ),
    "driver": drivers.SineWithDwell(amplitude=0.01, start=0.1),
}
LATE = {"action_delay": 2, "observation_delay": 1, "history": 3}
ONE_OF_EACH = {
    "randomise": {"friction": (0.3, 1.0)},
    "disturbances": (Gust(force=(200.0, 2000.0), start=(0.2, 0.6)),),
    "driver": drivers.Step(angle=0.01, start=0.1),
    "sensors": Sensors(signals="car", noise={"lateral_acceleration": 0.2}),
    "relaxation_length": 0.4,
    **{"action_delay": 1, "observation_delay": 2, "history": 2},
}
"""In the least code."""


def neutral(gust=None, step=None, loss=None, ice=None, driver=None, **randomise):
    """The laws of EVERYTHING with numbers that change nothing, but for those given: compiled once for these tests."""
    return {
        "randomise": {"friction": (1.0, 1.0), **dict.fromkeys(PARAMETERS[1:], (1.0, 1.0, "relative")), **randomise},
        "disturbances": (
            gust or Gust(force=0.0),
            Gust(force=0.0),
            step or FrictionStep(front=1.0, rear=1.0),
            loss or StiffnessLoss(factor=1.0),
            ice or IcePatch(factor=1.0),
        ),
        "driver": driver or drivers.SineWithDwell(amplitude=0.0),
    }


def actions(steps=50, cars=CARS):
    rng = np.random.default_rng(5)
    return np.clip(np.cumsum(rng.uniform(-0.3, 0.3, (steps, cars, 2)), axis=0), -1.0, 1.0).astype(np.float32)


def make(env_id=STAB, **keywords):
    return gym.make(env_id, **QUICK, **keywords).unwrapped


def drive(env, commands, seed=4, options=None):
    """Observations (the first one included) and states after each step."""
    observation, _ = env.reset(seed=seed, options=options)
    seen, states = [observation], [env.state]
    for action in commands:
        seen.append(env.step(action)[0])
        states.append(env.state)
        if env.end:
            break
    return np.array(seen), states


@pytest.mark.parametrize(
    ("env_id", "varied"), [only_all(env_id, varied) for env_id in (STAB, LANE) for varied in (True, False)]
)
def test_everything_at_once_is_the_same_for_one_car_many_and_tensors(env_id, varied):
    one_car_many_and_tensors(env_id, varied, CARS, {**EVERYTHING, **LATE, "telemetry": True})


@in_python
def test_everything_at_once_is_the_same_also_without_the_compiler():
    one_car_many_and_tensors(STAB, True, 4, {**EVERYTHING, **LATE, "telemetry": True})


def test_one_of_each_is_the_same_for_one_car_many_and_tensors():
    one_car_many_and_tensors(STAB, False, CARS, ONE_OF_EACH)


def one_car_many_and_tensors(env_id, varied, cars, options):
    given = {**QUICK, **options, "autoreset_mode": "Disabled"}
    own = {"vehicle": ["oversteer", "me303"] * (cars // 2), "speed": np.linspace(35.0, 42.0, cars)} if varied else {}
    many, tensors = gym.make_vec(env_id, cars, **given, **own), TorchVectorEnv(env_id, cars, **given, **own)
    alone = [gym.make(env_id, **QUICK, **options, **{name: own[name][k] for name in own}) for k in range(cars)]
    told_of = ("friction", *(("lateral_acceleration", "front_saturation") if "telemetry" in options else ()))
    observation, info = many.reset(seed=3)
    for k, env in enumerate(alone):
        expected, told = env.reset(seed=3 + k)
        assert expected.tobytes() == observation[k].tobytes()
        assert told == {
            name: many.unwrapped.end_names[info[name][k]] if name == "end" else info[name][k] for name in told
        }
    assert set(options["randomise"]) <= set(info)
    tensors.reset(seed=0)
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.unwrapped.state._asdict().items()})
    over = np.zeros(cars, bool)
    for action in actions(cars=cars):
        observation, reward, terminated, truncated, info = many.step(action)
        seen, gained, *_, of_tensors = tensors.step(torch.from_numpy(action))
        for k in np.flatnonzero(~over):
            expected = alone[k].step(action[k])
            assert (observation[k].tobytes(), reward[k]) == (expected[0].tobytes(), expected[1])
            assert gained[k].item() == pytest.approx(reward[k], rel=1e-12, abs=1e-12)
            np.testing.assert_allclose(seen[k].numpy(), observation[k], rtol=1e-6, atol=1e-6)
            for name in told_of:
                assert expected[4][name] == info[name][k]
                assert of_tensors[name][k].item() == pytest.approx(info[name][k], rel=1e-9, abs=1e-9)
        over |= terminated | truncated
    assert over.any()


@in_python
@pytest.mark.parametrize("env_id", [only_all(STAB), only_all(LANE)])
def test_a_seeded_start_is_the_same_with_all_of_it(env_id):
    plain, altered = make(env_id), make(env_id, **EVERYTHING)
    for seed in range(3):
        plain.reset(seed=seed)
        altered.reset(seed=seed)
        assert altered.state[: len(plain.state)] == plain.state


@pytest.mark.exhaustive
def test_scales_and_controllers_stay_nominal():
    plain, altered = make(), make(**EVERYTHING)
    assert (altered.speed, altered.friction, altered.vehicle) == (plain.speed, plain.friction, plain.vehicle)
    np.testing.assert_array_equal(altered.observation_scale, plain.observation_scale)
    np.testing.assert_array_equal(altered.linear_model().A, plain.linear_model().A)


# Drawn parameters


@in_python
@pytest.mark.exhaustive
def test_drawn_parameters_are_those_of_the_car_that_is_driven():
    """The states are those of an environment whose nominal car has the numbers that were drawn."""
    ranges = {"friction": (0.4, 0.9), **dict.fromkeys(OWN, (0.8, 1.2, "relative")), "front_time_constant": (0.05, 0.2)}
    env = make(speed=40.0, **neutral(**ranges))
    for seed in range(3):
        env.reset(seed=seed)
        drawn = {name: getattr(env.state, name) for name in ranges}
        for name, (low, high, *_) in ranges.items():
            nominal = getattr(CAR, name) if name in OWN else 1.0
            assert low * nominal <= drawn[name] <= high * nominal
        car = dataclasses.replace(CAR, **{name: drawn[name] for name in OWN})
        wheel = {**FRONT, "time_constant": drawn["front_time_constant"]}
        twin = make(speed=40.0, vehicle=car, friction=drawn["friction"], front_actuator=wheel)
        twin.reset(seed=seed)
        for action in actions(20)[:, 0]:
            env.step(action)
            twin.step(action)
            np.testing.assert_allclose(env.state[: len(twin.state)], twin.state, rtol=1e-12, atol=1e-14)


CAR = vehicles["oversteer"]
FRONT = {"angle_limit": math.radians(6.0), "rate_limit": math.radians(40.0)}


@pytest.mark.exhaustive
def test_other_numbers_compile_nothing_anew():
    make(**EVERYTHING).reset()
    known = set(ENTRY_POINTS)
    others = {
        **EVERYTHING,
        "randomise": {**EVERYTHING["randomise"], "friction": (0.5, 0.6)},
        "disturbances": (
            Gust(force=3.0, arm=0.1),
            Gust(duration=2.0),
            FrictionStep(front=0.9),
            StiffnessLoss(axle="front"),
            IcePatch(edge=None, side="left"),
        ),
        "driver": drivers.SineWithDwell(amplitude=0.02, frequency=0.5, side="right"),
    }
    make(**others).reset()
    assert set(ENTRY_POINTS) == known


@in_python
def test_each_episode_draws_anew_and_covers_the_range():
    env = make(**EVERYTHING)
    told = [env.reset(seed=0 if k == 0 else None)[1] for k in range(50 * CARS)]
    columns = {}
    for name, low, high in (("friction", 0.3, 1.0), ("mass", 0.9 * CAR.mass, 1.2 * CAR.mass)):
        columns[name] = values = np.array([info[name] for info in told])
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high >= values.max() > high - 0.02 * (high - low)
    assert abs(np.corrcoef(columns["friction"], columns["mass"])[0, 1]) < 0.15
    forces = np.array([env.reset() and env.state.gust_force for _ in range(25 * CARS)])
    assert 70 < np.sum(forces > 0.0) < 130
    assert (np.abs(forces) <= 2000.0).all()
    assert (np.abs(forces) >= 200.0).all()


@in_python
def test_a_reset_may_say_the_number():
    env = make(**EVERYTHING)
    _, info = env.reset(seed=0, options={"friction": 0.95})
    assert info["friction"] == env.state.friction == 0.95
    assert env.present == env.configuration, "it is a number of the episode, not another car"


@pytest.mark.exhaustive
def test_a_reset_may_say_each_cars_number():
    given = np.linspace(0.2, 0.9, CARS).tolist()
    for envs in (
        gym.make_vec(STAB, CARS, **QUICK, **EVERYTHING, **LATE),
        TorchVectorEnv(STAB, CARS, **QUICK, **EVERYTHING),
    ):
        _, info = envs.reset(seed=0, options={"friction": given})
        assert info["friction"].tolist() == given


# Disturbances


@in_python
@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_each_axle_stands_on_ice_or_not_at_its_own_place(side, sign):
    ice = IcePatch(begin=60.0, length=20.0, factor=0.25, edge=0.5, side=side)
    env = make(vehicle="civic", speed=25.0, **neutral(ice=ice))
    car = car_on_road(vehicles["civic"], 25.0, 1.0, env.front_actuator, env.rear_actuator)
    ahead, behind = vehicles["civic"].cg_to_front, vehicles["civic"].cg_to_rear
    seen = set()
    for x in np.linspace(55.0, 85.0, 31):
        for y, heading in ((sign * 0.6, 0.0), (sign * 0.4, 0.0), (sign * 0.5, sign * 0.2), (-sign * 0.6, 0.0)):
            env.reset(
                seed=0, options={"state": {"longitudinal_position": x, "lateral_position": y, "heading": heading}}
            )
            measured = env.measure()
            for axle, arm in (("front", ahead), ("rear", -behind)):
                along, across = x + arm * math.cos(heading), sign * (y + arm * math.sin(heading))
                on = 60.0 <= along < 80.0 and across >= 0.5
                seen.add((axle, on))
                full = getattr(car, f"{axle}_peak_force")
                assert measured[f"{axle}_peak_force"] == pytest.approx((0.25 if on else 1.0) * full, rel=1e-12)
    assert len(seen) == 4


@in_python
def test_ice_on_both_sides_is_everywhere():
    env = make(**neutral(ice=IcePatch(begin=0.0, length=1e6, factor=0.5, edge=None)))
    plain = make(**neutral(friction=(0.5, 0.5)))
    for each in (env, plain):
        each.reset(seed=1, options={"state": {"longitudinal_position": 10.0, "yaw_rate": 0.3}})
    for action in 0.2 * actions(20)[:, 0]:
        assert env.step(action)[0].tobytes() == plain.step(action)[0].tobytes()


@in_python
@pytest.mark.exhaustive
def test_a_friction_step_is_another_friction_from_then_on():
    stepped, slippery = make(**neutral(step=FrictionStep(at=0.0, front=0.6, rear=0.6))), make(friction=0.6)
    for env in (stepped, slippery):
        env.reset(seed=1)
    assert stepped.measure()["front_peak_force"] == pytest.approx(slippery.measure()["front_peak_force"], rel=1e-15)
    later = make(**neutral(step=FrictionStep(at=0.1, front=0.6, rear=0.6)))
    later.reset(seed=1)
    peaks = []
    for _ in range(8):
        peaks.append(later.measure()["rear_peak_force"])
        later.step(np.zeros(2, np.float32))
    assert [peak == peaks[0] for peak in peaks] == [True] * 5 + [False] * 3
    assert peaks[-1] == 0.6 * peaks[0]


@in_python
@pytest.mark.parametrize("axle", ["front", "rear"])
def test_a_loss_of_stiffness_is_another_car_from_then_on(axle):
    lost = make(**neutral(loss=StiffnessLoss(axle=axle, at=0.0, factor=0.7)), speed=30.0)
    name = f"{axle}_cornering_stiffness"
    soft = dataclasses.replace(CAR, **{name: 0.7 * getattr(CAR, name)})
    _, states = drive(lost, actions(20)[:, 0])
    _, expected = drive(make(vehicle=soft, speed=30.0), actions(20)[:, 0])
    np.testing.assert_allclose([s[:10] for s in states], expected, rtol=1e-12, atol=1e-14)


@in_python
@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_side_wind_pushes_to_its_side(side, sign):
    env = make(**neutral(gust=Gust(force=800.0, start=0.0, duration=5.0, arm=0.4, side=side)))
    env.reset(seed=0, options={"state": {}})
    assert env.measure()["lateral_acceleration"] == pytest.approx(sign * 800.0 / CAR.mass, rel=1e-12)
    assert env.measure()["yaw_acceleration"] == pytest.approx(sign * 320.0 / CAR.yaw_inertia, rel=1e-12)


# Drivers


def wheel_of(driver, time):
    """The driver's law at these times."""
    own = types.SimpleNamespace(**driver.numbers())
    return driver.law(NUMPY, None)(None, None, time, own, None)


def test_scripted_manoeuvres_by_their_formulas():
    time = 0.02 * np.arange(150)
    np.testing.assert_array_equal(wheel_of(drivers.Step(angle=0.01, start=0.5), time), np.where(time >= 0.5, 0.01, 0.0))
    since, period = np.maximum(time - 0.5, 0.0), 1.0 / 0.7
    pieces = [since < 0.75 * period, since < 0.75 * period + 0.5, since < period + 0.5]
    sine = 0.01 * np.sin(2.0 * np.pi * 0.7 * since)
    late = 0.01 * np.sin(2.0 * np.pi * 0.7 * (since - 0.5))
    wheel = wheel_of(drivers.SineWithDwell(amplitude=0.01, frequency=0.7, dwell=0.5, start=0.5), time)
    np.testing.assert_allclose(wheel, np.select(pieces, [sine, -0.01, late], 0.0), atol=1e-14)
    since = np.clip(time - 0.2, 0.0, 2.0)
    chirp = 0.005 * np.sin(2.0 * np.pi * (0.5 * since + 0.5 * since**2))
    wheel = wheel_of(drivers.SineSweep(amplitude=0.005, first=0.5, last=2.5, duration=2.0, start=0.2), time)
    np.testing.assert_allclose(wheel, np.where(time - 0.2 < 2.0, chirp, 0.0), atol=1e-14)


def test_a_recording_is_followed_by_straight_lines_and_held():
    time = 0.02 * np.arange(150)
    angles = np.random.default_rng(0).uniform(-0.02, 0.02, 40)
    wheel = wheel_of(drivers.Recorded(angles, timestep=0.05, start=0.3), time)
    expected = np.where(time >= 0.3, np.interp(time - 0.3, 0.05 * np.arange(40), angles), 0.0)
    np.testing.assert_allclose(wheel, expected, atol=1e-15)
    assert wheel[-1] == angles[-1]


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.exhaustive
def test_a_recording_is_the_same_for_one_car_many_and_tensors(dtype):
    given = {**QUICK, "driver": drivers.Recorded(0.02 * np.sin(np.arange(30.0)), timestep=0.03, side="random")}
    many = gym.make_vec(STAB, CARS, **given, dtype=dtype, autoreset_mode="Disabled").unwrapped
    tensors = TorchVectorEnv(STAB, CARS, **given, dtype=dtype, autoreset_mode="Disabled")
    alone = [gym.make(STAB, **given).unwrapped for _ in range(CARS)]
    many.reset(seed=0)
    tensors.reset(seed=0)
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.state._asdict().items()})
    for k, env in enumerate(alone):
        env.reset(seed=k)
    close = {"rtol": 1e-12, "atol": 1e-12} if dtype == "float64" else {"rtol": 1e-4, "atol": 1e-5}
    for action in 0.1 * actions(8):
        many.step(action)
        tensors.step(torch.from_numpy(action))
        np.testing.assert_allclose(tensors.state.front_steer, many.state.front_steer, **close)
        for k, env in enumerate(alone):
            env.step(action[k])
            if dtype == "float64":
                assert env.state == tuple(column[k] for column in many.state)
            else:
                assert many.state.front_steer[k] == pytest.approx(env.state.front_steer, rel=1e-4, abs=1e-5)


def commands_of(driver, steps, action):
    env = make(**neutral(driver=driver), vehicle="civic", speed=20.0, front_actuator={"angle_limit": 0.5})
    env.reset(seed=0, options={"state": {}})
    found = []
    for _ in range(steps):
        env.step(np.array(action, np.float32))
        found.append(env.state.front_steer_command)
    return np.array(found)


@in_python
@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_the_manoeuvre_reaches_the_front_wheels_and_the_action_corrects_it(side, sign):
    driver = drivers.SineWithDwell(amplitude=0.1, start=0.0, side=side)
    alone = sign * wheel_of(driver, 0.02 * np.arange(10))
    np.testing.assert_allclose(commands_of(driver, 10, (0.0, 0.0)), alone, atol=1e-15)
    np.testing.assert_allclose(commands_of(driver, 10, (0.5, 0.0)), alone + 0.25, rtol=1e-12)
    strong = drivers.SineWithDwell(amplitude=0.4, start=0.0, side=side)
    wanted = 4.0 * alone + sign * 0.25
    assert np.max(np.abs(wanted)) > 0.5
    np.testing.assert_allclose(commands_of(strong, 10, (sign * 0.5, 0.0)), np.clip(wanted, -0.5, 0.5), rtol=1e-12)


@in_python
def test_who_looks_ahead_changes_the_lane_alone():
    env = gym.make(LANE, vehicle="civic", speed=25.0, steer="rear", driver="preview", direction="left").unwrapped
    _, states = drive(env, [np.zeros(1, np.float32)] * 250)
    assert env.end == ""
    assert states[-1].lateral_position == pytest.approx(3.5, abs=0.3)
    assert max(state.lateral_position for state in states) < 4.5


# Delays


@in_python
@pytest.mark.parametrize("delay", [3, only_all(1)])
def test_actions_arrive_later(delay):
    commands = actions(20)[:, 0]
    _, late = drive(make(action_delay=delay), commands)
    shifted = np.concatenate([np.zeros((delay, 2), np.float32), commands[:-delay]])
    _, expected = drive(make(), shifted)
    assert [state[:10] for state in late] == [tuple(state) for state in expected]


@in_python
@pytest.mark.parametrize("env_id", [only_all(LANE), only_all(STAB)])
def test_observations_are_of_earlier(env_id):
    commands = actions(20)[:, 0]
    late, _ = drive(make(env_id, observation_delay=2), commands)
    now, _ = drive(make(env_id), commands)
    size = 8 if env_id == STAB else 10
    np.testing.assert_array_equal(late[2:, :size], now[:-2, :size])
    np.testing.assert_array_equal(late[:2, :size], now[[0, 0], :size])
    np.testing.assert_array_equal(late[:, size:], now[:, size:])


@in_python
@pytest.mark.parametrize("env_id", [LANE, only_all(STAB)])
def test_the_latest_observations_stand_side_by_side(env_id):
    commands = actions(20)[:, 0]
    env = make(env_id, history=3)
    seen, _ = drive(env, commands)
    now, _ = drive(make(env_id), commands)
    size = 8 if env_id == STAB else 10
    for back in range(3):
        earlier = now[np.maximum(np.arange(len(now)) - back, 0), :size]
        np.testing.assert_array_equal(seen[:, back * size : (back + 1) * size], earlier)
    np.testing.assert_array_equal(seen[:, 3 * size :], now[:, size:])
    names = env.observation_names
    assert (names[3], names[size + 3], names[2 * size + 3]) == ("yaw_rate", "yaw_rate_1_ago", "yaw_rate_2_ago")
    assert names[3 * size :] == make(env_id).observation_names[size:]
    assert env.observation_scale[size + 2] == env.observation_scale[2]


# As keywords


def test_plain_forms_and_json_make_equal_environments():
    plain = {
        "randomise": {"friction": [0.3, 1.0], "mass": {"low": 0.9, "high": 1.2, "relative": True}},
        "disturbances": [dataclasses.asdict(one) for one in EVERYTHING["disturbances"]],
        "driver": dataclasses.asdict(EVERYTHING["driver"]),
    }
    objects = {name: EVERYTHING[name] for name in ("disturbances", "driver")}
    ranges = {"mass": distributions.Uniform(0.9, 1.2, relative=True), "friction": (0.3, 1.0)}
    assert altered(Stabilise(), **plain) == altered(Stabilise(), **objects, randomise=ranges)
    mine = make(**EVERYTHING)
    assert gym.make(EnvSpec.from_json(mine.spec.to_json())).unwrapped.task == mine.task


@pytest.mark.parametrize(
    ("keywords", "match"),
    [
        ({"randomise": {"grip": (0.3, 1.0)}}, "randomise: parameter must be one of .*got 'grip'"),
        ({"randomise": {"fricton": (0.3, 1.0)}}, "did you mean 'friction'"),
        ({"randomise": {"friction": (1.0, 0.3)}}, r"randomise\['friction'\]: high must be"),
        (
            {"randomise": {"friction": 0.3}},
            r"must be \(low, high\) or .*'relative'\), or one of bicycle_env.distributions, got 0.3",
        ),
        ({"randomise": {"mass": (1e-3, 1.0, "relative")}}, "physics_timestep must be <="),
        ({"randomise": 3}, "randomise must be a mapping"),
        ({"disturbances": Gust()}, r"disturbances must be a tuple of disturbances, for example \(Gust\(\),\)"),
        ({"disturbances": ({"name": "gst"},)}, r"disturbances\[0\]: name must be .*did you mean 'gust'"),
        ({"disturbances": ({"name": "gust", "force": -1.0},)}, r"disturbances\[0\]: force must be"),
        ({"disturbances": (3,)}, r"disturbances\[0\] must be a Disturbance"),
        ({"driver": "sine"}, "driver must be one of"),
        ({"driver": 3}, "driver must be None, one of"),
        ({"action_delay": -1}, "action_delay must be"),
        ({"observation_delay": 0.5}, "observation_delay must be"),
        ({"action_delay": 51}, "action_delay must be"),
    ],
)
def test_a_mistake_is_named(keywords, match):
    with pytest.raises((TypeError, ValueError), match=match) as error:
        make(**keywords)
    assert "\n" not in str(error.value).partition(" was raised")[0]


@pytest.mark.parametrize(
    ("law", "given", "match"),
    [
        (Gust, {"force": (5.0, 1.0)}, r"force\[1\] must be"),
        (Gust, {"force": (5.0,)}, r"force must be a number or \(low, high\)"),
        (Gust, {"side": "up"}, "side must be one of"),
        (Gust, {"strength": 1.0}, "unknown keyword of Gust 'strength'"),
        (StiffnessLoss, {"axle": "middle"}, "axle must be one of"),
        (FrictionStep, {"front": 0.0}, "front must be"),
        (drivers.Step, {"angle": -0.1}, "angle must be"),
        (drivers.Step, {"side": "up"}, "side must be one of"),
    ],
)
def test_an_objects_mistake_is_named(law, given, match):
    with pytest.raises((TypeError, ValueError), match=match):
        law(**given)


# One's own


@dataclasses.dataclass(frozen=True)
class Puncture(Disturbance):
    """The rear axle loses stiffness and grip at a place on the road."""

    name: str = "puncture"
    place: float = 30.0

    def amounts(self):
        return {"place": self.place}

    def law(self, xp):
        soft = replaced(xp, CarParameters, ("rear_cornering_stiffness", "rear_peak_force"))

        def puncture(car, own, fixed, time, state):
            left = xp.where(time * car.speed > own.place, 0.4, 1.0 + 0.0 * time)
            return soft(car, left * car.rear_cornering_stiffness, left * car.rear_peak_force)

        return puncture


@dataclasses.dataclass(frozen=True)
class Countersteer(drivers.Driver):
    """Steers against the yaw rate."""

    name: str = "countersteer"
    sided = False
    gain: float = 0.1

    def law(self, xp, reference):
        def countersteer(state, task_state, time, own, world):
            return -own.gain * state.yaw_rate

        return countersteer


def test_a_disturbance_and_a_driver_of_ones_own():
    task = altered(Stabilise(), disturbances=(Puncture(place=15.0),), driver=Countersteer(gain=0.2))
    check(task)
    assert {"puncture_place", "driver_side"} <= set(task.TaskState._fields)
    car = car_on_road(CAR, 30.0, 1.0, actuators.FRONT, actuators.REAR)
    world = World(car, Rules(0.02, 5, 400, 1.0, 1.0), task.settings(30.0))
    state, own = task.start(NUMPY)(np.full(task.uniforms, 0.7), world)
    episode = EpisodeState(0.0, 0.0, 10.0, 0.0, own)
    command = command_of(NUMPY, task)(state, episode, (0.0, 0.0), world)
    assert command == (
        pytest.approx(np.clip(-0.2 * state.yaw_rate, -car.front_angle_limit, car.front_angle_limit)),
        0.0,
    )
    peaks = [task.conditions(NUMPY)(state, episode, time, world).rear_peak_force for time in (0.4, 0.6)]
    assert peaks == pytest.approx([car.rear_peak_force, 0.4 * car.rear_peak_force])


# What a newcomer tripped over


@dataclasses.dataclass(frozen=True)
class Own(Disturbance):
    """Pushes to the left, and does not say that this has a mirror image."""

    side: object = "left"

    def amounts(self):
        return {"side": 1.0}

    def law(self, xp):
        pushed = replaced(xp, CarParameters, ("side_force",))
        return lambda car, own, fixed, time, state: pushed(car, own.side)


@pytest.mark.parametrize(
    ("name", "side", "match"),
    [
        (None, "left", r"^disturbances\[0\]: Own must have a name that is a word"),
        ("two words", "left", r"^disturbances\[0\]: Own must have a name that is a word"),
        ("own", 1.0, r"^disturbances\[0\]: side must be one of 'left', 'right', 'random', got 1\.0"),
        ("own", "left", "task DisturbedTask: its law 'conditions' .*of a disturbance: `flips`"),
    ],
)
def test_a_disturbance_of_ones_own_that_lacks_something_is_told_what(monkeypatch, name, side, match):
    monkeypatch.setattr(Own, "name", name, raising=False)
    with pytest.raises((TypeError, ValueError), match=match):
        make(disturbances=(Own(side),))


@in_python
@pytest.mark.exhaustive
def test_a_start_that_is_given_is_what_is_observed_at_first():
    """Late observations are of the given start, not of the drawn one: in every environment."""
    given = {"state": {"yaw_rate": 0.2, "lateral_position": 1.0}}
    single = make(observation_delay=2)
    observation, _ = single.reset(seed=0, options=given)
    now, _ = make().reset(seed=0, options=given)
    np.testing.assert_array_equal(observation, now)
    for _ in range(2):
        np.testing.assert_array_equal(single.step(np.zeros(2, np.float32))[0], now)
    felt = {"sensors": {"signals": ["yaw_rate", "lateral_acceleration"]}}
    frames, _ = make(history=2, observation_delay=1, **felt).reset(seed=0, options=given)
    np.testing.assert_array_equal(frames, np.tile(make(**felt).reset(seed=0, options=given)[0], 2))
    assert frames[1] > 0.5
    for envs in (
        gym.make_vec(STAB, 4, **QUICK, observation_delay=2),
        TorchVectorEnv(STAB, 4, **QUICK, observation_delay=2),
    ):
        seen, _ = envs.reset(seed=0, options=given)
        np.testing.assert_allclose(np.asarray(seen), np.tile(now, (4, 1)), rtol=1e-6)


@in_python
@pytest.mark.exhaustive
def test_a_snapshot_of_other_options_is_refused():
    one, other = make(randomise={"friction": (0.4, 1.0)}), make(randomise={"mass": (1500.0, 1800.0)})
    for env in (one, other):
        env.reset(seed=0)
    with pytest.raises(TypeError, match="same id and keywords: its state has friction, mass more or less"):
        other.restore(one.snapshot())
    one, other = (
        gym.make_vec(STAB, 4, **QUICK, randomise=given).unwrapped
        for given in ({"friction": (0.4, 1.0)}, {"mass": (1500.0, 1800.0)})
    )
    for env in (one, other):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="equal environment"):
        other.restore(one.snapshot())


@in_python
@pytest.mark.parametrize("many", [False, only_all(True)])
def test_environments_and_states_pickle(many):
    env = gym.make_vec(STAB, CARS, **QUICK, **EVERYTHING, **LATE) if many else gym.make(STAB, **QUICK, **EVERYTHING)
    env.reset(seed=0)
    again = pickle.loads(pickle.dumps(env))
    action = np.full(env.action_space.shape, 0.1, np.float32)
    assert again.step(action)[0].tobytes() == env.step(action)[0].tobytes()
    state = pickle.loads(pickle.dumps(env.unwrapped.state))
    assert state._fields == env.unwrapped.state._fields
    assert type(state) is type(env.unwrapped.state)


@pytest.mark.parametrize(
    ("make_it", "match"),
    [
        (lambda: Sensors(noise=0.1), "noise must be a mapping of the observation's entries to numbers"),
        (lambda: make(disturbances=(Loose(),)), "must be a frozen dataclass"),
        (
            lambda: check(variant(conditions=lambda self, xp: lambda *_: None)),
            "'conditions' gives None: is its `return`",
        ),
    ],
)
def test_a_newcomers_mistake_is_named(make_it, match):
    with pytest.raises((TypeError, ValueError), match=match):
        make_it()


class Loose(Disturbance):
    name = "loose"

    def amounts(self):
        return {}

    def law(self, xp):
        return lambda car, own, fixed, time, state: car


def variant(**laws):
    return dataclasses.dataclass(frozen=True)(type("Variant", (Stabilise,), laws))()
