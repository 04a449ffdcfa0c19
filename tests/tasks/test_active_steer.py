"""BicycleActiveSteer-v0: the manoeuvre, the twin, the judgement and the reward, each computed here a second time."""

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import simulate
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.tasks.episode import World
from bicycle_env.tasks.fmvss126 import BEGIN, FLOOR
from bicycle_env.tasks.metrics import Run, figures

ID = "BicycleActiveSteer-v0"
CLEAR = {"relative_speed": 0.9, "relative_friction": 0.8, "amplitude": 0.03, "frequency": 0.7, "dwell": 0.5}


def feedback(gain=0.2, noise=0.0, seed=0):
    """Rear wheels by the yaw rate, for the measured observation."""
    rng = np.random.default_rng(seed)

    def act(observation):
        wanted = 5.0 * observation[..., 2] * 0.105 / 0.5 * 0.3
        action = gain / 0.0524 * 0.5 * (observation[..., 0] - wanted) + noise * rng.standard_normal()
        return np.clip(action, -1.0, 1.0).astype(np.float32)[..., None]

    return act


def drive(env, act, **reset):
    """States and rewards, the start among the states; the rows of info."""
    observation, _ = env.reset(**reset)
    states, rewards, infos, over = [env.unwrapped.state], [], [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(act(observation))
        states.append(env.unwrapped.state)
        rewards.append(reward)
        infos.append(info)
        over = terminated or truncated
    return states, rewards, infos


def nothing(observation):
    return np.zeros(1, np.float32)


def columns(states):
    return {name: np.array(values) for name, values in zip(states[0]._fields, zip(*states, strict=True), strict=True)}


# The manoeuvre


@pytest.mark.parametrize(("direction", "side"), [("left", 1.0), ("right", -1.0)])
def test_the_front_wheels_are_the_drivers(direction, side):
    env = gym.make(ID)
    run = columns(drive(env, feedback(), options={"direction": direction, **CLEAR})[0])
    since = run["time"] - BEGIN
    phase = np.where(since < 0.75 / 0.7, since, np.maximum(since - 0.5, 0.75 / 0.7))
    expected = np.where((since > 0.0) & (phase < 1 / 0.7), side * 0.03 * np.sin(2 * np.pi * 0.7 * phase), 0.0)
    np.testing.assert_allclose(run["driver_command"], expected, atol=1e-14)
    assert np.array_equal(run["front_steer_command"][1:], run["driver_command"][:-1])
    assert np.max(np.abs(run["rear_steer_command"])) > 0.005


def test_a_correction_at_the_front_is_added_and_remembered():
    env = gym.make(ID, steer="both").unwrapped
    env.reset(options={"direction": "left", **CLEAR})
    for _ in range(40):
        command = env.state.driver_command
        env.step(np.array([0.25, 0.0], np.float32))
        limit = env.front_actuator.angle_limit
        assert env.state.front_steer_command == pytest.approx(command + 0.25 * limit, abs=1e-15)
        assert env.state.front_correction == 0.25 * limit
    assert env.state.twin_front_steer != env.state.front_steer


def test_what_is_drawn_covers_its_range_and_is_hidden_but_for_the_speed():
    env = gym.make_vec(ID, 4000)
    observation, info = env.reset(seed=3)
    plant, state = env.unwrapped, env.unwrapped.state
    drawn = {"relative_speed": state.speed / plant.speed, **state._asdict()}
    for name in ("relative_speed", "relative_friction", "amplitude"):
        low, high = getattr(plant.task, name)
        assert low <= drawn[name].min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < drawn[name].max() <= high
    assert set(state.frequency) == {0.7}
    assert abs(np.mean(state.side)) < 0.05
    shown = observation[:, plant.observation_names.index("speed")] * plant.speed
    np.testing.assert_allclose(shown, state.speed, rtol=1e-6)
    assert "relative_friction" not in info
    assert np.count_nonzero(np.ptp(observation, axis=0)) == 1


def test_speed_and_friction_are_those_that_the_car_drives_with():
    env = gym.make(ID)
    options = {"direction": "left", **CLEAR}
    run = columns(drive(env, nothing, options=options)[0])
    plant = env.unwrapped
    alone = simulate(
        plant.vehicle,
        0.9 * plant.speed,
        lambda time: (float(np.interp(time, run["time"], run["front_steer"])), 0.0),
        1.6,
        tire="fiala",
        friction=0.8,
        timestep=0.004,
    )
    for name in ("lateral_position", "yaw_rate", "lateral_velocity"):
        np.testing.assert_allclose(
            alone[name][::5][:80], run[name][:80], atol=0.02
        )  # the wheels go straight between the steps here


# The twin


@pytest.mark.parametrize(
    "keywords", [{}, {"relaxation_length": 0.4}, {"tire": "linear"}, {"randomise": {"mass": (1.1, 1.1, "relative")}}]
)
def test_the_car_with_straight_rear_wheels_is_its_own_twin(keywords):
    env = gym.make(ID, **keywords)
    run = columns(drive(env, nothing, seed=4)[0])
    while_it_drives = run["time"] < BEGIN + 1.07
    assert np.max(np.abs(run["twin_yaw_rate"])) > 0.02
    for name in ("lateral_position", "heading", "lateral_velocity", "yaw_rate", "front_steer"):
        mine, twin = run[name][while_it_drives], run[f"twin_{name}"][while_it_drives]
        if "relaxation_length" in keywords and name != "front_steer":  # the twin's tires answer at once
            assert not np.array_equal(mine, twin)
        else:
            assert np.array_equal(mine, twin), name
    after = run["time"] > BEGIN + 1.1
    assert len(set(run["twin_lateral_position"][after])) == 1


def test_the_twin_knows_nothing_of_the_action():
    env = gym.make(ID)
    still = columns(drive(env, nothing, seed=4)[0])
    steered = columns(drive(env, feedback(noise=0.1), seed=4)[0])
    for name in still:
        if name.startswith("twin"):
            n = min(len(still[name]), len(steered[name]))
            assert np.array_equal(still[name][:n], steered[name][:n])
    assert not np.array_equal(still["yaw_rate"][:80], steered["yaw_rate"][:80])


# The judgement


def verdict(run, end):
    """Success, computed from a run anew; and why not."""
    r, time, frequency = np.abs(run["yaw_rate"]), run["time"], run["frequency"][0]
    finish = BEGIN + 1.0 / frequency + run["dwell"][0]
    peak = np.maximum.accumulate(np.where(time >= BEGIN + 0.375 / frequency - 1e-6, r, 0.0))
    floored = np.maximum(peak, FLOOR)
    first = np.flatnonzero(time >= finish + 1.0 - 1e-6)[:1]
    late = time >= finish + 1.75 - 1e-6
    there = np.flatnonzero(time >= BEGIN + 1.07)[:1]
    least = np.maximum(0.8 * (run["side"] * run["twin_lateral_position"])[there], 0.0)
    fast = np.any(r[first] > 0.35 * floored[first]) or np.any(r[late] > 0.2 * floored[late])
    short = np.any((run["side"] * run["lateral_position"])[there] < least)
    return end == "" and not fast and not short, fast, short


def test_success_is_what_it_says():
    env, reasons = gym.make(ID, frequency=(0.5, 1.0), dwell=(0.0, 0.8)), set()
    for seed in range(120):
        gain = np.random.default_rng(seed).uniform(0.0, 0.6)
        states, _, infos = drive(env, feedback(gain), seed=seed)
        run = columns(states)
        success, fast, short = verdict(run, infos[-1]["end"])
        assert env.unwrapped.is_success == success, seed
        assert states[-1].yaw_rate_missed == fast
        assert states[-1].displacement_missed == short
        reasons.add((success, bool(fast), bool(short), infos[-1]["end"]))
    assert {reason[0] for reason in reasons} == {True, False}
    assert {reason[1] for reason in reasons} == {True, False}
    assert {reason[2] for reason in reasons} == {True, False}
    assert {reason[3] for reason in reasons} >= {"", "spun"}


def test_another_driver_has_no_success():
    env = gym.make(ID, driver="sine_with_dwell")
    states, _, _ = drive(env, feedback(), seed=0)
    assert not env.unwrapped.is_success
    assert np.max(np.abs(columns(states)["front_steer"])) > 0.02
    assert np.all(columns(states)["driver_command"] == 0.0)


# The reward


def test_the_reward_by_hand():
    env = gym.make(ID, steer="both")
    plant, rng, events = env.unwrapped, np.random.default_rng(1), set()
    for seed in range(12):
        gain, actions = rng.uniform(0.0, 0.5), []

        def both(observation, gain=gain, actions=actions):
            actions.append(np.array([0.05 * rng.standard_normal(), feedback(gain)(observation)[0]], np.float32))
            return actions[-1]

        states, rewards, infos = drive(env, both, seed=seed)
        limits = plant.front_actuator.angle_limit, plant.rear_actuator.angle_limit
        last = np.zeros(2)
        for before, after, action, reward, info in zip(states, states[1:], actions, rewards, infos, strict=False):
            speed, late = after.speed, after.time - BEGIN - 1.0 / after.frequency - after.dwell
            most = 0.85 * after.relative_friction * 9.81 / speed
            length = plant.vehicle.wheelbase
            wanted = np.clip(speed / length * after.twin_front_steer / (1.0 + 0.0015 * speed**2), -most, most)
            sideslip = after.lateral_velocity / speed
            cost = 30.0 * (after.yaw_rate - wanted) ** 2 + 60.0 * max(0.0, abs(sideslip) - 0.05) ** 2
            cost += 0.05 * np.sum((np.clip(action, -1.0, 1.0) - last) ** 2)
            cost += np.clip(late / 0.5, 0.0, 1.0) * 100.0 * (after.yaw_rate**2 + sideslip**2)
            lost = {
                "fast": after.yaw_rate_missed - before.yaw_rate_missed,
                "short": after.displacement_missed - before.displacement_missed,
                "end": float(info["end"] != ""),
            }
            events |= {name for name, value in lost.items() if value}
            assert reward == pytest.approx(0.1 / (1.0 + cost) - 30.0 * sum(lost.values()), rel=1e-9, abs=1e-12)
            last = np.array([after.front_correction / limits[0], after.rear_steer_command / limits[1]])
    assert events == {"fast", "short", "end"}


# What is measured


def test_the_accelerometer_tells_the_mean_of_the_step():
    env = gym.make(ID, telemetry=True)
    states, _, infos = drive(env, feedback(), options={"direction": "left", **CLEAR})
    run = columns(states)
    exact = np.array([info["lateral_acceleration"] for info in infos])
    assert np.max(np.abs(exact)) > 3.0
    np.testing.assert_allclose(run["lateral_acceleration"][2:], 0.5 * (exact[1:] + exact[:-1]), atol=0.15)
    sideslip = np.array([info["sideslip"] for info in infos])
    np.testing.assert_array_equal(sideslip, run["lateral_velocity"][1:] / (0.9 * env.unwrapped.speed))


def test_noise_reaches_the_tasks_own_accelerometer():
    plain, noisy = (
        gym.make(ID, sensors=sensors) for sensors in (None, {"noise": {"lateral_acceleration": 0.2, "yaw_rate": 0.01}})
    )
    assert plain.unwrapped.observation_names == noisy.unwrapped.observation_names
    quiet, heard = (np.array([env.reset(seed=s)[0] for s in range(300)]) for env in (plain, noisy))
    names = list(plain.unwrapped.observation_names)
    deviation = np.std(heard - quiet, axis=0) * plain.unwrapped.observation_scale
    assert deviation[names.index("lateral_acceleration")] == pytest.approx(0.2, rel=0.15)
    assert deviation[names.index("yaw_rate")] == pytest.approx(0.01, rel=0.15)


def test_sideslip_is_observed_where_it_is_asked_for():
    env = gym.make(ID, observed="state").unwrapped
    env.reset(options={"state": {"lateral_velocity": 2.0}, "relative_speed": 0.9})
    observation = env.step(np.zeros(1, np.float32))[0]
    assert env.observation_names[-1] == "sideslip"
    assert observation[-1] == np.float32(env.state.lateral_velocity / (0.9 * env.speed) / 0.2)


# Figures


def test_the_figures_of_a_run():
    env = gym.make(ID, telemetry=True)
    states, rewards, infos = drive(env, feedback(0.25), options={"direction": "right", **CLEAR})
    run = columns(states[1:])
    steps = {
        **run,
        **{name: np.array([info[name] for info in infos]) for name in infos[0] if name not in ("end", "is_success")},
    }
    steps |= {name: run[name] for name in run} | {"reward": np.array(rewards)}
    plant = env.unwrapped
    world = World(plant.configuration.car, plant.rules, plant.configuration.settings)
    found = figures(plant.task.metrics, Run(steps, plant.is_success, world))
    r, time = np.abs(run["yaw_rate"]), run["time"]
    finish = BEGIN + 1.0 / 0.7 + 0.5
    peak = np.max(r[(time >= BEGIN + 0.375 / 0.7) & (time <= finish + 1.02)])
    assert found["yaw_rate_ratio_1s"] == pytest.approx(r[time >= finish + 1.0][0] / peak)
    assert found["displacement"] == pytest.approx(-run["lateral_position"][time >= BEGIN + 1.07][0])
    assert 0.3 < found["displacement_ratio"] < 1.2
    assert found["spun"] == 0.0
    assert found["floor_decides"] == float(np.max(run["peak_yaw_rate"]) < FLOOR)
    assert found["peak_sideslip"] == pytest.approx(np.max(np.abs(run["lateral_velocity"])) / (0.9 * plant.speed))


# Other backends


def test_tensors_agree():
    import torch

    envs = TorchVectorEnv(ID, 64, dtype=torch.float64, autoreset_mode="Disabled", frequency=(0.5, 1.0))
    many = gym.make_vec(ID, 64, autoreset_mode="Disabled", frequency=(0.5, 1.0))
    observation, _ = many.reset(seed=5)
    drawn = many.unwrapped.state
    options = {"direction": ["left" if side > 0 else "right" for side in drawn.side]}
    options |= {name: getattr(drawn, name) for name in ("relative_friction", "amplitude", "frequency", "dwell")}
    options["relative_speed"] = drawn.speed / many.unwrapped.speed
    many.reset(seed=5, options=options)
    mine, _ = envs.reset(seed=5, options=options)
    np.testing.assert_allclose(mine.numpy(), many.unwrapped.reset(seed=5, options=options)[0], atol=1e-7)
    for _ in range(230):
        action = feedback()(observation)
        observation, reward, *_ = many.step(action)
        _, mine, *_ = envs.step(torch.tensor(action))
        np.testing.assert_allclose(mine.numpy(), reward, rtol=1e-11, atol=1e-12)
    ours, theirs = envs.state, many.unwrapped.state
    for name in theirs._fields:
        expected = getattr(theirs, name)
        scale = max(1.0, float(np.max(np.abs(expected))))
        np.testing.assert_allclose(getattr(ours, name).numpy(), expected, rtol=1e-10, atol=1e-12 * scale, err_msg=name)


def test_single_precision_judges_alike():
    double, single = (gym.make_vec(ID, 256, dtype=dtype, autoreset_mode="Disabled") for dtype in ("float64", "float32"))
    seen = [env.reset(seed=2)[0] for env in (double, single)]
    for _ in range(300):
        seen = [env.step(feedback(0.3)(row))[0] for env, row in zip((double, single), seen, strict=True)]
    first, second = double.unwrapped.is_success, single.unwrapped.is_success
    assert 0.05 < np.mean(first) < 0.95
    assert np.mean(first == second) > 0.97
