"""The torch environment drives the single environment's cars: same states, rewards, ends and observations."""

import dataclasses
import itertools
import shutil
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import DataDependentOutputException, FakeTensorMode

from bicycle_env import Actuator, tires, vehicles
from bicycle_env.envs.torch_vector_env import TorchVectorEnv
from bicycle_env.registration import ENVIRONMENTS

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
IDS = [row.id for row in ENVIRONMENTS]
MODES = ("SameStep", "NextStep", "Disabled")
CARS = 40
BEYOND = {
    "longitudinal_position": 150.0,
    "lateral_position": 9.0,
    "heading": 1.6,
    "lateral_velocity": 40.0,
    "yaw_rate": 5.0,
    "front_steer": 0.1,
    "rear_steer": 0.05,
    "front_steer_command": 0.1,
    "rear_steer_command": 0.05,
}
"""Half-widths of the widest states, beyond every limit."""
STILL = dict.fromkeys(BEYOND, 0.0)


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def quick(num_envs=4, env_id=STAB, **keywords):
    """The law with the fewest operations, where the law does not matter."""
    return TorchVectorEnv(env_id, num_envs, **{"tire": "linear", "geometry": "small_angle", **keywords})


def random_states(count=CARS, seed=3):
    rng = np.random.default_rng(seed)
    width = np.linspace(0.02, 1.0, count)  # from straight running to the end of an episode
    states = {name: most * width * rng.uniform(-1.0, 1.0, count) for name, most in BEYOND.items()}
    states["longitudinal_position"] = abs(states["longitudinal_position"])
    return states


def random_actions(count=CARS, axles=2, seed=4):
    return np.random.default_rng(seed).uniform(-1.3, 1.3, (count, axles)).astype(np.float32)


def row_of(values, row):
    return {name: float(column[row]) for name, column in values.items()}


def zeros(envs):
    return torch.zeros(envs.num_envs, envs.single_action_space.shape[0])


def assert_near(tensor, expected, tolerance=1e-12):
    assert not tensor.requires_grad
    expected = np.asarray(expected, dtype=float)
    np.testing.assert_array_less(
        np.abs(tensor.numpy() - expected), tolerance * np.maximum(1.0, np.abs(expected)) + 1e-300
    )


def assert_same_bits(these, those):
    """Nested tuples and mappings of tensors."""
    assert type(these) is type(those)
    if isinstance(these, dict):
        assert these.keys() == those.keys()
        these, those = tuple(these.values()), tuple(those.values())
    if isinstance(these, (tuple, list)):
        for one, other in zip(these, those, strict=True):
            assert_same_bits(one, other)
    else:
        assert these.dtype == those.dtype
        assert torch.equal(these, those)


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


@pytest.mark.parametrize("reward", ["default", "quadratic"])
@pytest.mark.parametrize(("tire", "geometry"), list(itertools.product(tires.LAWS, ("small_angle", "exact"))))
@pytest.mark.parametrize(("env_id", "steer"), list(itertools.product(IDS, ("front", "rear", "both"))))
def test_a_step_equals_the_single_environments(env_id, steer, tire, geometry, reward):
    keywords = {"steer": steer, "tire": tire, "geometry": geometry, "reward": reward}
    states, actions = random_states(), random_actions(axles=2 if steer == "both" else 1)
    sides, begins = np.tile([1.0, -1.0], CARS // 2), np.linspace(0.0, 3.0, CARS)

    def changes(row):
        return (
            {"direction": "left" if sides[row] > 0 else "right", "change_start": begins[row]} if env_id == LANE else {}
        )

    before, (observation, reward_of, terminated, end, cost), after = in_single_env(
        env_id, states, actions, changes, **keywords
    )
    assert {0, 1, 2} <= set(end.tolist()), "the states must reach both ends, and neither"

    envs = TorchVectorEnv(env_id, CARS, autoreset_mode="Disabled", **keywords)
    envs.reset(seed=0)
    route = {"direction": sides, "change_start": begins * envs.speed} if env_id == LANE else {}
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
    singles = [gym.make(env_id, max_episode_steps=45, telemetry=True) for _ in range(3)]
    for row, single in enumerate(singles):
        single.reset(seed=row, options={"state": {"yaw_rate": 0.1 * row, "heading": 0.02}})
    envs = TorchVectorEnv(env_id, 3, max_episode_steps=45, autoreset_mode="Disabled", telemetry=True)
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
            assert info.keys() == {"end", *told}
            for name, value in told.items():
                assert info[name][row].item() == pytest.approx(value, rel=1e-8, abs=1e-6), name
    assert truncated.all()
    np.testing.assert_allclose(
        np.array([column.numpy() for column in envs.state]).T, [single.unwrapped.state for single in singles], rtol=1e-9
    )


def test_straight_running_is_a_success_after_a_second():
    envs, single = quick(2), gym.make(STAB, tire="linear").unwrapped
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
    if env_id == LANE:
        state |= {"direction": np.repeat([1.0, -1.0], CARS), "change_start": 30.0}
    envs.set_state(state)
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
        envs.reset(options={"state": states, **({"direction": "left", "change_start": 1.0} if env_id == LANE else {})})
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
    options = {"direction": "right", "change_start": 1.0} if env_id == LANE else {}
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
    uniforms = torch.rand((4, 5), generator=torch.Generator().manual_seed(21), dtype=torch.float64).numpy()
    single = gym.make(env_id).unwrapped
    for row in range(5):
        single.reset(seed=0)
        single._kernels.start(
            single._memory, np.empty(len(single.observation_names), np.float32), uniforms[:, row].copy()
        )
        np.testing.assert_allclose([column[row] for column in envs.state], single.state, rtol=1e-14, atol=1e-16)


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
    envs, twin = quick(), quick()
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


def test_staggered_starts_spread_the_first_time_outs():
    envs = quick(4, max_episode_steps=8, staggered_start=True, autoreset_mode="SameStep")
    envs.reset(seed=0)
    ended = [envs.step(zeros(envs))[3].tolist() for _ in range(16)]
    assert [step.index(True) for step in zip(*ended, strict=True)] == [7, 5, 3, 1]
    assert [sum(step) for step in zip(*ended, strict=True)] == [2, 2, 2, 2], "every later episode is whole"


# The ends of episodes


def spinning(envs, row):
    """One car beyond the yaw-rate limit, the others straight."""
    state = STILL
    state["yaw_rate"] = np.where(np.arange(envs.num_envs) == row, 5.0, 0.0)
    return envs.set_state({**state, "time": 0.0})


def test_same_step():
    envs = quick(autoreset_mode="SameStep", max_episode_steps=3)
    envs.reset(seed=0)
    spinning(envs, 1)
    observation, reward, terminated, truncated, info = envs.step(zeros(envs))
    alone = quick(autoreset_mode="Disabled")
    alone.reset(seed=0)
    spinning(alone, 1)
    last, gained, *_, told = alone.step(zeros(envs))
    assert (terminated.tolist(), truncated.tolist()) == ([False, True, False, False], [False] * 4)
    assert torch.equal(reward, gained)
    assert torch.equal(info["final_obs"], last)
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True, False, False]
    assert_same_bits(info["final_info"], told)
    assert [envs.end_names[code] for code in info["final_info"]["end"]] == ["", "spun", "", ""]
    assert info["end"].tolist() == [0, 0, 0, 0]
    assert [torch.equal(*pair) for pair in zip(observation, last, strict=True)] == [True, False, True, True]
    assert abs(envs.state.yaw_rate[1]) <= 0.8, "a start of the task"
    assert np.allclose(envs.state.time, [0.02, 0.0, 0.02, 0.02])
    envs.step(zeros(envs))
    *_, truncated, info = envs.step(zeros(envs))
    assert truncated.tolist() == info["_final_obs"].tolist() == [True, False, True, True]
    *_, truncated, info = envs.step(zeros(envs))
    assert truncated.tolist() == [False, True, False, False]
    assert info["final_info"]["end"].tolist() == [0, 0, 0, 0], "a time-out shows in truncated only"


def test_next_step():
    envs = quick(autoreset_mode="NextStep", max_episode_steps=3)
    envs.reset(seed=0)
    spinning(envs, 1)
    _, _, terminated, _, info = envs.step(zeros(envs))
    assert terminated.tolist() == [False, True, False, False]
    assert info["end"].tolist() == [0, 1, 0, 0]
    assert not {"final_obs", "final_info"} & info.keys()
    observation, reward, terminated, truncated, info = envs.step(torch.ones(4, 2))
    assert not terminated.any()
    assert not truncated.any()
    assert reward[1] == 0.0
    assert (reward[[0, 2, 3]] > 0.0).all()
    assert info["end"].tolist() == [0, 0, 0, 0]
    assert np.allclose(envs.state.time, [0.04, 0.0, 0.04, 0.04])
    assert envs.state.front_steer_command[1] == 0.0, "the action of the step that starts anew is ignored"
    assert torch.equal(observation, envs._look()[0])
    _, _, _, truncated, _ = envs.step(zeros(envs))
    assert truncated.tolist() == [True, False, True, True]
    _, reward, _, truncated, _ = envs.step(zeros(envs))
    assert not truncated.any()
    assert (reward == 0.0).tolist() == [True, False, True, True]


def test_disabled():
    envs = quick(autoreset_mode="Disabled", max_episode_steps=3)
    envs.reset(seed=0)
    spinning(envs, 1)
    first, *_ = envs.step(zeros(envs))
    for step in (2, 3, 4):
        observation, reward, terminated, truncated, info = envs.step(torch.ones(4, 2))
        assert torch.equal(observation[1], first[1])
        assert (reward == 0.0).tolist() == ([False, True, False, False] if step < 4 else [True] * 4)
        assert terminated.tolist() == [False, True, False, False]
        assert truncated.tolist() == ([False] * 4 if step < 3 else [True, False, True, True])
        assert info["end"].tolist() == [0, 1, 0, 0]
    state = envs.state
    mask = np.array([False, True, True, False])
    options = {"reset_mask": mask, "state": {"heading": [0.1, 0.2, 0.3, 0.4]}}
    envs.reset(options=options)
    assert options.keys() == {"reset_mask", "state"}
    np.testing.assert_allclose(envs.state.heading, [state.heading[0], 0.2, 0.3, state.heading[3]], rtol=1e-15)
    _, reward, terminated, truncated, _ = envs.step(zeros(envs))
    assert (reward == 0.0).tolist() == truncated.tolist() == [True, False, False, True]
    assert not terminated.any()


def test_a_time_out_and_an_end_in_one_step_are_both_told():
    envs = quick(max_episode_steps=1, autoreset_mode="Disabled")
    envs.reset(seed=0)
    spinning(envs, 1)
    _, _, terminated, truncated, _ = envs.step(zeros(envs))
    assert (terminated.tolist(), truncated.tolist()) == ([False, True, False, False], [True] * 4)


def test_no_time_limit():
    envs = quick(max_episode_steps=-1)
    assert envs.max_episode_steps is None
    envs.reset(seed=0)
    envs.set_state({**STILL, "time": 1e6})
    assert not envs.step(zeros(envs))[3].any()
    assert [TorchVectorEnv(row.id, 1).max_episode_steps for row in ENVIRONMENTS] == [400, 300]


# Actions that are not finite


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_action_ends_its_own_row_only(mode, bad):
    envs, twin = quick(autoreset_mode=mode), quick(autoreset_mode=mode)
    for each in (envs, twin):
        each.reset(seed=2)
    actions = torch.full((4, 2), 0.3)
    spoiled = actions.clone()
    spoiled[2, 1] = bad
    state = envs.state
    observation, reward, terminated, truncated, info = envs.step(spoiled)
    expected = twin.step(actions)
    others = [0, 1, 3]
    assert torch.equal(observation[others], expected[0][others])
    assert torch.equal(reward[others], expected[1][others])
    assert reward[2] == 0.0
    assert terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    last = info["final_info"] if mode == "SameStep" else info
    assert [envs.end_names[code] for code in last["end"]] == ["", "", "invalid_action", ""]
    if mode != "SameStep":
        assert [column[2].item() for column in envs.state] == [column[2].item() for column in state]
    assert all(column.isfinite().all() for column in envs.state)
    observation, reward, *_ = envs.step(actions)
    assert observation.isfinite().all()
    assert torch.equal(observation[others], twin.step(actions)[0][others])


def test_a_bad_action_never_pays():
    envs = quick(reward="quadratic", autoreset_mode="Disabled")
    single = gym.make(STAB, tire="linear", reward="quadratic").unwrapped
    envs.reset(seed=2)
    envs.step(zeros(envs))
    spoiled = zeros(envs)
    spoiled[0] = np.nan
    _, reward, *_ = envs.step(spoiled)
    single.reset(options={"state": {"yaw_rate": 5.0}})
    _, failed, *_ = single.step(np.zeros(2, np.float32))
    worst = (failed + 4.0 * 5.0**2) / 399.0  # this start's own stage cost is 4 r^2
    assert reward[0].item() == pytest.approx(399.0 * worst)
    assert (reward[1:] > -100.0).all()


def test_a_bad_action_can_raise_and_then_nothing_has_changed():
    envs, twin = quick(on_invalid="raise"), quick(on_invalid="raise")
    for each in (envs, twin):
        each.reset(seed=2)
    spoiled = zeros(envs)
    spoiled[3, 0] = np.nan
    with pytest.raises(ValueError, match=r"action must be finite numbers.*for car 3"):
        envs.step(spoiled)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


def test_a_row_that_waits_for_its_start_may_be_given_anything():
    for mode in ("NextStep", "Disabled"):
        envs = quick(autoreset_mode=mode, on_invalid="raise")
        envs.reset(seed=0)
        spinning(envs, 1)
        envs.step(zeros(envs))
        spoiled = zeros(envs)
        spoiled[1] = np.nan
        *_, info = envs.step(spoiled)
        assert info["end"].tolist() == ([0, 0, 0, 0] if mode == "NextStep" else [0, 1, 0, 0])


# On the device, without waiting for it


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_a_step_reads_nothing_on_the_host(env_id, mode):
    """Fake tensors have no values: whatever asks for one raises."""
    envs = quick(env_id=env_id, autoreset_mode=mode, telemetry=True)
    envs.reset(seed=0)
    with FakeTensorMode(allow_non_fake_inputs=True):
        observation, reward, *_ = envs.step(zeros(envs))
        envs.reset()
    assert (observation.shape, reward.shape) == (envs.observation_space.shape, (4,))


def test_the_test_above_can_fail():
    envs = quick(on_invalid="raise")
    envs.reset(seed=0)
    with pytest.raises(DataDependentOutputException), FakeTensorMode(allow_non_fake_inputs=True):
        envs.step(zeros(envs))


class HostGenerator(torch.Generator):
    """torch makes no generator of a device that it does not have."""

    def __new__(cls, device=None):
        return super().__new__(cls)


@pytest.mark.parametrize(
    ("env_id", "mode", "tire"),
    [
        (STAB, "SameStep", "fiala"),
        (LANE, "NextStep", "linear"),
        (LANE, "SameStep", "linear"),
        (STAB, "Disabled", "tanh"),
    ],
)
def test_all_is_on_the_device(env_id, mode, tire, monkeypatch):
    """Fake CUDA tensors refuse to meet one on the host, and need no GPU."""
    monkeypatch.setattr(torch, "Generator", HostGenerator)
    with FakeTensorMode(allow_non_fake_inputs=True):
        cars = {"tire": tire, "friction": [1.0, 0.5, 1.0, 1.0]}
        envs = TorchVectorEnv(env_id, 4, device="cuda", autoreset_mode=mode, telemetry=True, **cars)
        assert str(envs.device) == "cuda:0"
        observation, info = envs.reset(seed=0, options={"state": {"yaw_rate": 0.1}})
        results = envs.step(torch.zeros(4, 2, device="cuda"))
        everything = [observation, *info.values(), *results[:4], *results[4].values(), *envs.state]
        everything += envs.measure().values()
        tensors = [one for value in everything for one in (value.values() if isinstance(value, dict) else [value])]
        assert {str(tensor.device) for tensor in tensors} == {"cuda:0"}
        with pytest.raises(ValueError, match="action must be on cuda:0, got one on cpu"):
            envs.step(torch.zeros(4, 2))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("mode", MODES)
def test_a_gpu_drives_the_same_and_is_not_waited_for(mode):
    states, actions = random_states(), torch.from_numpy(random_actions())
    on_host, on_gpu = (
        TorchVectorEnv(LANE, CARS, device=device, autoreset_mode="Disabled") for device in ("cpu", "cuda")
    )
    for envs in (on_host, on_gpu):
        envs.reset(options={"state": states, "direction": "left", "change_start": 0.5})
    expected, seen = on_host.step(actions), on_gpu.step(actions.cuda())
    assert_near(seen[1].cpu(), expected[1])
    assert torch.equal(seen[4]["end"].cpu(), expected[4]["end"])
    envs = TorchVectorEnv(STAB, 64, device="cuda", autoreset_mode=mode)
    envs.reset(seed=0)
    actions = torch.rand(64, 2, device="cuda")
    torch.cuda.set_sync_debug_mode("error")
    try:
        envs.step(actions)
    finally:
        torch.cuda.set_sync_debug_mode("default")


# Gradients


@pytest.mark.parametrize("reward", ["default", "quadratic"])
@pytest.mark.parametrize("env_id", IDS)
def test_the_reward_has_the_gradient_of_its_finite_differences(env_id, reward):
    """Through two steps, so through the state, too; small states, far from where clips and limits have corners."""
    states = {name: 0.05 * column[:2] for name, column in random_states().items()}
    states |= {name: 0.0 for name in ("front_steer_command", "rear_steer_command")}
    if env_id == LANE:
        states |= {"direction": 1.0, "change_start": -20.0}
    envs = TorchVectorEnv(env_id, 2, reward=reward, rear_actuator=Actuator(angle_limit=0.05))
    envs.reset(seed=0)

    def gained(actions):
        envs.set_state(states)
        return sum(envs.step(action)[1].sum() for action in actions)

    numbers = torch.rand(2, 2, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    actions = (0.1 * numbers).requires_grad_()
    (slope,) = torch.autograd.grad(gained(actions), actions)
    width = 1e-5
    with torch.no_grad():
        for place in itertools.product(range(2), repeat=3):
            nudge = torch.zeros_like(actions)
            nudge[place] = width
            measured = (gained(actions + nudge) - gained(actions - nudge)) / (2.0 * width)
            assert slope[place].item() == pytest.approx(measured.item(), rel=1e-5, abs=1e-8)
    assert (slope[0].abs() > 1e-6).all()


def test_gradients_are_finite_from_any_state_and_stop_at_the_end_of_an_episode():
    envs = TorchVectorEnv(STAB, CARS)
    envs.reset(seed=0)
    envs.set_state(random_states())
    actions = torch.from_numpy(random_actions()).requires_grad_()
    *_, info = envs.step(actions)
    over = info["_final_obs"]
    assert over.any()
    assert not over.all()
    observation, *_ = envs.step(zeros(envs))
    (slope,) = torch.autograd.grad(observation.sum(), actions)
    assert slope.isfinite().all()
    assert (slope[over] == 0.0).all()
    assert (slope[~over] != 0.0).any(), "elsewhere the actions count, unless they saturate"


def test_detach_forgets_how_the_state_came_about():
    envs = quick()
    envs.reset(seed=0)
    actions = zeros(envs).requires_grad_()
    observation, *_ = envs.step(actions)
    assert observation.requires_grad
    assert envs.step(zeros(envs))[0].requires_grad
    envs.detach()
    assert not envs.step(zeros(envs))[0].requires_grad


# States given and taken


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("env_id", IDS)
def test_a_state_returns_as_it_was_given(env_id, dtype):
    envs, twin = quick(env_id=env_id, dtype=dtype), quick(env_id=env_id, dtype=dtype)
    envs.reset(seed=0)
    twin.reset(seed=1)
    for _ in range(30):  # to the steering limits
        envs.step(torch.ones(4, 2))
    state = envs.state
    observation, info = twin.set_state(state._asdict())
    assert_same_bits(twin.state, state)
    assert_same_bits(observation, envs._look()[0])
    assert info.keys() == {"end", "cost", "is_success"}
    twin.set_state({name: column.tolist() for name, column in state._asdict().items()})
    assert_same_bits(twin.state, state)
    twin.set_state({"heading": 0.25})
    assert_same_bits(twin.state, state._replace(heading=torch.full((4,), 0.25, dtype=getattr(torch, dtype))))


def test_options_give_numbers_or_columns_and_zero_elsewhere():
    envs = quick(env_id=LANE)
    options = {"state": {"heading": 0.1, "yaw_rate": [0.1, 0.2, 0.3, 0.4]}, "direction": "right", "change_start": 2.0}
    envs.reset(seed=3, options=options)
    state = envs.state
    assert state.heading.tolist() == [0.1] * 4
    assert state.yaw_rate.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert state.lateral_position.tolist() == [0.0] * 4
    assert state.direction.tolist() == [-1.0] * 4
    np.testing.assert_allclose(state.change_start, 2.0 * envs.speed, rtol=1e-15)
    plain = quick(env_id=LANE)
    plain.reset(seed=3)
    assert_same_bits(envs.reset()[0], plain.reset()[0])


def test_a_snapshot_continues_to_the_bit():
    envs, twin = (quick(6, max_episode_steps=5) for _ in range(2))
    envs.reset(seed=4)
    actions = torch.rand(12, 6, 2, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0
    for action in actions[:3]:
        envs.step(action)
    snapshot = envs.snapshot()
    seen = envs._look()
    first = [envs.step(action) for action in actions]
    assert_same_bits(envs.restore(snapshot), seen)
    assert_same_bits([envs.step(action) for action in actions], first)
    twin.restore(snapshot)
    assert_same_bits([twin.step(action) for action in actions], first)
    with pytest.raises(TypeError, match=r"snapshot must come from snapshot\(\) with num_envs = 4"):
        quick().restore(snapshot)


@pytest.mark.parametrize("mode", MODES)
def test_what_is_returned_belongs_to_the_caller(mode):
    envs, twin = (quick(env_id=LANE, autoreset_mode=mode, telemetry=True) for _ in range(2))
    for each in (envs, twin):
        each.reset(seed=0)
    actions = torch.full((4, 2), 0.4, dtype=torch.float64)
    results = envs.step(actions)
    expected = twin.step(actions)
    everything = [*results[:4], *results[4].values(), *envs.state, *envs.measure().values(), envs.is_success, actions]
    everything += [column for part in envs.snapshot().episodes[:2] for column in part if not isinstance(column, tuple)]
    for value in everything:
        for tensor in value.values() if isinstance(value, dict) else [value]:
            tensor.zero_()
    envs._checked_action(actions, envs._episodes).add_(1.0)
    assert_same_bits(envs.step(torch.ones(4, 2)), twin.step(torch.ones(4, 2)))
    assert expected[1].all()


# Bad input


BAD_KEYWORDS = [
    ({"num_envs": 0}, ValueError, r"num_envs must be a whole number in \[1, "),
    ({"num_envs": 2.5}, TypeError, "num_envs must be a whole number"),
    ({"env_id": "BicyclStab-v0"}, gym.error.NameNotFound, "BicycleStab"),
    ({"env_id": "CartPole-v1"}, ValueError, "env_id must be of a single-track environment, got 'CartPole-v1'"),
    ({"env_id": 3}, TypeError, "env_id must be the id of a registered environment, got 3"),
    ({"device": "gpu"}, ValueError, "device must be one that torch can use here, got 'gpu'"),
    ({"device": 1.5}, ValueError, "device must be one that torch can use here, got 1.5"),
    ({"dtype": "float16"}, ValueError, "dtype must be one of 'float64', 'float32', got 'float16'"),
    ({"dtype": torch.int64}, ValueError, "dtype must be one of 'float64', 'float32', got 'int64'"),
    ({"autoreset_mode": "nextstep"}, ValueError, "autoreset_mode must be one of .*did you mean 'NextStep'"),
    ({"autoreset_mode": 1}, TypeError, "autoreset_mode must be one of"),
    ({"max_episode_steps": 0}, ValueError, "max_episode_steps must be a whole number"),
    ({"on_invalid": "ignore"}, ValueError, "on_invalid must be one of 'terminate', 'raise', got 'ignore'"),
    ({"compile": 1}, TypeError, "compile must be True or False, got 1"),
    ({"staggered_start": "no"}, TypeError, "staggered_start must be True or False"),
    ({"tyre": "fiala"}, TypeError, "unknown keyword 'tyre'; did you mean 'tire'"),
    ({"render_mode": "human"}, TypeError, "unknown keyword 'render_mode'"),
    ({"direction": "left"}, TypeError, "unknown keyword 'direction'"),
    ({"friction": [1.0, 1.0, -1.0, 1.0]}, ValueError, "car 2: friction must be a finite number > 0, got -1"),
    ({"friction": torch.ones(3)}, ValueError, "friction must be one number or num_envs = 4 of them"),
    ({"speed_ratio": [1.0, 1.0, np.nan, 1.0]}, ValueError, "car 2: speed_ratio must be"),
]  # fmt: skip


@pytest.mark.parametrize(("keywords", "error", "match"), BAD_KEYWORDS)
def test_bad_keywords_are_named(keywords, error, match):
    with pytest.raises(error, match=match):
        TorchVectorEnv(**{"env_id": STAB, "num_envs": 4, **keywords})


BAD_OPTIONS = [
    ({"state": {"yaw_rate": [0.1, 0.2]}}, ValueError, r"options\['state'\]\['yaw_rate'\] must be one .* = 4 of them, got shape \(2,\)"),
    ({"state": {"yaw_rate": [0.1, 0.2, 11.0, 0.1]}}, ValueError, r"options\['state'\]\['yaw_rate'\] must be .* in \[-10, 10\], got 11"),
    ({"state": {"yaw_rate": [0.1, -10.5, 1.0, 0.1]}}, ValueError, "yaw_rate.* got -10.5"),
    ({"state": {"yaw_rate": torch.tensor([0.1, 0.2, np.nan, 0.1])}}, ValueError, "yaw_rate.* got nan"),
    ({"state": {"yaw_rate": torch.zeros(4, dtype=torch.bool)}}, TypeError, "yaw_rate"),
    ({"state": {"yaw_rate": ["a"] * 4}}, TypeError, "yaw_rate"),
    ({"state": {"yaw_rate": "fast"}}, TypeError, "yaw_rate"),
    ({"state": {"yaw_rate": [[1.0], 2.0, 3.0, 4.0]}}, TypeError, "yaw_rate"),
    ({"state": {"front_steer": 0.2}}, ValueError, "front_steer"),
    ({"state": {"time": 0.2}}, ValueError, "unknown state name 'time'"),
    ({"state": {"yawrate": np.zeros(4)}}, ValueError, "unknown state name 'yawrate'; did you mean 'yaw_rate'"),
    ({"state": [0.0] * 4}, TypeError, r"options\['state'\] must be a mapping"),
    ({"direction": "left"}, ValueError, "unknown reset option 'direction'"),
    ({"reset_mask": [True, False]}, ValueError, r"options\['reset_mask'\] must be num_envs = 4 booleans, got \[True, False\]"),
    ({"reset_mask": torch.ones(4)}, ValueError, "reset_mask"),
    ({"reset_mask": None}, ValueError, "reset_mask"),
    (["state"], TypeError, "options must be a mapping"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "error", "match"), BAD_OPTIONS)
def test_bad_options_are_named_and_nothing_changes(options, error, match):
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    with pytest.raises(error, match=match):
        envs.reset(seed=77, options=options)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


@pytest.mark.parametrize(
    ("state", "error", "match"),
    [
        ({"yaw_rat": 0.1}, ValueError, "unknown state name 'yaw_rat'; did you mean 'yaw_rate'"),
        ({"yaw_rate": 20.0}, ValueError, r"state\['yaw_rate'\] must be a finite number in \[-10, 10\], got 20.0"),
        ({"time": -0.1}, ValueError, r"state\['time'\] must be a finite number >= 0, got -0.1"),
        ({"time": [0.0, 1.0, np.inf, 0.0]}, ValueError, r"state\['time'\].* got inf"),
        ({"direction": 1.0}, ValueError, "unknown state name 'direction'"),
        ([1.0], TypeError, "state must be a mapping"),
    ],
)
def test_bad_states_are_named_and_nothing_changes(state, error, match):
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    with pytest.raises(error, match=match):
        envs.set_state(state)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


@pytest.mark.parametrize(
    ("action", "error", "match"),
    [
        (np.zeros((4, 2), np.float32), TypeError, r"action must be a tensor of \(4, 2\) real numbers on cpu, got ndarray"),
        (torch.zeros(4, 2, dtype=torch.bool), TypeError, "got torch.bool"),
        (torch.zeros(4, 2, dtype=torch.complex64), TypeError, "got torch.complex64"),
        (torch.zeros(4, 1), ValueError, r"action must have shape \(4, 2\) \(steer='both'\), got \(4, 1\)"),
        (torch.zeros(2), ValueError, "action must have shape"),
        (torch.zeros(4, 2, device="meta"), ValueError, "action must be on cpu, got one on meta"),
    ],
)  # fmt: skip
def test_bad_actions_are_named_and_nothing_changes(action, error, match):
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    with pytest.raises(error, match=match):
        envs.step(action)
    assert_same_bits(envs.step(zeros(envs)), twin.step(zeros(envs)))


def test_whole_numbers_are_actions_too():
    envs, twin = quick(), quick()
    for each in (envs, twin):
        each.reset(seed=0)
    assert_same_bits(envs.step(torch.ones(4, 2, dtype=torch.int64)), twin.step(torch.ones(4, 2)))


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True])
def test_bad_seeds_are_named(seed):
    with pytest.raises((ValueError, TypeError), match="seed must be a whole number"):
        quick().reset(seed=seed)


def test_what_needs_a_reset_says_so():
    envs = quick()
    for ask in (
        lambda: envs.step(zeros(envs)),
        lambda: envs.state,
        lambda: envs.is_success,
        lambda: envs.snapshot(),
        lambda: envs.measure(),
        lambda: envs.set_state({}),
        lambda: envs.detach(),
        lambda: envs.reset(options={"reset_mask": [True] * 4}),
    ):
        with pytest.raises(gym.error.ResetNeeded, match=r"call reset\(\) before"):
            ask()


# As a Gymnasium vector environment


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", IDS)
def test_it_looks_like_a_vector_environment(env_id, mode):
    envs = TorchVectorEnv(env_id, 3, steer="rear", autoreset_mode=gym.vector.AutoresetMode(mode))
    single = gym.make(env_id, steer="rear")
    assert isinstance(envs, gym.vector.VectorEnv)
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space == gym.vector.utils.batch_space(single.observation_space, 3)
    assert envs.action_space == gym.vector.utils.batch_space(single.action_space, 3)
    assert envs.autoreset_mode is envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode(mode)
    assert envs.num_envs == 3
    assert envs.spec.id == env_id
    assert envs.observation_names == single.unwrapped.observation_names
    np.testing.assert_array_equal(envs.observation_scale, single.unwrapped.observation_scale)
    np.testing.assert_array_equal(envs.observation_mirror, single.unwrapped.observation_mirror)
    assert envs.stability.speed_ratio == pytest.approx(1.2)
    np.testing.assert_array_equal(envs.linear_model().A, single.unwrapped.linear_model().A)
    envs.action_space.seed(0)
    observation, info = envs.reset(seed=0)
    assert observation.numpy() in envs.observation_space
    assert info.keys() == {"end", "cost", "is_success"}
    observation, reward, *_ = envs.step(torch.from_numpy(envs.action_space.sample()))
    assert observation.numpy() in envs.observation_space
    assert reward.shape == (3,)
    envs.close()


def test_the_ids_module_is_imported_first():
    program = (
        "from bicycle_env.envs import TorchVectorEnv; print(TorchVectorEnv('bicycle_env:BicycleStab-v0', 2).spec.id)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == STAB


def test_torch_is_imported_when_it_is_used_and_missed_in_one_line():
    program = (
        "import sys\n"
        "from bicycle_env.envs import TorchVectorEnv\n"
        "print('torch' in sys.modules)\n"
        "sys.modules['torch'] = None\n"
        "try:\n"
        "    TorchVectorEnv('BicycleStab-v0', 2)\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["False", 'TorchVectorEnv needs torch: pip install "bicycle-env[agents]"']


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
@pytest.mark.filterwarnings("ignore")  # the compiler's own
def test_a_compiled_substep_drives_the_same():
    states, actions = random_states(), torch.from_numpy(random_actions())
    results = []
    for compile in (False, True):
        envs = quick(CARS, compile=compile, autoreset_mode="Disabled")
        envs.reset(seed=0, options={"state": states})
        with torch.no_grad():
            results.append((envs.step(actions), envs.state))
    (plain, plain_state), (compiled, compiled_state) = results
    assert_near(compiled[1], plain[1].numpy())
    for column, expected in zip(compiled_state, plain_state, strict=True):
        assert_near(column, expected.numpy())
