"""``action_repeat=``: one step of the environment holds its action for several control steps."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all

from bicycle_env import control
from bicycle_env.envs import TorchVectorEnv

STAB = "BicycleStab-v0"
QUICK = {"tire": "linear", "geometry": "small_angle"}
CARS = 8


def actions(steps):
    rng = np.random.default_rng(5)
    return rng.uniform(-1.0, 1.0, (steps, CARS, 2)).astype(np.float32)


def test_a_step_is_so_many_of_the_same_action():
    held, plain = (gym.make(STAB, **QUICK, action_repeat=repeat) for repeat in (3, 1))
    for env in (held, plain):
        env.reset(seed=3)
    over = False
    for action in actions(200)[:, 0]:
        observation, reward, terminated, truncated, info = held.step(action)
        total = 0.0
        for _ in range(3):
            seen, gained, *ended, told = plain.step(action)
            total += gained
            if any(ended):
                break
        assert observation.tobytes() == seen.tobytes()
        assert (reward, [terminated, truncated], info) == (total, ended, told)
        assert held.unwrapped.state == plain.unwrapped.state
        over = terminated or truncated
        if over:
            break
    assert over


def test_an_episode_is_as_long_as_without():
    env = gym.make(STAB, **QUICK, action_repeat=3, max_episode_steps=10, speed_ratio=0.5)
    env.reset(options={"state": {"yaw_rate": 0.1}})
    over = [env.step(np.zeros(2, np.float32))[3] for _ in range(4)]
    assert over == [False, False, False, True]
    assert env.unwrapped.state.time == pytest.approx(0.2)
    bare = gym.make(STAB, **QUICK, action_repeat=3, max_episode_steps=10, speed_ratio=0.5).unwrapped
    bare.reset(seed=0)
    assert not any(bare.step(np.zeros(2, np.float32))[3] for _ in range(5))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("threads", [1, only_all(2)])
def test_each_row_is_the_single_environment(mode, threads):
    given = {**QUICK, "action_repeat": 4, "max_episode_steps": 42}
    many = gym.make_vec(STAB, CARS, **given, autoreset_mode=mode, threads=threads)
    alone = [gym.make(STAB, **given) for _ in range(CARS)]
    observation, _ = many.reset(seed=3)
    for k, env in enumerate(alone):
        assert env.reset(seed=3 + k)[0].tobytes() == observation[k].tobytes()
    waiting, ended = np.zeros(CARS, bool), 0
    for action in actions(30):
        observation, reward, terminated, truncated, info = many.step(action)
        for k, env in enumerate(alone):
            if waiting[k]:
                if mode == "Disabled":
                    continue
                expected, rest = env.reset()[0], (0.0, False, False)
            else:
                expected, *rest, _ = env.step(action[k])
            assert (reward[k], terminated[k], truncated[k]) == tuple(rest)
            if mode == "SameStep" and (rest[1] or rest[2]):
                assert info["final_obs"][k].tobytes() == expected.tobytes()
                expected = env.reset()[0]
            assert observation[k].tobytes() == expected.tobytes()
        over = terminated | truncated
        ended += np.count_nonzero(over)
        waiting = waiting | over if mode == "Disabled" else over & (mode == "NextStep")
    assert ended >= CARS


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_tensors_do_the_same(mode):
    given = {**QUICK, "action_repeat": 4, "autoreset_mode": "Disabled"}
    many, tensors = gym.make_vec(STAB, CARS, **given), TorchVectorEnv(STAB, CARS, **{**given, "autoreset_mode": mode})
    many.reset(seed=3)
    tensors.reset(seed=0)
    tensors.set_state({name: torch.from_numpy(values) for name, values in many.unwrapped.state._asdict().items()})
    over = np.zeros(CARS, bool)
    for action in actions(12):
        _, reward, terminated, truncated, _ = many.step(action)
        _, gained, ended, timed_out, _ = tensors.step(torch.from_numpy(action))
        for k in np.flatnonzero(~over):
            assert gained[k].item() == pytest.approx(reward[k], rel=1e-12, abs=1e-12)
            assert (ended[k], timed_out[k]) == (terminated[k], truncated[k])
        over |= terminated | truncated
    assert over.any()


def test_a_bad_row_ends_alone():
    many = gym.make_vec(STAB, CARS, **QUICK, action_repeat=2, on_invalid="terminate", autoreset_mode="Disabled")
    many.reset(seed=0)
    bad = np.zeros((CARS, 2), np.float32)
    bad[1, 0] = np.nan
    _, reward, terminated, _, info = many.step(bad)
    others = np.arange(CARS) != 1
    np.testing.assert_array_equal(terminated, ~others)
    assert (info["end"][1], reward[1]) == (3, 0.0)
    assert (reward[others] > 0.0).all()


def test_the_linear_model_and_controllers_are_those_of_the_held_action():
    env = gym.make(STAB, **QUICK, action_repeat=5, speed_ratio=1.2).unwrapped
    model, rng = env.linear_model(), np.random.default_rng(0)
    assert (model.timestep, env.action_timestep) == (0.1, 0.1)
    x = rng.uniform(-1.0, 1.0, 6) * [0.3, 0.05, 1.0, 0.1, 1e-3, 1e-3]
    u = rng.uniform(-0.03, 0.03, 2)
    env.reset(options={"state": dict(zip(model.state_names, x.tolist(), strict=True))})
    env.step(u)
    after = [getattr(env.state, name) for name in model.state_names]
    np.testing.assert_allclose(after, model.A @ x + model.B @ u, rtol=0.0, atol=1e-12)
    for name in ("lqr", "pole-placement", "lqg"):
        policy = control.make(name, env)
        observation, _ = env.reset(options={"state": {"lateral_velocity": 1.0, "yaw_rate": 0.1}})
        for _ in range(80):
            observation, *_ = env.step(policy.act(observation))
        assert env.is_success, name
