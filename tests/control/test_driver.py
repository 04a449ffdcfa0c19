"""Driver models: MacAdam's optimum against brute force and closed forms, Stanley's law against steady turns."""

import math

import gymnasium as gym
import numpy as np
import pytest
from combinations import ON_ROADS, only_all

from bicycle_env import analysis, vehicles
from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.control.design.path import path_ahead
from bicycle_env.control.driver import DRIVERS, Preview, Scripted, Stanley, held_control
from bicycle_env.physics.actuators import Actuator

IDS = list(ON_ROADS)
STABILISE, LANE_CHANGE = "BicycleStab-v0", "BicycleLaneChange-v0"
UNDERSTEER = {"vehicle": "understeer", "speed": 22.0}


def plant(env_id=STABILISE, **keywords):
    return gym.make(env_id, **keywords).unwrapped


def seen(env, **values):
    """An observation made of SI values; what is not named is 0."""
    observation = np.zeros(len(env.observation_names))
    for name, value in values.items():
        index = env.observation_names.index(name)
        observation[index] = value / env.observation_scale[index]
    return observation


def random_observations(env, cars, seed=0):
    rng = np.random.default_rng(seed)
    return (rng.uniform(-0.05, 0.05, (cars, len(env.observation_names)))).astype(np.float32)


def steer_of(driver, observation):
    """The wanted front angle of one observation, rad, before the limits."""
    return driver.front_steer(np.atleast_2d(observation))[0]


# What is scripted


def test_a_script_is_steered_by_each_car_from_its_own_start_on():
    env = plant(steer="front")
    policy = Scripted(env, {"name": "step", "angle": 0.02, "start": 0.05, "side": "right"})
    straight, turned = 0.0, np.float32(-0.02 / env.front_actuator.angle_limit)
    observations = np.zeros((2, len(env.observation_names)), np.float32)
    actions = []
    for k in range(7):
        if k == 4:
            policy.reset(np.array([False, True]))
        actions.append(policy.act(observations)[:, 0].tolist())
    first, second = zip(*actions, strict=True)
    assert first == (straight,) * 3 + (turned,) * 4  # at 0, 20, 40 ms
    assert second == (straight,) * 3 + (turned,) + (straight,) * 3


@pytest.mark.parametrize(
    ("manoeuvre", "complaint"),
    [(None, "needs no eyes"), ("preview", "needs no eyes"), ("step", "side must be"), ({"name": "steps"}, "name")],
)
def test_a_script_that_is_none(manoeuvre, complaint):
    with pytest.raises(ValueError, match=complaint):
        Scripted(plant(), manoeuvre)


# The previewed optimum


@pytest.mark.parametrize("steps", [1, 2, 7, 65])
def test_the_held_control_minimises_the_previewed_error(steps):
    """The cost is quadratic in u, so that its derivative by central differences is exact."""
    model = plant(steer="front").linear_model()
    A, b = model.A, model.B[:, 0]
    h, F = held_control(A, b, steps)
    rng = np.random.default_rng(1)
    x, f = 0.1 * rng.normal(size=6), rng.normal(size=steps)

    def cost(u):
        state, errors = x.copy(), []
        for k in range(steps):
            state = A @ state + b * u
            errors.append((f[k] - state[0]) ** 2)
        return sum(errors) - 0.5 * errors[-1]  # the error at the start does not depend on u

    best = h @ (f - F @ x)
    slope, curvature = cost(best + 1.0) - cost(best - 1.0), cost(best + 1.0) + cost(best - 1.0) - 2.0 * cost(best)
    assert curvature > 0.0
    assert abs(slope) < 1e-9 * (curvature + cost(best))


def test_a_preview_of_one_point_meets_it():
    model = plant(steer="front").linear_model()
    h, F = held_control(model.A, model.B[:, 0], 1)
    x = np.array([0.3, 0.02, -0.5, 0.1, 0.01, 0.0])
    u = h @ (np.array([1.0]) - F @ x)
    assert (model.A @ x + model.B[:, 0] * u)[0] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("preview_time", [0.5, 1.3])
def test_a_point_mass_has_the_closed_form(preview_time):
    """y'' = u and a constant f: u = (10/3) (f - y)/T^2 - (5/2) y'/T, damping ratio sqrt(15/32) for every T."""
    errors = []
    for steps in (50, 100, 200):
        timestep = preview_time / steps
        h, F = held_control(np.array([[1.0, timestep], [0.0, 1.0]]), np.array([timestep**2 / 2.0, timestep]), steps)
        gain = h @ F
        expected = np.array([10.0 / 3.0 / preview_time**2, 2.5 / preview_time])
        assert h.sum() == pytest.approx(gain[0], rel=1e-12)
        errors.append(np.max(np.abs(gain / expected - 1.0)))
        assert gain[1] / (2.0 * math.sqrt(gain[0])) == pytest.approx(math.sqrt(15.0 / 32.0), rel=1e-3)
    assert errors[-1] < 1e-4
    assert 3.5 < errors[0] / errors[1] < 4.5, "the trapezoidal rule is of second order"


@pytest.mark.parametrize("steer", ["front", "both"])
def test_the_driver_holds_the_best_angle_in_the_environment(steer, interpreted):
    """Of all angles held over the preview, the environment itself finds the driver's to be the best."""
    env = plant(LANE_CHANGE, steer=steer, tire="linear", geometry="small_angle", preview_length=1.4, direction="left")
    driver = Preview(env, preview_time=1.2, delay=0.0)
    state = {"longitudinal_position": 30.0, "lateral_position": 0.3, "heading": 0.01, "yaw_rate": 0.02}
    observation, _ = env.reset(options={"state": state, "change_start": 0.9})
    start = env.snapshot()

    def cost(front):
        env.restore(start)
        errors = []
        for _ in range(60):
            env.step(np.array([front, 0.0][: env.action_space.shape[0]], np.float32))
            errors.append((env.state.lateral_position - env.measure()["reference_lateral_position"]) ** 2)
        return sum(errors) - 0.5 * errors[-1]

    action = float(driver.act(observation)[0])
    assert 0.02 < abs(action) < 0.9
    width = 0.05
    low, middle, high = cost(action - width), cost(action), cost(action + width)
    best = action + 0.5 * width * (low - high) / (low + high - 2.0 * middle)
    assert best == pytest.approx(action, abs=2e-3)


def test_the_driver_is_his_gains():
    env = plant(LANE_CHANGE, steer="front")
    driver = Preview(env, delay=0.0)
    assert driver.preview.shape == (65,)
    assert driver.gain.shape == (6,)
    x = np.array([0.0, 0.01, 0.2, 0.03, 0.004, -0.003])
    values = dict(zip(STATE_NAMES[1:], x[1:], strict=True))
    expected = -driver.gain @ x + driver.preview.sum() * 0.1  # the whole path 0.1 m to the left, running straight on
    values |= {"lateral_error": -0.1, "heading_error": 0.01, **{f"preview_{k / 10:g}s": 0.1 for k in range(1, 13)}}
    action = steer_of(driver, seen(env, **values)) / env.front_actuator.angle_limit
    assert action == pytest.approx(expected, rel=1e-9)


def test_a_driver_who_knows_another_car_steers_otherwise():
    env = plant()
    model = env.linear_model()
    weak = Preview(env, model=model._replace(B=0.5 * model.B))
    np.testing.assert_allclose(weak.preview, 2.0 * Preview(env).preview, rtol=1e-12)
    assert weak.model.B[2, 0] == 0.5 * Preview(env).model.B[2, 0]


# Delay and memory


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.2, 0.5])
def test_the_delay_shifts_the_actions(delay):
    env = plant()
    at_once, late = Preview(env, delay=0.0), Preview(env, delay=delay)
    observations = random_observations(env, 60)
    steps = round(delay / env.control_timestep)
    wanted = np.array([at_once.act(observation) for observation in observations])
    given = np.array([late.act(observation) for observation in observations])
    assert not np.any(given[:steps])
    assert np.array_equal(given[steps:], wanted[: len(wanted) - steps])
    late.reset()
    again = np.array([late.act(observation) for observation in observations])
    assert np.array_equal(given, again)


def test_one_car_forgets_and_the_others_do_not():
    env = plant()
    driver, reference = Preview(env), Preview(env)
    observations = random_observations(env, 90).reshape(30, 3, -1)
    for k in range(15):
        driver.act(observations[k])
    driver.reset(np.array([False, True, False]))
    for k in range(15):
        reference.act(observations[k, [0, 2]])
    fresh = Preview(env)
    for k in range(15, 30):
        action = driver.act(observations[k])
        assert np.array_equal(action[[0, 2]], reference.act(observations[k, [0, 2]]))
        assert np.array_equal(action[1], fresh.act(observations[k, 1]))


def test_rows_that_do_not_fit_are_refused():
    env = plant()
    driver = Preview(env)
    driver.reset(np.array([True, False]))  # nothing to forget yet
    driver.act(random_observations(env, 3))
    with pytest.raises(ValueError, match=r"observation must hold 3 cars .* got 2: call reset\(\)"):
        driver.act(random_observations(env, 2))
    with pytest.raises(ValueError, match=r"rows must have shape \(3,\)"):
        driver.reset(np.array([True, False]))
    driver.reset()
    assert driver.act(random_observations(env, 2)).shape == (2, 2)


# What every driver keeps


@pytest.mark.parametrize("steer", ["front", "both"])
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("name", DRIVERS)
def test_many_cars_are_single_cars_and_mirrored_ones_steer_mirrored(name, env_id, steer):
    env = plant(env_id, steer=steer)
    observations = random_observations(env, 20 * 30).reshape(30, 20, -1)
    observations[:, 0] *= 100.0  # beyond the limits
    driver, mirrored, alone = (DRIVERS[name](env) for _ in range(3))
    actions = np.array([driver.act(observation) for observation in observations])
    assert actions.shape == (30, 20, env.action_space.shape[0])
    assert actions.dtype == np.float32
    assert np.max(np.abs(actions)) == 1.0
    assert len(np.unique(actions[..., 0])) > 300
    if steer == "both":
        assert not np.any(actions[..., 1])
    mirror = env.observation_mirror.astype(np.float32)
    assert np.array_equal(actions, [-mirrored.act(observation * mirror) for observation in observations])
    for car in (0, 7):
        alone.reset()
        single = np.array([alone.act(observation) for observation in observations[:, car]])
        assert np.array_equal(single, actions[:, car])


@pytest.mark.parametrize("name", DRIVERS)
def test_what_drivers_refuse(name):
    with pytest.raises(ValueError, match=f"steer must be 'front' or 'both' for the driver '{name}', got 'rear'"):
        DRIVERS[name](plant(steer="rear"))
    driver = DRIVERS[name](plant())
    assert driver.name == name
    with pytest.raises(ValueError, match=r"observation must have shape \(8,\) or \(cars, 8\), got \(7,\)"):
        driver.act(np.zeros(7, np.float32))
    with pytest.raises(ValueError, match="observation"):
        driver.act(np.zeros((2, 2, 8), np.float32))


def test_bad_numbers_are_refused():
    env = plant()
    for keywords in ({"preview_time": 0.0}, {"preview_time": math.inf}, {"delay": -0.1}, {"delay": math.nan}):
        with pytest.raises(ValueError, match=next(iter(keywords))):
            Preview(env, **keywords)
    for keywords in ({"gain": -1.0}, {"softening": -0.1}, {"yaw_damping": math.inf}):
        with pytest.raises(ValueError, match=next(iter(keywords))):
            Stanley(env, **keywords)
    with pytest.raises(TypeError, match="preview_time"):
        Preview(env, preview_time="1")


# The path


def test_the_path_ahead_is_the_path():
    env = plant(LANE_CHANGE, speed=30.0, direction="right")
    state = {"longitudinal_position": 40.0, "lateral_position": -0.4, "heading": -0.03}
    observation, _ = env.reset(options={"state": state, "change_start": 1.0})
    times = np.linspace(0.0, 1.2, 37)

    def quintic(time):
        s = np.clip((40.0 + 30.0 * time - 30.0) / 45.0, 0.0, 1.0)
        return -3.5 * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)

    tiny = 1e-4
    truth = quintic(times) + 0.4
    slope = (quintic(times + tiny) - quintic(times - tiny)) / (2.0 * tiny)
    turn = (quintic(times + tiny) - 2.0 * quintic(times) + quintic(times - tiny)) / tiny**2
    wide = observation.astype(float)
    np.testing.assert_allclose(wide @ path_ahead(env, times), truth, atol=3e-3)
    np.testing.assert_allclose(wide @ path_ahead(env, times, 1), slope, atol=0.05)
    inner = (times > 0.0) & (times < 1.1)
    np.testing.assert_allclose((wide @ path_ahead(env, times, 2))[inner], turn[inner], atol=1.0)


@pytest.mark.parametrize(
    "keywords", [{"preview_length": 0.0}, *map(only_all, ({"preview_length": 0.1}, {"preview_length": 0.2})), {}]
)
def test_a_path_that_is_not_shown_runs_straight_on(keywords):
    env = plant(LANE_CHANGE, **keywords)
    times = np.array([0.0, 0.05, 0.1, 1.0, 2.0])
    straight = seen(env, heading=0.02, heading_error=-0.01, lateral_error=-0.5)
    for time in env.task.preview_times:
        straight += seen(env, **{f"preview_{time:g}s": 0.5 + 0.03 * env.speed * time})
    np.testing.assert_allclose(straight @ path_ahead(env, times), 0.5 + 0.03 * env.speed * times, rtol=1e-12)
    np.testing.assert_allclose(straight @ path_ahead(env, times, 1), 0.03 * env.speed, rtol=1e-12)
    np.testing.assert_allclose(straight @ path_ahead(env, times, 2), 0.0, atol=1e-9)


def test_without_a_path_the_lane_is_the_path():
    env = plant()
    observation = seen(env, lateral_position=0.7, heading=0.1)
    assert np.array_equal(observation @ path_ahead(env, np.array([0.0, 1.0])), [-0.7, -0.7])
    assert not np.any(path_ahead(env, np.array([0.0, 1.0]), 1))


# Stanley's law


def test_the_law_by_hand():
    env = plant(speed=30.0)
    driver = Stanley(env, gain=2.0, softening=1.5, yaw_damping=0.1)
    observation = seen(env, lateral_position=0.6, heading=0.03, yaw_rate=0.2, lateral_velocity=1.0)
    expected = -0.03 - math.atan(2.0 * (0.6 + 1.4 * 0.03) / 31.5) - 0.1 * 0.2
    assert steer_of(driver, observation) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", ["oversteer", "understeer", "mendes", "civic"])
@pytest.mark.parametrize("speed", [8.0, 20.0, 30.0])
def test_in_a_steady_turn_the_law_asks_for_the_steer_that_it_has(name, speed):
    """The car's front axle rolls along the circle; the heading differs from the path's by what the tires slip."""
    env = plant(LANE_CHANGE, vehicle=name, speed=speed)
    vehicle = vehicles[name]
    steer = 0.01
    lateral_velocity, yaw_rate = (
        steer * analysis.steady_state_gain(vehicle, speed, "front_steer", output)
        for output in ("lateral_velocity", "yaw_rate")
    )
    curvature, a = yaw_rate / speed, vehicle.cg_to_front
    # Straight ahead, the axle on the path and rolling along it: path y = y0 + V t + curvature (U t)^2 / 2.
    start = -lateral_velocity * a / speed - 0.5 * curvature * a**2
    values = {"lateral_velocity": lateral_velocity, "yaw_rate": yaw_rate, "front_steer": steer}
    values |= {"lateral_error": -start, "heading_error": -lateral_velocity / speed}
    for time in env.task.preview_times:
        values[f"preview_{time:g}s"] = start + lateral_velocity * time + 0.5 * curvature * (speed * time) ** 2
    assert steer_of(Stanley(env), seen(env, **values)) == pytest.approx(steer, rel=1e-9)


def straight_loop(env, driver):
    """Eigenvalues, 1/s, of the linear car with a driver on a straight path; his delay as states."""
    model = env.linear_model()
    delay = round(0.2 / model.timestep) if isinstance(driver, Preview) else 0
    unit = 1e-6
    gain = np.zeros(6)
    for j, name in enumerate(STATE_NAMES):
        driver.reset()
        for _ in range(delay + 1):
            gain[j] = steer_of(driver, seen(env, **{name: unit})) / unit
    loop = np.zeros((6 + delay, 6 + delay))
    loop[:6, :6] = model.A
    b = model.B[:, 0] / model.input_scale[0]
    if delay:
        loop[:6, 6] = b
        loop[6:-1, 7:] = np.eye(delay - 1)
        loop[-1, :6] = gain
    else:
        loop[:6, :6] += np.outer(b, gain)
    values = np.linalg.eigvals(loop).astype(complex)
    rates = np.log(values[np.abs(values) > 1e-6]) / model.timestep
    return rates[np.argsort(-rates.real)]


def damping_ratio(rates):
    return -rates.real / np.abs(rates)


@pytest.mark.parametrize("name", ["oversteer", "neutral", "understeer", "mendes", "civic", "tsx"])
@pytest.mark.parametrize("speed", [10.0, 20.0, 30.0])
def test_stanley_is_well_damped_on_a_straight_path(name, speed):
    env = plant(vehicle=name, speed=speed, steer="front")
    assert np.min(damping_ratio(straight_loop(env, Stanley(env)))) > 0.4


@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.2, 1.5])
def test_stanley_needs_his_yaw_damping_above_the_critical_speed(ratio):
    env = plant(speed_ratio=ratio, steer="front")
    assert np.min(damping_ratio(straight_loop(env, Stanley(env)))) > 0.5
    bare = straight_loop(env, Stanley(env, yaw_damping=0.0))
    assert (bare[0].real < 0.0) == (ratio <= 1.0)


@pytest.mark.parametrize(
    ("keywords", "expected"),
    [(UNDERSTEER, 0.542), ({"speed_ratio": 0.8}, 0.283), ({"speed_ratio": 1.2}, 0.125), ({"speed_ratio": 1.83}, 0.0)],
)
def test_the_delayed_driver_loses_his_damping_with_oversteer_and_speed(keywords, expected):
    env = plant(steer="front", **keywords)
    slowest = straight_loop(env, Preview(env))[0]
    assert damping_ratio(slowest) == pytest.approx(expected, abs=5e-3)


# Driving


@pytest.mark.parametrize("name", DRIVERS)
def test_drivers_return_to_the_middle_of_the_lane(name):
    env = plant(**UNDERSTEER, steer="front")
    driver = DRIVERS[name](env)
    observation, _ = env.reset(options={"state": {"lateral_position": 0.5}})
    for _ in range(400):
        observation, _, terminated, _, _ = env.step(driver.act(observation))
        assert not terminated
    assert abs(env.state.lateral_position) < 2e-3
    assert abs(env.state.heading) < 1e-3


def lane_change(driver, env, direction="left"):
    """(largest distance from the path [m], success) of one episode that starts on the path."""
    observation, _ = env.reset(seed=1, options={"state": {}, "direction": direction, "change_start": 1.0})
    driver.reset()
    largest = 0.0
    for _ in range(300):
        observation, _, terminated, _, _ = env.step(driver.act(observation))
        error = env.state.lateral_position - env.measure()["reference_lateral_position"]
        largest = max(largest, abs(error))
        if terminated:
            break
    return largest, env.is_success


@pytest.mark.parametrize(("name", "error"), [("preview", 0.62), ("stanley", 0.40)])
def test_drivers_follow_the_lane_change_below_the_critical_speed(name, error):
    env = plant(LANE_CHANGE, **UNDERSTEER, steer="front")
    largest, success = lane_change(DRIVERS[name](env), env)
    assert success
    assert 0.5 * error < largest < error


def test_the_delayed_driver_cannot_drive_an_unstable_car():
    """Linearly stable, with a damping ratio of 0.12: the lane change is too much."""
    env = plant(LANE_CHANGE, steer="front")
    assert not lane_change(Preview(env), env)[1]


def test_stanley_watches_the_front_axle():
    """Moving the axle forward in the law is another law."""
    env = plant(speed=30.0, front_actuator=Actuator(angle_limit=0.1))
    observation = seen(env, heading=0.01)
    at_axle = -0.01 - math.atan(1.0 * 1.4 * 0.01 / 31.0)
    assert steer_of(Stanley(env), observation) == pytest.approx(at_axle, rel=1e-12)
