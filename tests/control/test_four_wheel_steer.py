"""Rear-steer laws: zero sideslip against closed forms and simulation, yaw-rate feedback against its eigenvalues."""

import itertools
import math

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import analysis, simulate, vehicles
from bicycle_env.analysis.transfer_functions import numerator
from bicycle_env.control.driver import DRIVERS, Preview
from bicycle_env.control.four_wheel_steer import (
    COMBINATIONS,
    REAR_LAWS,
    DriverAndLaw,
    RearLaw,
    Sano,
    SpeedDependent,
    YawRate,
    ZeroSideslip,
    critical_speed_with_yaw_rate_feedback,
    driver_and_law,
    yaw_rate_feedback_gain,
    yaw_rate_feedback_matrix,
    zero_sideslip_ratio,
    zero_sideslip_yaw_rate,
    zero_sideslip_yaw_rate_gain,
)
from bicycle_env.physics.actuators import Actuator

STABILISE, LANE_CHANGE = "BicycleStab-v0", "BicycleLaneChange-v0"
OVERSTEER = vehicles["oversteer"]
FAST = 1.2 * OVERSTEER.critical_speed
BIG = Actuator(angle_limit=0.5)
every_vehicle = pytest.mark.parametrize("name", vehicles)
speeds = pytest.mark.parametrize("speed", [4.0, 12.0, 25.0, 45.0])


def plant(env_id=STABILISE, **keywords):
    return gym.make(env_id, **keywords).unwrapped


def linear_plant(**keywords):
    """The linear tire, small angles and steering angles that reach far: what the laws are derived for."""
    return plant(tire="linear", geometry="small_angle", front_actuator=BIG, rear_actuator=BIG, **keywords)


# The ratio of zero steady sideslip


@every_vehicle
@speeds
def test_the_ratio_has_no_sideslip_in_steady_turns(name, speed):
    vehicle = vehicles[name]
    front, rear = (
        analysis.steady_state_gain(vehicle, speed, f"{axle}_steer", "sideslip") for axle in ("front", "rear")
    )
    assert abs(front + zero_sideslip_ratio(vehicle, speed) * rear) < 1e-12 * abs(front)


@every_vehicle
def test_the_ratio_changes_sign_at_the_tangent_speed(name):
    """U^2 = b L Cr / (a m): there the front wheels alone leave no sideslip."""
    vehicle = vehicles[name]
    a, b = vehicle.cg_to_front, vehicle.cg_to_rear
    speed = math.sqrt(b * vehicle.wheelbase * vehicle.rear_cornering_stiffness / (a * vehicle.mass))
    assert analysis.tangent_speed(vehicle) == pytest.approx(speed, rel=1e-12)
    assert zero_sideslip_ratio(vehicle, speed) == pytest.approx(0.0, abs=1e-12)
    assert zero_sideslip_ratio(vehicle, 0.99 * speed) < 0.0 < zero_sideslip_ratio(vehicle, 1.01 * speed)
    assert zero_sideslip_ratio(vehicle, 1e-3) == pytest.approx(-b / a, rel=1e-6)
    limit = a * vehicle.front_cornering_stiffness / (b * vehicle.rear_cornering_stiffness)
    assert zero_sideslip_ratio(vehicle, 1e6) == pytest.approx(limit, rel=1e-6)


@pytest.mark.parametrize(("name", "speed"), [("understeer", 10.0), ("understeer", 35.0), ("oversteer", 30.0)])
def test_a_simulated_turn_ends_without_sideslip(name, speed):
    ratio = zero_sideslip_ratio(vehicles[name], speed)
    turn = simulate(name, speed, (0.01, ratio * 0.01), 15.0, tire="linear")
    front_only = simulate(name, speed, (0.01, 0.0), 15.0, tire="linear")
    assert abs(turn["sideslip"][-1]) < 1e-6
    assert abs(turn["yaw_rate"][-1]) > 1e-3
    assert abs(front_only["sideslip"][-1]) > 1e-3
    assert np.max(np.abs(turn["sideslip"])) > 1e-4, "in the transient there is sideslip"


@every_vehicle
@speeds
def test_motion_without_sideslip(name, speed):
    """V = V' = 0 in (6.22) and (6.23)."""
    vehicle = vehicles[name]
    A, B = analysis.state_matrix(vehicle, speed), analysis.input_matrix(vehicle, speed)
    gain, time_constant = zero_sideslip_yaw_rate(vehicle, speed)
    front, yaw_rate = 0.02, 0.3
    at_once = -vehicle.front_cornering_stiffness / vehicle.rear_cornering_stiffness
    rear = at_once * front + zero_sideslip_yaw_rate_gain(vehicle, speed) * yaw_rate
    change = A @ [0.0, yaw_rate] + B @ [front, rear]
    assert abs(change[0]) < 1e-12 * abs(A[0, 1])
    assert change[1] == pytest.approx((gain * front - yaw_rate) / time_constant, rel=1e-9)
    steady = at_once + zero_sideslip_yaw_rate_gain(vehicle, speed) * gain
    assert steady == pytest.approx(zero_sideslip_ratio(vehicle, speed), abs=1e-9)


def test_bad_speeds_are_refused():
    for function in (zero_sideslip_ratio, zero_sideslip_yaw_rate_gain, zero_sideslip_yaw_rate, yaw_rate_feedback_gain):
        with pytest.raises(ValueError, match="speed must be a finite number > 0, got 0"):
            function(OVERSTEER, 0.0)
        with pytest.raises(TypeError, match="speed"):
            function(OVERSTEER, "30")


# Zero sideslip in transients


@every_vehicle
@speeds
def test_the_filter_cancels_the_sideslip_of_the_front_wheels(name, speed):
    """N_f (1 + T s) + N_r (k_0 - (Cf/Cr) T s) = 0 for the numerators of V."""
    vehicle = vehicles[name]
    _, time_constant = zero_sideslip_yaw_rate(vehicle, speed)
    at_once = -vehicle.front_cornering_stiffness / vehicle.rear_cornering_stiffness
    front, rear = (numerator(vehicle, speed, f"{axle}_steer", "lateral_velocity") for axle in ("front", "rear"))
    first = np.polymul(front, [time_constant, 1.0])
    second = np.polymul(rear, [at_once * time_constant, zero_sideslip_ratio(vehicle, speed)])
    np.testing.assert_allclose(first, -second, rtol=1e-9, atol=1e-9 * np.max(np.abs(first)))


def largest_sideslip(law, env, seed=0):
    """Peak |sideslip|, rad, from rest under smooth random front steering of 0.05 rad."""
    rng = np.random.default_rng(seed)
    time = env.control_timestep * np.arange(round(4.0 / env.control_timestep))
    waves = [np.sin(rate * time + phase) for rate, phase in zip((1.0, 3.0, 7.0), rng.uniform(0, 6, 3), strict=True)]
    fronts = 0.05 / 0.5 * np.sum(waves, axis=0) / 3.0 * np.minimum(1.0, time / 0.2)
    observation, _ = env.reset(options={"state": {}})
    law.reset()
    peak = 0.0
    for front in fronts:
        rear = law.act(np.float32(front), observation)
        observation, _, terminated, _, _ = env.step(np.array([front, rear], np.float32))
        peak = max(peak, abs(env.state.lateral_velocity / env.speed))
        if terminated:
            break
    return peak


@pytest.mark.parametrize(("name", "speed"), [("understeer", 12.0), ("understeer", 30.0), ("civic", 30.0)])
def test_sideslip_stays_at_zero_in_transients(name, speed):
    env = linear_plant(vehicle=name, speed=speed)
    zero, steady = largest_sideslip(ZeroSideslip(env), env), largest_sideslip(SpeedDependent(env), env)
    assert steady > 3e-3
    assert zero < 0.03 * steady


def test_what_is_left_is_the_control_step():
    """Of second order in it: within a step the law holds the mean of what it should give."""
    left = []
    for timestep in (0.04, 0.02, 0.01):
        env = linear_plant(vehicle="understeer", speed=30.0, control_timestep=timestep, physics_timestep=0.002)
        left.append(largest_sideslip(ZeroSideslip(env), env))
    for coarse, fine in itertools.pairwise(left):
        assert 3.0 < coarse / fine < 5.0


def test_the_rear_wheels_turn_against_the_front_ones_first():
    env = plant(vehicle="understeer", speed=25.0)
    law = ZeroSideslip(env)
    rears = np.array([law.act(np.float32(0.1), np.zeros(8, np.float32)) for _ in range(40)])
    assert rears[0] < 0.0 < rears[-1]
    ratio = env.front_actuator.angle_limit / env.rear_actuator.angle_limit * law.ratio
    assert rears[-1] == pytest.approx(0.1 * ratio, rel=1e-5)


# Feedforward and the unstable mode


def test_no_driver_reaches_the_sideslip_that_a_feedforward_keeps_at_zero():
    """The front command drives the model's yaw rate only: whatever the feedback, both open-loop eigenvalues stay."""
    open_loop = np.sort(analysis.eigenvalues(OVERSTEER, FAST).real)
    assert open_loop[-1] == pytest.approx(0.64, abs=0.005)
    A, B = analysis.state_matrix(OVERSTEER, FAST), analysis.input_matrix(OVERSTEER, FAST)
    gain, time_constant = zero_sideslip_yaw_rate(OVERSTEER, FAST)
    at_once = -OVERSTEER.front_cornering_stiffness / OVERSTEER.rear_cornering_stiffness
    whole = np.zeros((3, 3))
    whole[:2, :2] = A
    whole[:2, 2] = zero_sideslip_yaw_rate_gain(OVERSTEER, FAST) * B[:, 1]
    whole[2, 2] = -1.0 / time_constant
    front = np.append(B[:, 0] + at_once * B[:, 1], gain / time_constant)
    rng = np.random.default_rng(0)
    for _ in range(5):
        closed = np.linalg.eigvals(whole - np.outer(front, rng.normal(size=3)))
        for value in open_loop:
            assert np.min(np.abs(closed - value)) < 1e-8


@pytest.mark.parametrize("name", ["speed-dependent", "sano", "zero-sideslip"])
def test_feedforward_leaves_the_eigenvalues_and_the_car_diverges(name):
    env = linear_plant(speed=FAST)
    law = REAR_LAWS[name](env)
    assert law.yaw_rate_gain == 0.0
    assert np.array_equal(law.front_model().A, env.linear_model().A)
    env.reset(options={"state": {"yaw_rate": 1e-4}})
    observation, rates = np.zeros(8, np.float32), []
    for _ in range(150):
        observation, *_ = env.step(np.array([0.0, law.act(np.float32(0.0), observation)], np.float32))
        rates.append(env.state.yaw_rate)
    growth = math.log(rates[-1] / rates[-51]) / (50 * env.control_timestep)
    assert growth == pytest.approx(max(analysis.eigenvalues(OVERSTEER, FAST).real), rel=1e-3)


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize(("law", "expected"), [("speed-dependent", 1.04), ("zero-sideslip", 0.64)])
def test_drivers_cannot_hold_the_unstable_car_with_such_a_law(driver, law, expected):
    """Of the linear car with small angles, far from all limits: how fast it leaves the straight line."""
    env = linear_plant(speed=FAST)
    policy = driver_and_law(f"{driver}+{law}", env)
    observation, _ = env.reset(options={"state": {"yaw_rate": 1e-4}})
    rates = []
    for _ in range(300):
        observation, *_ = env.step(policy.act(observation))
        rates.append(env.state.yaw_rate)
    growth = math.log(rates[-1] / rates[-101]) / (100 * env.control_timestep)
    assert growth == pytest.approx(expected, abs=0.02)


# Yaw-rate feedback


@every_vehicle
@speeds
def test_what_yaw_rate_feedback_does_to_the_characteristic_polynomial(name, speed):
    vehicle, gain = vehicles[name], 0.2
    front, rear = vehicle.front_cornering_stiffness, vehicle.rear_cornering_stiffness
    expected = analysis.characteristic_polynomial(vehicle, speed)
    expected[1] += gain * vehicle.mass * vehicle.cg_to_rear * rear
    expected[2] += gain * vehicle.wheelbase * front * rear / speed
    polynomial = expected[0] * np.poly(yaw_rate_feedback_matrix(vehicle, speed, gain))
    np.testing.assert_allclose(polynomial, expected, rtol=1e-9)
    # In a steady turn it is understeer: r = U delta_f / (L + K U^2) with K + gain / U for K.
    yaw_rate = -np.linalg.solve(
        yaw_rate_feedback_matrix(vehicle, speed, gain), analysis.input_matrix(vehicle, speed)[:, 0]
    )[1]
    gradient = analysis.understeer_gradient(vehicle) + gain / speed
    assert yaw_rate == pytest.approx(speed / (vehicle.wheelbase + gradient * speed**2), rel=1e-9)


@pytest.mark.parametrize("name", ["oversteer", "me303"])
@pytest.mark.parametrize("gain", [0.0, 0.05, 0.3, 1.0])
def test_the_critical_speed_moves(name, gain):
    vehicle = vehicles[name]
    speed = critical_speed_with_yaw_rate_feedback(vehicle, gain)
    x = gain * vehicle.critical_speed / (2.0 * vehicle.wheelbase)
    assert speed == pytest.approx(vehicle.critical_speed * math.exp(math.asinh(x)), rel=1e-12)
    below, above = (
        np.max(np.linalg.eigvals(yaw_rate_feedback_matrix(vehicle, factor * speed, gain)).real)
        for factor in (0.999, 1.001)
    )
    assert below < 0.0 < above


def test_a_car_without_a_critical_speed_gets_none():
    assert critical_speed_with_yaw_rate_feedback(vehicles["understeer"], 0.1) == math.inf
    assert critical_speed_with_yaw_rate_feedback(vehicles["neutral"], 0.0) == math.inf
    with pytest.raises(ValueError, match="gain must be a finite number >= 0"):
        critical_speed_with_yaw_rate_feedback(OVERSTEER, -0.1)


@every_vehicle
@speeds
@pytest.mark.parametrize(("margin", "ratio"), [(2.0, 1.0), (1.5, 0.7), (4.0, 0.0)])
def test_the_gain_is_the_least_with_both_properties(name, speed, margin, ratio):
    vehicle = vehicles[name]
    gain = yaw_rate_feedback_gain(vehicle, speed, margin, ratio)

    def holds(gain):
        trace, determinant = (f(yaw_rate_feedback_matrix(vehicle, speed, gain)) for f in (np.trace, np.linalg.det))
        damped = determinant > 0.0 and -trace >= 2.0 * ratio * math.sqrt(determinant) * (1.0 - 1e-9)
        return damped and critical_speed_with_yaw_rate_feedback(vehicle, gain) >= margin * speed * (1.0 - 1e-9)

    assert holds(gain)
    assert gain == 0.0 or not holds(0.999 * gain)


def test_the_default_gain_of_the_oversteering_car():
    gain = yaw_rate_feedback_gain(OVERSTEER, FAST)
    assert critical_speed_with_yaw_rate_feedback(OVERSTEER, gain) == pytest.approx(2.0 * FAST, rel=1e-9)
    values = np.sort(np.linalg.eigvals(yaw_rate_feedback_matrix(OVERSTEER, FAST, gain)).real)
    np.testing.assert_allclose(values, [-11.73, -1.70], atol=0.005)
    for keywords in ({"speed_margin": 1.0}, {"damping_ratio": 1.1}, {"damping_ratio": -0.1}):
        with pytest.raises(ValueError, match=next(iter(keywords))):
            yaw_rate_feedback_gain(OVERSTEER, FAST, **keywords)


def test_the_closed_loop_is_what_the_environment_does():
    """The front wheels straight: x+ = A x with the law closed, lag and hold included; its slowest mode as predicted."""
    env = linear_plant(speed=FAST)
    law = YawRate(env)
    loop = law.front_model().A
    x = np.array([0.0, 0.0, 0.02, 0.01, 0.0, 0.0])
    observation, _ = env.reset(options={"state": {"lateral_velocity": 0.02, "yaw_rate": 0.01}})
    yaw_rates = []
    for _ in range(100):
        observation, *_ = env.step(np.array([0.0, law.act(np.float32(0.0), observation)], np.float32))
        x = loop @ x
        np.testing.assert_allclose(
            [env.state.lateral_velocity, env.state.yaw_rate, env.state.rear_steer], x[[2, 3, 5]], rtol=1e-4, atol=1e-7
        )
        yaw_rates.append(env.state.yaw_rate)
    decay = math.log(yaw_rates[60] / yaw_rates[40]) / (20 * env.control_timestep)
    assert decay == pytest.approx(-1.85, abs=0.05), "the actuator's lag moves it from -1.70 1/s"


@pytest.mark.parametrize("name", ["speed-dependent", "yaw-rate"])
def test_the_drivers_model_is_the_car_with_the_law(name):
    env = plant(vehicle="civic", speed=30.0, front_actuator=Actuator(angle_limit=0.4))
    model, law = env.linear_model(), REAR_LAWS[name](env)
    known = law.front_model()
    x, front = 0.01 * np.random.default_rng(3).normal(size=6), 0.03
    observation = np.zeros(8)
    observation[3] = x[3] / env.observation_scale[3]
    rear = law.act(np.float64(front), observation)
    assert 0.01 < abs(rear) < 0.9
    np.testing.assert_allclose(known.A @ x + known.B[:, 0] * front, model.A @ x + model.B @ [front, rear], rtol=1e-6)
    assert known.B.shape == (6, 1)
    assert known.R.shape == (1, 1)
    assert known.input_names == ("front_steer_command",)
    assert known.input_scale.tolist() == [0.4]


@every_vehicle
@pytest.mark.parametrize("speed", [12.0, 25.0, 45.0])
@pytest.mark.parametrize("name_of_law", ["speed-dependent", "zero-sideslip", "yaw-rate"])
def test_steady_turns_have_no_sideslip(name, speed, name_of_law):
    env = plant(vehicle=name, speed=speed)
    law = REAR_LAWS[name_of_law](env)
    A = yaw_rate_feedback_matrix(env.vehicle, speed, law.yaw_rate_gain)
    lateral_velocity, yaw_rate = -np.linalg.solve(A, analysis.input_matrix(env.vehicle, speed) @ [1.0, law.ratio])
    assert abs(lateral_velocity) < 1e-9 * speed
    assert yaw_rate == pytest.approx(zero_sideslip_yaw_rate(env.vehicle, speed)[0], rel=1e-6)


# Sano's law


def test_the_rear_angle_goes_through_the_published_points():
    law = Sano(linear_plant())
    for front, rear in Sano.points:
        for side in (1.0, -1.0):
            angle = law.rear_steer(np.radians([side * front]), np.zeros(1))
            np.testing.assert_allclose(angle, np.radians([side * rear]), atol=1e-12)
    fronts = np.radians(np.linspace(0.0, 35.0, 351))
    rears = np.degrees(law.rear_steer(fronts, np.zeros(351)))
    assert np.max(rears) == pytest.approx(1.5)
    assert np.all(np.diff(rears[:91]) > 0.0)
    assert np.all(np.diff(rears[90:301]) < 0.0)
    np.testing.assert_allclose(rears[300:], -5.3)
    assert law.ratio == pytest.approx(1.0 / 6.0)
    assert law.rear_steer(np.array([1e-6]), np.zeros(1))[0] == pytest.approx(1e-6 / 6.0, rel=1e-4)


# What every law and combination keeps


@pytest.mark.parametrize("name", COMBINATIONS)
def test_many_cars_are_single_cars_and_mirrored_ones_steer_mirrored(name):
    env = plant(LANE_CHANGE)
    rng = np.random.default_rng(0)
    observations = rng.uniform(-0.05, 0.05, (25, 8, len(env.observation_names))).astype(np.float32)
    observations[:, 0] *= 100.0  # beyond the limits
    policy, mirrored, alone = (driver_and_law(name, env) for _ in range(3))
    actions = np.array([policy.act(observation) for observation in observations])
    assert policy.name == name
    assert actions.shape == (25, 8, 2)
    assert actions.dtype == np.float32
    assert np.max(np.abs(actions)) == 1.0
    assert len(np.unique(actions[..., 1])) > 20
    mirror = env.observation_mirror.astype(np.float32)
    assert np.array_equal(actions, [-mirrored.act(observation * mirror) for observation in observations])
    for car in (0, 5):
        alone.reset()
        assert np.array_equal([alone.act(observation) for observation in observations[:, car]], actions[:, car])
    rows = np.arange(8) == 3
    policy.reset(rows)
    alone.reset()
    again = policy.act(observations[0])
    assert np.array_equal(again[3], alone.act(observations[0, 3]))


def test_laws_are_different_laws():
    env = plant()
    observation = np.full(8, 0.02, np.float32)
    rears = {name: float(law(env).act(np.float32(0.3), observation)) for name, law in REAR_LAWS.items()}
    for first, second in itertools.combinations(rears, 2):
        assert abs(rears[first] - rears[second]) > 0.01, (first, second)
    assert [law.name for law in REAR_LAWS.values()] == list(REAR_LAWS)
    assert len(COMBINATIONS) == len(DRIVERS) * len(REAR_LAWS)


@pytest.mark.parametrize("name", REAR_LAWS)
@pytest.mark.parametrize("steer", ["front", "rear"])
def test_a_law_needs_both_axles(name, steer):
    with pytest.raises(ValueError, match=f"steer must be 'both' for the rear-steer law '{name}', got '{steer}'"):
        REAR_LAWS[name](plant(steer=steer))
    with pytest.raises(ValueError, match="steer must be 'both'"):
        driver_and_law(f"preview+{name}", plant(steer=steer))


def test_what_a_combination_refuses():
    env = plant()
    with pytest.raises(ValueError, match=r"policy must be one of 'preview\+speed-dependent', .* did you mean"):
        driver_and_law("preview+sanno", env)
    with pytest.raises(TypeError, match="policy"):
        driver_and_law(None, env)
    with pytest.raises(TypeError, match="driver must be a Driver, got 'preview'"):
        DriverAndLaw("preview", Sano(env))
    with pytest.raises(TypeError, match="law must be a RearLaw"):
        DriverAndLaw(Preview(env), Preview(env))


def test_the_front_wheels_are_the_drivers():
    env = plant(vehicle="civic", speed=30.0)
    law = SpeedDependent(env)
    driver = Preview(env, delay=0.0, model=law.front_model())
    both, alone = DriverAndLaw(driver, law), Preview(env, delay=0.0, model=law.front_model())
    observation = np.full(8, 0.02, np.float32)
    front, rear = both.act(observation)
    assert front == alone.act(observation)[0]
    assert rear == law.act(front, observation)
    assert isinstance(law, RearLaw)
    assert np.array_equal(both.model.B, law.front_model().B)


# Driving


def lane_change(name, env):
    """(success, peak sideslip [rad]) of one lane change to the left from rest on the path."""
    policy = DRIVERS[name](env) if name in DRIVERS else driver_and_law(name, env)
    observation, _ = env.reset(seed=1, options={"state": {}, "direction": "left", "change_start": 1.0})
    peak = 0.0
    for _ in range(300):
        observation, _, terminated, _, _ = env.step(policy.act(observation))
        peak = max(peak, abs(env.state.lateral_velocity / env.speed))
        if terminated:
            break
    return env.is_success, peak


@pytest.mark.parametrize("name", COMBINATIONS)
def test_every_combination_makes_the_lane_change_with_a_stable_car(name):
    env = plant(LANE_CHANGE, vehicle="understeer", speed=22.0)
    success, peak = lane_change(name, env)
    alone, peak_alone = lane_change(name.partition("+")[0], env)
    assert success
    assert alone
    assert peak < peak_alone, "all of them reduce the sideslip"


def test_yaw_rate_feedback_lets_drivers_drive_an_unstable_car():
    env = plant(LANE_CHANGE)
    assert {name: lane_change(name, env)[0] for name in ("preview", *COMBINATIONS)} == {
        "preview": False,
        "preview+speed-dependent": False,
        "preview+sano": False,
        "preview+zero-sideslip": False,
        "preview+yaw-rate": True,
        "stanley+speed-dependent": False,
        "stanley+sano": True,
        "stanley+zero-sideslip": False,
        "stanley+yaw-rate": True,
    }
