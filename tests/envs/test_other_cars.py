"""``reset(options={"vehicle": ..., "speed": ..., "friction": ...})``: another car is driven, until the next reset."""

import copy
import dataclasses
import pickle

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all

from bicycle_env import vehicles
from bicycle_env.envs import TorchVectorEnv

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
CARS = 8
QUICK = {"tire": "magic_formula", "reward": "quadratic", "speed": 40.0}  # compiled for tests/contracts, too
OTHERS = {
    "vehicle": ["oversteer", "me303", vehicles["civic"], "understeer"] * 2,
    "speed": np.linspace(20.0, 45.0, CARS),
    "friction": np.linspace(0.3, 1.0, CARS),
}


def actions(steps=40):
    rng = np.random.default_rng(5)
    return np.clip(np.cumsum(rng.uniform(-0.3, 0.3, (steps, CARS, 2)), axis=0), -1.0, 1.0).astype(np.float32)


def of_row(options, row):
    return {name: options[name] if isinstance(options[name], (str, float)) else options[name][row] for name in options}


@pytest.mark.parametrize("env_id", [STAB, only_all(LANE)])
def test_a_car_given_at_reset_drives_as_one_that_was_made_so(env_id):
    """But for the scales of what is observed, which stay nominal."""
    for given in ({"speed": 30.0}, {"friction": 0.4}, {"vehicle": "me303", "speed": 25.0, "friction": 0.8}):
        env, made = gym.make(env_id, **QUICK), gym.make(env_id, **{**QUICK, **given})
        env.reset(seed=4, options=given)
        made.reset(seed=4)
        assert env.unwrapped.state == made.unwrapped.state
        for action in actions()[:, 0]:
            _, reward, *over, _ = env.step(action)
            assert [reward, *over] == list(made.step(action)[1:4])
            assert env.unwrapped.state == made.unwrapped.state
            if any(over):
                break
        assert (env.unwrapped.speed, env.unwrapped.vehicle, env.unwrapped.friction) == (
            40.0,
            vehicles["oversteer"],
            1.0,
        )
        assert env.unwrapped.present.speed == made.unwrapped.speed
        np.testing.assert_array_equal(
            env.unwrapped.observation_scale, gym.make(env_id, **QUICK).unwrapped.observation_scale
        )


def test_it_lasts_until_the_next_reset():
    env, plain = gym.make(STAB, **QUICK).unwrapped, gym.make(STAB, **QUICK).unwrapped
    env.reset(seed=1, options={"friction": 0.4})
    env.reset(seed=1)
    plain.reset(seed=1)
    for action in actions(20)[:, 0]:
        assert env.step(action)[0].tobytes() == plain.step(action)[0].tobytes()
    assert env.present == env.configuration


@pytest.mark.parametrize("env_id", [STAB, only_all(LANE)])
@pytest.mark.parametrize("mode", ["NextStep", only_all("SameStep")])
def test_each_row_is_the_single_environment_and_tensors_agree(env_id, mode):
    given = {**QUICK, "telemetry": True, "varied": True, "max_episode_steps": 30}
    many = gym.make_vec(env_id, CARS, **given, autoreset_mode=mode)
    alone = [gym.make(env_id, **QUICK, telemetry=True, max_episode_steps=30) for _ in range(CARS)]
    tensors = TorchVectorEnv(env_id, CARS, **{**given, "max_episode_steps": -1}, autoreset_mode="Disabled")
    observation, _ = many.reset(seed=3, options=OTHERS)
    tensors.reset(seed=0, options={**OTHERS, "speed": torch.from_numpy(OTHERS["speed"])})
    state = many.unwrapped.state._asdict()
    tensors.set_state({name: torch.from_numpy(values) for name, values in state.items()})
    for k, env in enumerate(alone):
        assert env.reset(seed=3 + k, options=of_row(OTHERS, k))[0].tobytes() == observation[k].tobytes()
    waiting, first = np.zeros(CARS, bool), np.ones(CARS, bool)
    for action in actions():
        observation, reward, terminated, truncated, info = many.step(action)
        _, gained, _, _, told = tensors.step(torch.from_numpy(action))
        for k, env in enumerate(alone):
            if waiting[k]:  # the car that was given goes on; a single environment is told so
                assert env.reset(options=of_row(OTHERS, k))[0].tobytes() == observation[k].tobytes()
                continue
            expected, *rest, single = env.step(action[k])
            assert (reward[k], terminated[k], truncated[k]) == tuple(rest)
            if first[k]:
                assert gained[k].item() == pytest.approx(reward[k], rel=1e-12, abs=1e-12)
            if not (mode == "SameStep" and (rest[1] or rest[2])):
                assert observation[k].tobytes() == expected.tobytes()
                for name in ("sideslip", "front_saturation", "lateral_acceleration"):
                    assert single[name] == info[name][k]
                    if first[k]:
                        assert told[name][k].item() == pytest.approx(info[name][k], rel=1e-9, abs=1e-9)
            else:
                assert env.reset(options=of_row(OTHERS, k))[0].tobytes() == observation[k].tobytes()
        over = terminated | truncated
        first &= ~over
        waiting = over & (mode == "NextStep")
    assert not first.any()


def test_rows_of_a_mask_change_alone_and_back():
    many, plain = (gym.make_vec(STAB, CARS, **QUICK, varied=True, autoreset_mode="Disabled") for _ in range(2))
    many.reset(seed=0, options=OTHERS)
    mask = np.arange(CARS) % 2 == 0
    many.reset(seed=0, options={"reset_mask": mask})
    many.reset(seed=0, options={"reset_mask": ~mask, "friction": 0.5})
    plain.reset(seed=0)
    before = many.step(actions()[0])[0], plain.step(actions()[0])[0]
    np.testing.assert_array_equal(before[0][mask], before[1][mask])
    frictions = many.unwrapped._rows.cars(many.unwrapped.fleet)[0].front_peak_force
    assert len(set(frictions.tolist())) == 2


@pytest.mark.parametrize("how", ["snapshot", "copy", "pickle"])
@pytest.mark.parametrize("kind", ["single", "native", "torch"])
def test_a_snapshot_and_a_copy_go_on_with_the_car(kind, how):
    options = {"speed": 30.0, "friction": 0.5, "vehicle": "me303"}
    env = {
        "single": lambda: gym.make(STAB, **QUICK).unwrapped,
        "native": lambda: gym.make_vec(STAB, CARS, **QUICK, varied=True).unwrapped,
        "torch": lambda: TorchVectorEnv(STAB, CARS, **QUICK, varied=True, autoreset_mode="Disabled"),
    }[kind]()
    action = (
        torch.from_numpy(actions()[0]) if kind == "torch" else actions()[0] if kind == "native" else actions()[0, 0]
    )
    env.reset(seed=2, options=options)
    other = copy.deepcopy(env) if how == "copy" else pickle.loads(pickle.dumps(env)) if how == "pickle" else env
    kept = env.snapshot()
    first = [np.asarray(value).copy() for value in (env.step(action)[0], *env.state)]
    if how == "snapshot":
        env.reset(seed=3)
        env.restore(kept)
    again = [np.asarray(value).copy() for value in (other.step(action)[0], *other.state)]
    for mine, theirs in zip(again, first, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("kind", ["single", "native", "torch"])
def test_a_snapshot_of_the_nominal_car_brings_it_back(kind):
    env = {
        "single": lambda: gym.make(STAB, **QUICK).unwrapped,
        "native": lambda: gym.make_vec(STAB, CARS, **QUICK, varied=True).unwrapped,
        "torch": lambda: TorchVectorEnv(STAB, CARS, **QUICK, varied=True, autoreset_mode="Disabled"),
    }[kind]()
    action = (
        torch.from_numpy(actions()[0]) if kind == "torch" else actions()[0] if kind == "native" else actions()[0, 0]
    )
    env.reset(seed=2)
    kept = env.snapshot()
    first = [np.asarray(value).copy() for value in (env.step(action)[0], *env.state)]
    env.reset(seed=2, options={"speed": 20.0, "vehicle": "me303"})
    env.restore(kept)
    again = [np.asarray(value).copy() for value in (env.step(action)[0], *env.state)]
    for mine, theirs in zip(again, first, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"speed": 0.0}, ValueError, "speed must be"),
        ({"speed": "fast"}, TypeError, "speed must be"),
        ({"friction": -1.0}, ValueError, "friction must be"),
        ({"vehicle": "oversteerr"}, ValueError, "did you mean 'oversteer'"),
        ({"speed_ratio": 1.2}, ValueError, "reset option .*'speed'"),
        (
            {"vehicle": dataclasses.replace(vehicles["oversteer"], mass=10.0, yaw_inertia=10.0)},
            ValueError,
            "physics_timestep must be",
        ),
    ],
)
@pytest.mark.parametrize("kind", ["single", "native", "torch"])
def test_a_bad_option_is_refused_before_anything_changes(kind, options, error, match):
    env = {
        "single": lambda: gym.make(STAB, **QUICK).unwrapped,
        "native": lambda: gym.make_vec(STAB, CARS, **QUICK, varied=True).unwrapped,
        "torch": lambda: TorchVectorEnv(STAB, CARS, **QUICK, varied=True),
    }[kind]()
    env.reset(seed=2)
    before = [np.asarray(value).copy() for value in env.state]
    with pytest.raises(error, match=match):
        env.reset(seed=3, options=options)
    for mine, theirs in zip(env.state, before, strict=True):
        np.testing.assert_array_equal(np.asarray(mine), theirs)


@pytest.mark.parametrize("kind", ["native", "torch"])
def test_cars_that_share_their_numbers_say_what_is_needed(kind):
    env = gym.make_vec(STAB, 2, **QUICK) if kind == "native" else TorchVectorEnv(STAB, 2, **QUICK)
    with pytest.raises(ValueError, match=r"options: speed must not be given here: .*varied=True"):
        env.reset(options={"speed": 30.0})
