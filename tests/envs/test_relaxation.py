"""``relaxation_length=``: the same car, two more states, in every environment."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from bicycle_env import control
from bicycle_env.envs import TorchVectorEnv

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
OWN = ("front_transient_slip_angle", "rear_transient_slip_angle")
CARS = 8
LENGTHS = np.linspace(0.2, 0.9, CARS)


def actions(steps=60):
    rng = np.random.default_rng(5)
    return np.clip(np.cumsum(rng.uniform(-0.3, 0.3, (steps, CARS, 2)), axis=0), -1.0, 1.0).astype(np.float32)


@pytest.mark.exhaustive  # tests/tasks/test_options.py has one with a relaxation length, too
@pytest.mark.parametrize("env_id", [STAB, LANE])
@pytest.mark.parametrize("options", [None, {"state": {"lateral_velocity": 2.0, "yaw_rate": 0.2, OWN[1]: 0.01}}])
def test_one_car_is_one_of_many_and_of_tensors(env_id, options):
    given = {"relaxation_length": LENGTHS, "autoreset_mode": "Disabled", "telemetry": True}
    many, tensors = gym.make_vec(env_id, CARS, **given), TorchVectorEnv(env_id, CARS, **given)
    alone = [gym.make(env_id, relaxation_length=length, telemetry=True) for length in LENGTHS]
    observation, _ = many.reset(seed=3, options=options)
    for k, env in enumerate(alone):
        assert env.reset(seed=3 + k, options=options)[0].tobytes() == observation[k].tobytes()
        assert env.unwrapped.state == tuple(column[k] for column in many.unwrapped.state)
    tensors.reset(seed=0, options=options)
    if options:
        for name in OWN:
            np.testing.assert_allclose(getattr(tensors.state, name), getattr(many.unwrapped.state, name), rtol=1e-12)
    values = {name: torch.from_numpy(column) for name, column in many.unwrapped.state._asdict().items()}
    tensors.set_state(values)
    over = np.zeros(CARS, bool)
    for action in actions():
        observation, reward, terminated, truncated, info = many.step(action)
        _, gained, *_, of_tensors = tensors.step(torch.from_numpy(action))
        for k in np.flatnonzero(~over):
            expected = alone[k].step(action[k])
            assert (observation[k].tobytes(), reward[k]) == (expected[0].tobytes(), expected[1])
            assert alone[k].unwrapped.state == tuple(column[k] for column in many.unwrapped.state)
            assert gained[k].item() == pytest.approx(reward[k], rel=1e-12, abs=1e-12)
            for name in ("front_lateral_force", "rear_slip_angle", "lateral_acceleration"):
                assert expected[4][name] == info[name][k]
                assert of_tensors[name][k].item() == pytest.approx(info[name][k], rel=1e-9, abs=1e-9)
        over |= terminated | truncated
    assert over.any() or env_id == LANE


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize("steer", ["front", "rear", "both"])
def test_a_step_is_the_linear_map_of_eight_states(steer):
    env = gym.make(STAB, steer=steer, tire="linear", geometry="small_angle", relaxation_length=0.4).unwrapped
    model, rng = env.linear_model(), np.random.default_rng(1)
    assert model.A.shape == (8, 8)
    assert model.state_names[6:] == OWN
    for _ in range(10):
        x = rng.uniform(-1.0, 1.0, 8) * [0.3, 0.05, 1.0, 0.1, 1e-3, 1e-3, 0.02, 0.02]
        u = rng.uniform(-0.03, 0.03, env.configuration.axles)
        env.reset(options={"state": dict(zip(model.state_names, x.tolist(), strict=True))})
        env.step(u)
        after = [getattr(env.state, name) for name in model.state_names]
        np.testing.assert_allclose(after, model.A @ x + model.B @ u, rtol=0.0, atol=1e-12)


def test_controllers_are_designed_on_the_quasi_static_car():
    relaxed, at_once = (gym.make(STAB, relaxation_length=length, speed_ratio=1.2).unwrapped for length in (0.3, None))
    for mine, usual in zip(relaxed.linear_model(quasi_static=True)[:4], at_once.linear_model()[:4], strict=True):
        np.testing.assert_array_equal(mine, usual)
    policy = control.make("lqr", relaxed)
    observation, _ = relaxed.reset(options={"state": {"lateral_velocity": 1.0}})
    for _ in range(200):
        observation, *_ = relaxed.step(policy.act(observation))
    assert relaxed.is_success


def test_a_snapshot_holds_the_lag_and_fits_no_other_car():
    env = gym.make(STAB, relaxation_length=0.5).unwrapped
    env.reset(seed=1)
    kept, first = env.snapshot(), env.step(np.ones(2))[0]
    env.restore(kept)
    assert env.step(np.ones(2))[0].tobytes() == first.tobytes()
    with pytest.raises(TypeError, match="front_transient_slip_angle"):
        gym.make(STAB).unwrapped.restore(kept)


def test_the_timestep_knows_the_lag_of_each_car():
    gym.make(STAB, relaxation_length=0.1)
    with pytest.raises(ValueError, match=r"physics_timestep must be <= 0\.00\d+ s here"):
        gym.make(STAB, relaxation_length=0.05)
    with pytest.raises(ValueError, match=r"car 1: physics_timestep must be <= 0\.00\d+ s here"):
        gym.make_vec(STAB, 3, speed=[30.0, 60.0, 20.0], relaxation_length=[0.08, 0.09, 0.07])


def test_what_an_environment_tells_of_it():
    one, many = gym.make(STAB, relaxation_length=0.5).unwrapped, gym.make_vec(STAB, CARS, relaxation_length=LENGTHS)
    assert one.relaxation_length == 0.5
    assert gym.make(STAB).unwrapped.relaxation_length is None
    np.testing.assert_array_equal(many.unwrapped.relaxation_length, LENGTHS)
    assert one.stability.eigenvalues.shape == (4,)
    assert one.state._fields[7:9] == OWN
