"""The rear-steer laws of BicycleActiveSteer-v0: by hand, their phases, their observer, their tuning."""

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import control, optimum
from bicycle_env.control.active_steer import SIGNALS

ID = "BicycleActiveSteer-v0"
NUMBERS = {name: np.linspace(0.3, -0.4, len(law.parameters)) for name, law in control.REAR_STEERINGS.items()}
START = {"direction": "left", "relative_speed": 0.9, "relative_friction": 0.8, "amplitude": 0.03}


def drive(policy, env, seed=0, steps=300, options=START):
    observation, _ = env.reset(seed=seed, options=options)
    policy.reset()
    states, actions = [env.unwrapped.state], []
    for _ in range(steps):
        actions.append(policy.act(observation))
        observation, _, over, _, _ = env.step(actions[-1])
        states.append(env.unwrapped.state)
        if over:
            break
    return states, actions


@pytest.mark.parametrize("name", control.REAR_STEERINGS)
def test_the_laws_by_hand(name):
    env = gym.make(ID, observed="state")
    plant, gains = env.unwrapped, NUMBERS[name]
    law = control.REAR_STEERINGS[name](plant, 0.2 * gains)
    states, actions = drive(law, env)
    seen = set()
    for state, action in zip(states, actions, strict=False):
        since, speed, length = state.time - 0.5, state.speed, plant.vehicle.wheelbase
        phase = 2 if since > 1 / 0.7 + 0.5 - 1e-6 else 1 if since > 0.5 / 0.7 else 0
        most = 0.85 * 9.81 / speed  # nominal friction
        wanted = np.clip(speed / length * state.front_steer / (1 + 0.0015 * speed**2), -most, most)
        sideslip = state.lateral_velocity / speed
        signals = np.array([state.yaw_rate, sideslip, state.front_steer, state.driver_command, wanted])
        if name == "rear-yaw-rate":
            rear = 0.2 * gains[0] * (state.yaw_rate - wanted)
        else:
            rear = 0.2 * gains.reshape(-1, len(SIGNALS))[phase if name == "rear-switched" else 0] @ signals
        expected = np.clip(rear / plant.rear_actuator.angle_limit, -1.0, 1.0)
        assert action[0] == pytest.approx(expected, abs=2e-4), state.time  # the observation is of float32
        seen.add(phase)
    assert seen == {0, 1, 2}


@pytest.mark.parametrize("name", control.REAR_STEERINGS)
@pytest.mark.parametrize("observed", ["measured", "state"])
def test_the_laws_are_odd(name, observed):
    env = gym.make(ID, observed=observed)
    law = control.make(name, env)
    states, actions = drive(law, env)
    mirrored, others = drive(law, env, options={**START, "direction": "right"})
    assert np.array_equal(np.array(actions), -np.array(others))
    assert states[-1].yaw_rate == -mirrored[-1].yaw_rate
    assert np.max(np.abs(actions)) > 0.3


@pytest.mark.parametrize(
    ("sensors", "tolerance"), [(None, 0.05), ({"noise": {"lateral_acceleration": 0.2, "yaw_rate": 0.01}}, 0.055)]
)
def test_the_observer_finds_the_sideslip(sensors, tolerance):
    env = gym.make(ID, sensors=sensors)
    law = control.make("rear-switched", env)
    worst = peak = 0.0
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        law.reset()
        for _ in range(250):
            action = law.act(observation)
            state = env.unwrapped.state
            found = law._remembered.of(1)[0, 2] / state.speed
            worst = max(worst, abs(found - state.lateral_velocity / state.speed))
            peak = max(peak, abs(state.lateral_velocity) / state.speed)
            observation, _, over, _, _ = env.step(action)
            if over:
                break
    assert peak > 0.05
    assert worst < tolerance


@pytest.mark.parametrize(
    ("keywords", "gains", "match"),
    [
        ({"steer": "front"}, None, "steer must be 'rear' or 'both' for 'rear-linear', got 'front'"),
        ({"sensors": {"signals": ["yaw_rate"]}}, None, "'rear-linear' needs lateral_acceleration, front_steer"),
        ({}, [0.1], r"gains must be 5 numbers, got shape \(1,\)"),
    ],
)
def test_what_cannot_be_driven_is_refused(keywords, gains, match):
    with pytest.raises(ValueError, match=match):
        control.REAR_STEERINGS["rear-linear"](gym.make(ID, **keywords).unwrapped, gains)


def test_each_car_may_have_gains_of_its_own():
    env = gym.make(ID).unwrapped
    rows = np.array([NUMBERS["rear-linear"], -NUMBERS["rear-linear"]])
    law = control.REAR_STEERINGS["rear-linear"](env)
    law.vary(rows)
    observation = np.tile(np.linspace(0.05, 0.1, 10, dtype=np.float32), (2, 1))
    both = law.act(observation)
    for row, gains in enumerate(rows):
        assert np.array_equal(control.REAR_STEERINGS["rear-linear"](env, gains).act(observation[row]), both[row])


@pytest.mark.parametrize("observed", ["measured", "state"])
def test_a_tuning_finds_gains(observed):
    keywords = {"observed": observed}
    found = optimum.tune(ID, keywords, "rear-yaw-rate", range(8), range(100, 116), restarts=2, iterations=3)
    assert found.best.parameters["yaw_rate_error"] > 0.0
    assert found.best.success_rate > 0.0


def test_the_shipped_gains_beat_straight_rear_wheels_and_each_other():
    rates = {}
    cars = optimum.make_cars(ID, {}, 256)
    for name in ("zero", *control.REAR_STEERINGS):
        law = control.make(name, gym.make(ID))
        law.reset()
        rates[name] = np.mean(optimum.drive(cars, lambda seen, _, law=law: law.act(seen), range(256)).success)
    assert rates["zero"] < 0.02 < 0.1 < rates["rear-yaw-rate"] < rates["rear-linear"] < rates["rear-switched"]
    assert rates["rear-switched"] > 0.7
