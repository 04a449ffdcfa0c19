"""Noise and resolution of what is observed: statistics, and the same numbers for one car, many and tensors."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all
from gymnasium.envs.registration import EnvSpec

from bicycle_env import Sensors
from bicycle_env.envs import TorchVectorEnv

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
QUICK = {"tire": "linear", "geometry": "small_angle"}
NOISE = {"yaw_rate": 0.01, "lateral_position": 0.05, "front_steer_command": 0.002}
SENSORS = Sensors(noise=NOISE, resolution={"front_steer": 0.002, "lateral_position": 0.01})
CARS = 8


def actions(steps=60):
    rng = np.random.default_rng(5)
    return np.clip(np.cumsum(rng.uniform(-0.1, 0.1, (steps, CARS, 2)), axis=0), -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("env_id", [STAB, only_all(LANE)])
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
    plain = gym.make_vec(STAB, 400, **QUICK)
    noisy = gym.make_vec(STAB, 400, **QUICK, sensors=Sensors(noise=NOISE))
    differences = []
    for env in (plain, noisy):
        env.reset(seed=1)
    for _ in range(10):
        action = np.zeros((400, 2), np.float32)
        (mine, reward, *_), (theirs, expected, *_) = noisy.step(action), plain.step(action)
        np.testing.assert_array_equal(reward, expected)  # who judges knows the truth
        differences.append((mine - theirs) * plain.unwrapped.observation_scale)
    found = np.concatenate(differences)
    names = list(plain.unwrapped.observation_names)
    for j, name in enumerate(names):
        deviation = NOISE.get(name, 0.0)
        assert np.std(found[:, j]) == pytest.approx(deviation, rel=0.05)
        assert abs(np.mean(found[:, j])) <= 4.0 * deviation / np.sqrt(len(found))
    first, second = (found[:, names.index(name)] for name in ("yaw_rate", "lateral_position"))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.08


def test_values_are_told_in_steps():
    env = gym.make(STAB, **QUICK, sensors=Sensors(resolution={"yaw_rate": 0.05})).unwrapped
    place = env.observation_names.index("yaw_rate")
    for value, told in ((0.0, 0.0), (0.024, 0.0), (0.026, 0.05), (-0.026, -0.05), (0.12, 0.1), (0.13, 0.15)):
        observation, _ = env.reset(options={"state": {"yaw_rate": value}})
        assert observation[place] * env.observation_scale[place] == pytest.approx(told, abs=1e-7)


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
