"""Noise and resolution of what is observed: statistics, and the same numbers for one car, many and tensors."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import EnvSpec

from bicycle_env import Sensors, control
from bicycle_env.envs import TorchVectorEnv

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
QUICK = {"tire": "linear", "geometry": "small_angle"}
NOISE = {"yaw_rate": 0.01, "lateral_position": 0.05, "front_steer_command": 0.002}
SENSORS = Sensors(noise=NOISE, resolution={"heading": 0.05})
CARS = 8
in_python = pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code


def actions(steps=60):
    rng = np.random.default_rng(5)
    return np.clip(np.cumsum(rng.uniform(-0.1, 0.1, (steps, CARS, 2)), axis=0), -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("env_id", [STAB, only_all(LANE)])
@pytest.mark.exhaustive
def test_one_car_is_one_of_many_and_tensors_agree(env_id):
    given = {**QUICK, "sensors": SENSORS, "autoreset_mode": "Disabled"}
    many, tensors = gym.make_vec(env_id, CARS, **given), TorchVectorEnv(env_id, CARS, **given)
    alone = [gym.make(env_id, **QUICK, sensors=SENSORS) for _ in range(CARS)]
    observation, _ = many.reset(seed=3)
    for k, env in enumerate(alone):
        assert env.reset(seed=3 + k)[0].tobytes() == observation[k].tobytes()
    tensors.reset(seed=0)
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.unwrapped.state._asdict().items()})
    over = np.zeros(CARS, bool)
    for action in actions():
        observation, reward, terminated, truncated, _ = many.step(action)
        seen, *_ = tensors.step(torch.from_numpy(action))
        for k in np.flatnonzero(~over):
            expected = alone[k].step(action[k])
            assert (observation[k].tobytes(), reward[k]) == (expected[0].tobytes(), expected[1])
            np.testing.assert_allclose(seen[k].numpy(), observation[k], rtol=1e-6, atol=1e-6)
        over |= terminated | truncated


def test_the_noise_is_what_was_asked_for_and_nothing_else_changes():
    """Of tensors, which draw it for all cars at once; test_options.py has a single environment's beside them."""
    number, steps = 400, 10
    plain, noisy = (
        TorchVectorEnv(STAB, number, **QUICK, **given, autoreset_mode="Disabled")
        for given in ({}, {"sensors": SENSORS})
    )
    plain.reset(seed=0)
    noisy.reset(seed=1)
    noisy.set_state(plain.state._asdict())
    differences = []
    for _ in range(steps):
        (mine, reward, *_), (theirs, expected, *_) = (env.step(torch.zeros(number, 2)) for env in (noisy, plain))
        assert torch.equal(reward, expected)  # who judges knows the truth
        differences.append((mine - theirs).numpy() * plain.observation_scale)
    found = np.concatenate(differences)
    names = list(plain.observation_names)
    for j, name in enumerate(names):
        if name == "heading":  # told in steps
            continue
        deviation = NOISE.get(name, 0.0)
        assert np.std(found[:, j]) == pytest.approx(deviation, rel=0.05)
        assert abs(np.mean(found[:, j])) <= 4.0 * deviation / np.sqrt(len(found))
    first, second = (found[:, names.index(name)] for name in ("yaw_rate", "lateral_position"))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.08


@in_python
def test_values_are_told_in_steps():
    env = gym.make(STAB, **QUICK, sensors=SENSORS).unwrapped
    place = env.observation_names.index("heading")
    for value, told in ((0.0, 0.0), (0.024, 0.0), (0.026, 0.05), (-0.026, -0.05), (0.12, 0.1), (0.13, 0.15)):
        observation, _ = env.reset(options={"state": {"heading": value}})
        assert observation[place] * env.observation_scale[place] == pytest.approx(told, abs=1e-7)


@in_python
def test_an_episode_that_is_restored_has_the_same_noise():
    env = gym.make(STAB, **QUICK, sensors=SENSORS).unwrapped
    env.reset(seed=0)
    kept = env.snapshot()
    first = [env.step(action)[0] for action in actions()[:10, 0]]
    env.restore(kept)
    assert [env.step(action)[0].tobytes() for action in actions()[:10, 0]] == [seen.tobytes() for seen in first]
    env.reset(seed=0)
    state = env.state
    env.reset()
    assert env.state.noise_key_0 != state.noise_key_0


def test_plain_forms():
    assert Sensors(noise=(("yaw_rate", 0.01),)) == Sensors(noise={"yaw_rate": 0.01})
    mine = gym.make(STAB, **QUICK, sensors=SENSORS)
    assert gym.make(STAB, **QUICK, sensors=dataclasses.asdict(SENSORS)).unwrapped.task == mine.unwrapped.task
    assert gym.make(EnvSpec.from_json(mine.spec.to_json())).unwrapped.task == mine.unwrapped.task


@pytest.mark.parametrize(
    ("sensors", "match"),
    [
        ({"noise": {"yawrate": 0.01}}, "sensors: noise: entry must be one of .*did you mean 'yaw_rate'"),
        ({"resolution": {"speed": 0.01}}, "sensors: resolution: entry must be one of"),
        ({"noise": {"yaw_rate": -0.01}}, r"sensors: noise\['yaw_rate'\] must be"),
        ({"nois": {}}, "did you mean 'noise'"),
        (3, "sensors must be None, Sensors"),
    ],
)
def test_a_mistake_is_named(sensors, match):
    with pytest.raises((TypeError, ValueError), match=match):
        gym.make(STAB, **QUICK, sensors=sensors)


CAR = ("yaw_rate", "lateral_acceleration", "front_steer", "rear_steer", "front_steer_command", "rear_steer_command")


@pytest.mark.parametrize("env_id", [STAB, LANE])
def test_the_names_of_what_a_car_measures(env_id):
    given = {**QUICK, "sensors": Sensors(signals="car")}
    for env in (gym.make(env_id, **given).unwrapped, TorchVectorEnv(env_id, CARS, **given)):
        assert env.observation_names[:7] == (*CAR, "lateral_position")
        assert len(env.observation_names) == 7 + len(env.task.preview_times)


@pytest.mark.exhaustive  # test_options.py has one car, many and tensors with all options, these among them
@pytest.mark.parametrize("env_id", [STAB, LANE])
@pytest.mark.parametrize("late", [{}, {"observation_delay": 2, "relaxation_length": 0.4}])
def test_what_a_car_measures_is_the_same_for_one_car_many_and_tensors(env_id, late):
    given = {**QUICK, **late, "sensors": Sensors(signals="car", noise={"lateral_acceleration": 0.2})}
    many = gym.make_vec(env_id, CARS, **given, autoreset_mode="Disabled")
    tensors = TorchVectorEnv(env_id, CARS, **given, autoreset_mode="Disabled")
    alone = [gym.make(env_id, **given) for _ in range(CARS)]
    assert many.unwrapped.observation_names[:7] == (*CAR, "lateral_position")
    assert len(many.unwrapped.observation_names) == 7 + len(many.unwrapped.task.preview_times)
    options = {"state": {"yaw_rate": 0.1, "heading": 0.02}}
    observation, _ = many.reset(seed=3, options=options)
    for k, env in enumerate(alone):
        assert env.reset(seed=3 + k, options=options)[0].tobytes() == observation[k].tobytes()
    tensors.reset(seed=0)
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.unwrapped.state._asdict().items()})
    over = np.zeros(CARS, bool)
    for action in actions():
        observation, reward, terminated, truncated, _ = many.step(action)
        seen, *_ = tensors.step(torch.from_numpy(action))
        for k in np.flatnonzero(~over):
            expected = alone[k].step(action[k])
            assert (observation[k].tobytes(), reward[k]) == (expected[0].tobytes(), expected[1])
            np.testing.assert_allclose(seen[k].numpy(), observation[k], rtol=1e-6, atol=1e-6)
        over |= terminated | truncated


@in_python
@pytest.mark.exhaustive
def test_an_accelerometer_feels_the_mean_of_the_step_gusts_included():
    gust = {"name": "gust", "force": 1500.0, "start": 0.1, "duration": 0.2, "side": "left"}
    given = {**QUICK, "control_timestep": 0.004, "physics_timestep": 0.001, "disturbances": [gust], "telemetry": True}
    env = gym.make(STAB, **given, sensors=Sensors(signals=("lateral_acceleration", "yaw_rate"))).unwrapped
    _, before = env.reset(options={"state": {"lateral_velocity": 0.5}})
    assert env.observation_names == ("lateral_acceleration", "yaw_rate")
    largest = 0.0
    for k in range(60):
        observation, _, _, _, after = env.step(np.array([0.3, 0.0]))
        told = float(observation[0]) * env.observation_scale[0]
        mean = 0.5 * (before["lateral_acceleration"] + after["lateral_acceleration"])
        if k not in (24, 25, 74, 75):  # where the gust begins and ends within a step
            assert told == pytest.approx(mean, abs=2e-3)
        largest, before = max(largest, abs(told)), after
    assert largest > 1.0


@pytest.mark.exhaustive
def test_signals_come_in_the_order_asked_for_and_with_their_mirror_image():
    env = gym.make(LANE, **QUICK, sensors=Sensors(signals=["heading", "preview", "lateral_position"])).unwrapped
    assert env.observation_names[:2] == ("heading", "lateral_position")
    assert len(env.observation_names) == 2 + len(env.task.preview_times)
    assert not gym.make(LANE, **QUICK, sensors=Sensors(signals=["heading"])).unwrapped.task.preview_times


@in_python
@pytest.mark.exhaustive
def test_a_controller_says_what_it_misses_and_lqg_takes_the_accelerometer():
    signals = (*CAR, "lateral_position", "heading")
    env = gym.make(STAB, **QUICK, sensors=Sensors(signals=signals), speed_ratio=1.2).unwrapped
    with pytest.raises(ValueError, match="needs lateral_velocity in the observation, which has yaw_rate"):
        control.make("lqr", env)
    policy = control.make("lqg", env)
    observation, _ = env.reset(options={"state": {"lateral_velocity": 1.0, "yaw_rate": 0.1}})
    for _ in range(300):
        observation, *_ = env.step(policy.act(observation))
    assert env.is_success


@pytest.mark.parametrize(
    ("signals", "match"),
    [
        (("yawrate",), "did you mean 'yaw_rate'"),
        ("all", "signals must be None, 'car' or names"),
        ((), "each once"),
        (("heading", "heading"), "each once"),
    ],
)
def test_signals_that_are_none(signals, match):
    with pytest.raises((TypeError, ValueError), match=match):
        gym.make(STAB, **QUICK, sensors={"signals": signals})
