"""The torch environment drives the single environment's cars: same states, rewards, ends and observations."""

import dataclasses
import itertools

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import some_of
from torch_cases import (
    CARS,
    IDS,
    LANE,
    STAB,
    STILL,
    assert_near,
    assert_same_bits,
    known,
    quick,
    random_actions,
    random_states,
    row_of,
    zeros,
)

from bicycle_env import tires, vehicles
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.episode import World


def in_single_env(env_id, states, actions, changes, **keywords):
    """Each row's step in the single environment: (first observations, results of step, states after)."""
    env = gym.make(env_id, **keywords).unwrapped
    before, results, after = [], [], []
    for row, action in enumerate(actions):
        before.append(env.reset(seed=row, options={"state": row_of(states, row), **changes(row)})[0])
        observation, reward, terminated, _, info = env.step(action)
        results.append((observation, reward, terminated, env.configuration.end_names.index(info["end"]), info["cost"]))
        after.append(env.state)
    return np.array(before), [np.array(column) for column in zip(*results, strict=True)], np.array(after).T


# Equal to the numpy path


@pytest.mark.usefixtures("interpreted")  # tests/physics/test_one_source.py has each tire and geometry compiled
@pytest.mark.parametrize(
    ("env_id", "tire", "geometry", "reward", "steer"),
    some_of(
        itertools.product(
            IDS, tires.LAWS, ("small_angle", "exact"), ("default", "quadratic"), ("front", "rear", "both")
        ),
        [
            (STAB, "linear", "small_angle", "quadratic", "front"),
            (STAB, "fiala", "exact", "default", "both"),
            (LANE, "tanh", "small_angle", "default", "rear"),
            (LANE, "magic_formula", "exact", "quadratic", "both"),
        ],
    ),
)
def test_a_step_equals_the_single_environments(env_id, steer, tire, geometry, reward):
    keywords = {"steer": steer, "tire": tire, "geometry": geometry, "reward": reward}
    states, actions = random_states(), random_actions(axles=2 if steer == "both" else 1)
    sides, begins = np.tile([1.0, -1.0], CARS // 2), np.linspace(0.0, 3.0, CARS)

    def changes(row):
        return known(env_id, direction="left" if sides[row] > 0 else "right", change_start=begins[row])

    before, (observation, reward_of, terminated, end, cost), after = in_single_env(
        env_id, states, actions, changes, **keywords
    )
    assert {0, 1, 2} <= set(end.tolist()), "the states must reach both ends, and neither"

    envs = TorchVectorEnv(env_id, CARS, autoreset_mode="Disabled", **keywords)
    envs.reset(seed=0)
    route = known(env_id, direction=sides, change_start=begins * envs.speed)
    seen, _ = envs.set_state({**states, "time": 0.0, **route})
    np.testing.assert_allclose(seen.numpy(), before, rtol=3e-7, atol=1e-9)
    seen, rewards, ended, timed_out, info = envs.step(torch.from_numpy(actions))
    np.testing.assert_allclose(seen.numpy(), observation, rtol=3e-7, atol=1e-9)
    assert_near(rewards, reward_of)
    assert ended.tolist() == terminated.tolist()
    assert info["end"].tolist() == end.tolist()
    assert info["cost"].tolist() == cost.tolist()
    assert not timed_out.any()
    for tensor, expected in zip(envs.state, after, strict=True):
        assert_near(tensor, expected)
    assert (seen.dtype, rewards.dtype, info["cost"].dtype) == (torch.float32, torch.float64, torch.float64)
    assert (ended.dtype, timed_out.dtype, info["end"].dtype) == (torch.bool, torch.bool, torch.int8)


@pytest.mark.parametrize("env_id", IDS)
def test_an_episode_follows_the_single_environments(env_id):
    """Nothing is lost between steps: commands for the smoothness term, the clock, the settled steps, the route."""
    given = {"max_episode_steps": 45, "physics_timestep": 0.02, "telemetry": True}
    singles = [gym.make(env_id, **given) for _ in range(3)]
    for row, single in enumerate(singles):
        single.reset(seed=row, options={"state": {"yaw_rate": 0.1 * row, "heading": 0.02}})
    envs = TorchVectorEnv(env_id, 3, autoreset_mode="Disabled", **given)
    envs.reset(seed=0)
    starts = [single.unwrapped.state._asdict() for single in singles]
    envs.set_state({name: [start[name] for start in starts] for name in starts[0]})
    for k in range(45):
        action = 0.15 * np.sin(0.2 * k + np.arange(6.0).reshape(3, 2)).astype(np.float32)
        _, reward, terminated, truncated, info = envs.step(torch.from_numpy(action))
        for row, single in enumerate(singles):
            _, gained, ended, timed_out, told = single.step(action[row])
            assert gained == pytest.approx(reward[row].item(), rel=1e-9)
            assert (ended, timed_out) == (terminated[row].item(), truncated[row].item())
            assert envs.end_names[info["end"][row]] == told.pop("end")
            assert {name for name in info if not name.startswith("_")} == {"end", *told}
            for name, value in told.items():
                assert info[name][row].item() == pytest.approx(value, rel=1e-8, abs=1e-6), name
    assert truncated.all()
    np.testing.assert_allclose(
        np.array([column.numpy() for column in envs.state]).T, [single.unwrapped.state for single in singles], rtol=1e-9
    )


def test_straight_running_is_a_success_after_a_second():
    envs, single = quick(2), gym.make(STAB, tire="linear", physics_timestep=0.02).unwrapped
    envs.reset(seed=0)
    envs.set_state({**STILL, "yaw_rate": [0.0, 0.06]})
    single.reset(options={"state": {}})
    for _ in range(55):
        *_, info = envs.step(zeros(envs))
        single.step(np.zeros(2, np.float32))
        assert envs.is_success.tolist() == info["is_success"].tolist() == [single.is_success, False]
    assert single.is_success


@pytest.mark.parametrize("env_id", IDS)
def test_mirror_images_are_exact(env_id):
    envs = TorchVectorEnv(env_id, 2 * CARS, autoreset_mode="Disabled", tire="magic_formula")
    envs.reset(seed=0)
    state = {name: np.concatenate([column, -column]) for name, column in random_states().items()}
    state["longitudinal_position"] = abs(state["longitudinal_position"])
    envs.set_state({**state, **known(env_id, direction=np.repeat([1.0, -1.0], CARS), change_start=30.0)})
    actions = torch.from_numpy(random_actions())
    for _ in range(3):
        observation, reward, *_ = envs.step(torch.cat([actions, -actions]))
    assert torch.equal(observation[CARS:], observation[:CARS] * torch.tensor(envs.observation_mirror).float())
    assert torch.equal(reward[CARS:], reward[:CARS])


@dataclasses.dataclass(frozen=True)
class Arctangent(tires.Tire):
    """Y = -(2/pi) D atan(pi C alpha / (2 D)): a fifth law."""

    def law(self, xp):
        def lateral_force(slip_angle, cornering_stiffness, peak_force):
            steepness = (np.pi / 2) * cornering_stiffness / peak_force
            return (-2.0 / np.pi) * peak_force * xp.atan(slip_angle * steepness)

        return lateral_force


@pytest.mark.usefixtures("interpreted")
def test_a_fifth_tire_law_needs_one_class_and_one_row(monkeypatch):
    monkeypatch.setitem(tires.LAWS, "arctangent", Arctangent)
    states, actions = random_states(), random_actions()
    _, (_, reward, *_), after = in_single_env(STAB, states, actions, lambda _: {}, tire="arctangent")
    envs = TorchVectorEnv(STAB, CARS, tire="arctangent", autoreset_mode="Disabled")
    envs.reset(options={"state": states})
    assert_near(envs.step(torch.from_numpy(actions))[1], reward)
    for tensor, expected in zip(envs.state, after, strict=True):
        assert_near(tensor, expected)


@pytest.mark.parametrize("env_id", IDS)
def test_float32_is_close_and_stays_float32(env_id):
    states, actions = random_states(), torch.from_numpy(random_actions())
    results = []
    for dtype in ("float64", "float32"):
        envs = TorchVectorEnv(env_id, CARS, dtype=dtype, autoreset_mode="Disabled", telemetry=True)
        envs.reset(options={"state": states, **known(env_id, direction="left", change_start=1.0)})
        results.append((envs.step(actions), envs.state))
    (exact, exact_state), (single, single_state) = results
    inexact = [value for value in (*single_state, single[1], *single[4].values()) if value.is_floating_point()]
    assert {value.dtype for value in inexact} == {torch.float32}
    assert 1e-9 < (single[1] - exact[1]).abs().max() < 2e-5
    for value, expected in zip(single_state, exact_state, strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(single[0], exact[0], rtol=1e-5, atol=1e-4)


# A value per car


@pytest.mark.parametrize("env_id", IDS)
def test_each_car_has_its_own_values(env_id):
    names = ["oversteer", vehicles["me303"], "oversteer", "civic"]
    speeds, friction = [40.0, 20.0, 45.0, 30.0], torch.tensor([1.0, 0.5, 0.75, 0.25])
    states, actions = {name: column[:4] / 3.0 for name, column in random_states().items()}, random_actions(4)
    envs = TorchVectorEnv(env_id, 4, vehicle=names, speed=speeds, friction=friction, autoreset_mode="Disabled")
    options = known(env_id, direction="right", change_start=1.0)
    seen, _ = envs.reset(options={"state": states, **options})
    _, reward, *_ = envs.step(torch.from_numpy(actions))
    for row in range(4):
        own = {"vehicle": names[row], "speed": speeds[row], "friction": friction[row].item()}
        single = gym.make(env_id, **own).unwrapped
        first, _ = single.reset(options={"state": row_of(states, row), **options})
        np.testing.assert_allclose(seen[row], first, rtol=3e-7, atol=1e-9)
        _, gained, *_ = single.step(actions[row])
        assert reward[row].item() == pytest.approx(gained, rel=1e-12)
        np.testing.assert_allclose([column[row] for column in envs.state], single.state, rtol=1e-12, atol=1e-12)
    assert envs.observation_scale.shape == (4, len(envs.observation_names))


def test_starts_are_drawn_in_each_cars_own_speed():
    envs = quick(3, env_id=LANE, speed=[20.0, 40.0, 40.0])
    envs.reset(seed=0)
    fastest = envs.state.change_start / torch.tensor([20.0, 40.0, 40.0], dtype=torch.float64)
    assert ((fastest >= 0.5) & (fastest <= 1.5)).all()


# Random starts


@pytest.mark.parametrize("env_id", IDS)
def test_starts_are_the_tasks_law_of_torchs_own_numbers(env_id):
    envs = TorchVectorEnv(env_id, 5)
    envs.reset(seed=21)
    single = gym.make(env_id).unwrapped
    uniforms = torch.rand(
        (single.task.uniforms, 5), generator=torch.Generator().manual_seed(21), dtype=torch.float64
    ).numpy()
    for row in range(5):
        world = World(single.configuration.car, single.rules, single.configuration.settings)
        state, route = single.task.start(NUMPY)(uniforms[:, row], world)
        started = {**state._asdict(), **route._asdict()}
        for name, value in started.items():
            assert getattr(envs.state, name)[row] == pytest.approx(value, rel=1e-14, abs=1e-16), name


@pytest.mark.parametrize("env_id", IDS)
def test_the_same_seed_gives_the_same_run_and_another_one_does_not(env_id):
    envs, twin = quick(6, env_id=env_id, max_episode_steps=4), quick(6, env_id=env_id, max_episode_steps=4)
    actions = torch.rand(10, 6, 2, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0

    def run(which, seed):
        return [which.reset(seed=seed), *(which.step(action) for action in actions), which.reset()]

    first = run(envs, 5)
    assert_same_bits(first, run(twin, 5))
    assert_same_bits(first, run(envs, 5))
    other = run(envs, 6)
    for one, another in zip(first, other, strict=True):
        assert not torch.equal(one[0], another[0])
    assert not torch.equal(quick().reset()[0], quick().reset()[0]), "unseeded environments differ"


def test_no_cars_starts_depend_on_what_the_others_do():
    envs, twin = quick(autoreset_mode="SameStep"), quick(autoreset_mode="SameStep")
    envs.reset(seed=9)
    twin.reset(seed=9)
    wild, calm = torch.ones(4, 2), torch.ones(4, 2)
    calm[1:] = 0.0
    ends = torch.zeros(4)
    for _ in range(90):
        observation, *_, info = envs.step(wild)
        quiet, *_, told = twin.step(calm)
        assert torch.equal(observation[0], quiet[0])
        ends += info["_final_obs"] + 0.0 - (told["_final_obs"] + 0.0)
    assert ends[1:].any(), "the others must have ended at other times"


def test_staggered_starts_spread_the_time_outs():
    envs = quick(4, max_episode_steps=8, staggered_start=True, autoreset_mode="SameStep")
    for _ in range(2):  # with every reset of all cars
        envs.reset(seed=0)
        ended = [envs.step(zeros(envs))[3].tolist() for _ in range(16)]
        assert [step.index(True) for step in zip(*ended, strict=True)] == [7, 5, 3, 1]
        assert [sum(step) for step in zip(*ended, strict=True)] == [2, 2, 2, 2], "every later episode is whole"
    # A reset of some cars is for good: they begin at the beginning.
    envs.reset(seed=0)
    envs.reset(options={"reset_mask": np.array([False, False, True, False])})
    np.testing.assert_allclose(envs.state.time, [0.0, 0.04, 0.0, 0.12])
