"""BicycleEvade-v0: corridor, touch, friction, reward and success, each computed here a second time."""

import math

import gymnasium as gym
import numpy as np
import pytest
import torch

from bicycle_env import control, drivers
from bicycle_env.envs import TorchVectorEnv
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.tasks.ends import clearance
from bicycle_env.tasks.episode import EpisodeState, World
from bicycle_env.tasks.evade import Evade, Gates
from bicycle_env.tasks.metrics import Run, figures

ID = "BicycleEvade-v0"
QUICK = {"tire": "linear"}
GATES = {"obstacle_time": 1.2, "obstacle_length": 0.6, "return_time": 1.5}
SIDES = pytest.mark.parametrize("side", [-1.0, 1.0], ids=["right", "left"])


@pytest.fixture(scope="module")
def plant():
    return gym.make(ID, **QUICK).unwrapped


def corridor(x, side, speed, front):
    """(right edge, left edge) at a place of the road, m."""
    begin = front + 1.2 * speed
    end = begin + 0.6 * speed
    lanes = [(-1.75, 1.75), (1.75, 5.25)] if side > 0 else [(-1.75, 1.75), (-5.25, -1.75)]
    if x >= end + 1.5 * speed:
        return lanes[0]
    if begin <= x <= end:
        return lanes[1]
    return min(lanes[0][0], lanes[1][0]), max(lanes[0][1], lanes[1][1])


def points(state, car):
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        forward = car.front_extent - share * (car.front_extent + car.rear_extent)
        for left in (-0.5 * car.body_width, 0.5 * car.body_width):
            yield (
                state.longitudinal_position + forward * math.cos(state.heading) - left * math.sin(state.heading),
                state.lateral_position + forward * math.sin(state.heading) + left * math.cos(state.heading),
            )


def clear_by_hand(state, side, car):
    found = []
    for x, y in points(state, car):
        right, left = corridor(x, side, car.speed, car.front_extent)
        found.append(min(y - right, left - y))
    return min(found)


@SIDES
def test_five_points_along_each_side_are_judged_at_their_own_places(plant, side):
    car, task, rng = plant.configuration.car, Evade(), np.random.default_rng(0)
    world = World(car, plant.rules, task.settings(car.speed))
    law, cost, reference = clearance(PYTHON, task), task.cost(PYTHON), task.reference(PYTHON)
    own = Gates(side, 1.0, 1.2, 0.6, 1.5, 0.0)
    episode, outside = EpisodeState(0.0, 0.0, 0.0, 0.0, own), 0
    for gate in (1.2, 1.8, 3.3):
        for _ in range(150):
            x = gate * car.speed + rng.uniform(-8.0, 8.0)
            state = CarState(x, side * rng.uniform(-1.5, 5.0), rng.uniform(-0.5, 0.5), 0.0, 0.0, 0.0, 0.0)
            here = reference(state, own, world)
            expected = clear_by_hand(state, side, car)
            assert law(state, here, episode, world) == pytest.approx(expected, abs=1e-9)
            assert cost(state, here, episode, world) == float(expected < 0.0)
            outside += expected < 0.0
    assert 100 < outside < 400


def test_what_is_drawn(plant):
    env = gym.make_vec(ID, 400, tire="linear")
    env.reset(seed=3)
    state = env.unwrapped.state
    for name, (low, high) in {
        "relative_friction": (0.3, 1.0),
        "obstacle_time": (0.9, 1.6),
        "obstacle_length": (0.3, 0.6),
        "return_time": (0.9, 1.6),
        "lateral_position": (-0.2, 0.2),
        "heading": (-0.01, 0.01),
        "lateral_velocity": (-0.005 * plant.speed, 0.005 * plant.speed),
        "yaw_rate": (-0.03, 0.03),
    }.items():
        values, margin = getattr(state, name), 0.02 * (high - low)
        assert low <= values.min() < low + margin
        assert high - margin < values.max() <= high
    assert set(state.side) == {-1.0, 1.0}
    assert 0.4 < np.mean(state.side > 0.0) < 0.6
    assert plant.steer == "front"
    assert plant.speed == 1.2 * plant.vehicle.critical_speed


@SIDES
def test_the_corners_of_the_obstacle_are_marked(plant, side):
    task, car = Evade(), plant.configuration.car
    world = World(car, plant.rules, task.settings(car.speed))
    obstacle, cones = task.marks(Gates(side, 1.0, 1.2, 0.6, 1.5, 0.0), world)
    begin, end = car.front_extent + 1.2 * car.speed, car.front_extent + 1.8 * car.speed
    assert (obstacle.kind, cones.kind) == ("obstacle", "cones")
    assert obstacle.points == cones.points
    np.testing.assert_allclose(sorted(cones.points), [(begin, -1.75), (begin, 1.75), (end, -1.75), (end, 1.75)])


def test_the_gates_are_seen_from_the_front_bumper(plant):
    observation, _ = plant.reset(options={"state": {"longitudinal_position": 10.0}, "direction": "right", **GATES})
    seen = dict(zip(plant.observation_names, observation * plant.observation_scale, strict=True))
    assert seen["speed"] == pytest.approx(plant.speed, rel=1e-6)
    assert seen["side"] == -1.0
    for name, seconds in (("obstacle_begin", 1.2), ("obstacle_end", 1.8), ("last_gate", 3.3)):
        assert seen[name] == pytest.approx(seconds * plant.speed - 10.0, rel=1e-6)
    far, _ = plant.reset(options={"state": {"longitudinal_position": 1e4}, **GATES})
    assert far[10:13].tolist() == [-5.0, -5.0, -5.0]


@pytest.mark.parametrize("friction", [0.4, 0.7])
def test_the_hidden_friction_acts(friction):
    """A car on the drawn friction is the car on a road with that one."""
    hidden, known = (gym.make(ID, tire="fiala", friction=mu, telemetry=True).unwrapped for mu in (0.9, 0.9 * friction))
    for env, share in ((hidden, friction), (known, 1.0)):
        env.reset(options={"state": {}, "direction": "left", "relative_friction": share, **GATES})
    for _ in range(30):
        one, other = (env.step(np.array([0.9]))[4] for env in (hidden, known))
        assert one["lateral_acceleration"] == pytest.approx(other["lateral_acceleration"], rel=1e-9, abs=1e-9)
        assert one["front_saturation"] == pytest.approx(other["front_saturation"], rel=1e-9)
    assert one["front_saturation"] > 0.95
    assert len(hidden.observation_names) == 14
    assert "relative_friction" not in hidden.observation_names


@SIDES
def test_a_touch_is_remembered_and_forfeits_success(side):
    """Behind the last gate, straight on: a success, unless the body was outside for one step."""
    env = gym.make(ID, max_episode_steps=60, **QUICK)
    for lateral, touches in ((0.84, False), (0.86, True)):
        far = {"longitudinal_position": 1e3, "lateral_position": side * lateral, "heading": -side * 1e-3}
        env.reset(seed=0, options={"state": far})
        for step in range(60):
            observation, reward, terminated, truncated, info = env.step(np.zeros(1))
            assert bool(observation[13]) == (env.unwrapped.state.touched == 1.0) == touches
            assert (reward < 0.5) == (touches and step > 0)
        assert (terminated, truncated) == (False, True)
        assert abs(env.unwrapped.state.lateral_position) < 0.84, "it has come in again"
        assert info["cost"] == 0.0
        assert info["is_success"] is not touches


def test_success_is_to_run_straight_for_half_a_second():
    env = gym.make(ID, max_episode_steps=30, **QUICK).unwrapped
    for name, limit in {"heading": 0.05, "lateral_velocity": 0.05 * env.speed, "yaw_rate": 0.1}.items():
        for share, expected in ((0.9, 1.0), (1.1, 0.0)):
            env.reset(options={"state": {"longitudinal_position": 1e3, name: share * limit}})
            law = env.task.success(PYTHON)
            world = World(env.configuration.car, env.rules, env.task.settings(env.speed))
            state = CarState(*env.state[:7])
            own = Gates(*env.state[10:])
            here = env.task.reference(PYTHON)(state, own, world)
            assert law(state, here, EpisodeState(0.0, 0.0, 0.0, 0.0, own), world) == expected, name
    assert env.configuration.steps_to_settle == 25


@SIDES
def test_it_ends_two_and_a_half_metres_outside(plant, side):
    word = "left" if side > 0 else "right"
    for lateral, end in ((3.3, ""), (3.4, "left_corridor")):  # + 0.9 - 1.75 = 2.45, 2.55
        plant.reset(
            options={"state": {"longitudinal_position": 1e3, "lateral_position": side * lateral}, "direction": word}
        )
        info = plant.step(np.zeros(1))[4]
        assert info["end"] == end
        assert info["cost"] == 1.0
    place = 1.5 * plant.speed  # beside the obstacle, in the own lane: 1.75 + 0.9
    plant.reset(options={"state": {"longitudinal_position": place}, "direction": word, **GATES})
    assert plant.step(np.zeros(1))[4]["end"] == "left_corridor"
    plant.reset(
        options={"state": {"longitudinal_position": place, "lateral_position": side * 3.5}, "direction": word, **GATES}
    )
    assert plant.step(np.zeros(1))[4] == {"end": "", "cost": 0.0, "is_success": False}


def test_the_reward_by_hand():
    env = gym.make(ID, telemetry=True, steer="both", **QUICK)
    plant, rng, seen = env.unwrapped, np.random.default_rng(1), set()
    for seed in range(6):
        env.reset(seed=seed)
        last, touched, over = np.zeros(2), False, False
        if seed >= 3:  # behind the last gate
            env.reset(seed=seed, options={"state": {"longitudinal_position": 300.0, "yaw_rate": 0.05}})
        for _ in range(80):
            action = 0.3 * rng.uniform(-1.0, 1.0, 2)
            _, reward, over, _, info = env.step(action)
            state = plant.state
            behind = (
                state.longitudinal_position - plant.vehicle.rear_extent
                > plant.vehicle.front_extent
                + plant.speed * (state.obstacle_time + state.obstacle_length + state.return_time)
            )
            c = (
                10.0 * max(0.0, 0.2 - info["clearance"]) ** 2
                + 10.0 * info["sideslip"] ** 2
                + 0.2 * state.yaw_rate**2
                + 0.05 * float(action @ action)
                + 0.02 * float((action - last) @ (action - last))
                + 2000.0 * behind * (state.heading**2 + info["sideslip"] ** 2 + 0.25 * state.yaw_rate**2)
            )
            assert reward == pytest.approx((0.1 if touched else 1.0) / (1.0 + c), rel=1e-12)
            assert 0.0 < reward <= 1.0
            seen.add((touched, behind))
            last, touched = action, state.touched == 1.0
            if over:
                break
    assert len(seen) == 4


def test_tensors_agree_with_the_native_environment():
    cars, given = 12, {"steer": "both", "telemetry": True, "tire": "fiala", "max_episode_steps": 340}
    native, tensors = gym.make_vec(ID, cars, **given), TorchVectorEnv(ID, cars, **given)
    rng = np.random.default_rng(5)
    options = {
        "state": {
            "lateral_position": rng.uniform(-0.2, 3.0, cars),
            "longitudinal_position": rng.uniform(0.0, 200.0, cars),
            "heading": rng.uniform(-0.02, 0.02, cars),
        },
        "relative_friction": rng.uniform(0.4, 1.0, cars),
        "direction": ["left", "right"] * (cars // 2),
        "obstacle_time": np.full(cars, 1.2),
        "obstacle_length": np.full(cars, 0.6),
        "return_time": np.full(cars, 1.5),
    }
    one, other = native.reset(options=options), tensors.reset(options=options)
    running, touched = np.ones(cars, bool), 0
    for _ in range(120):
        np.testing.assert_allclose(other[0].numpy()[running], one[0][running], rtol=1e-6, atol=1e-6)
        for name in ("clearance", "cost", "lateral_acceleration", "front_saturation"):
            np.testing.assert_allclose(
                other[-1][name].numpy()[running], one[-1][name][running], rtol=1e-10, atol=1e-11, err_msg=name
            )
        actions = 0.2 * rng.uniform(-1.0, 1.0, (cars, 2)).astype(np.float32)
        one, other = native.step(actions), tensors.step(torch.tensor(actions))
        np.testing.assert_allclose(other[1].numpy()[running], one[1][running], rtol=1e-11)
        assert np.array_equal(other[2].numpy()[running], one[2][running])
        running &= ~one[2]
        touched += int(one[0][running, 13].sum())
    assert running.any()
    assert touched > 10


def test_a_driver_of_ones_own_may_have_the_front_wheels():
    env = gym.make(ID, steer="rear", driver=drivers.Step(angle=0.01), **QUICK)
    env.reset(seed=0)
    for _ in range(60):
        env.step(np.zeros(1))
    assert abs(env.unwrapped.state.front_steer) > 0.0


def drive(policy, env, seed):
    """(cars,) successes and returns."""
    policy.reset()
    observation, _ = env.reset(seed=seed)
    over, success, total = np.zeros(env.num_envs, bool), np.zeros(env.num_envs, bool), np.zeros(env.num_envs)
    while not over.all():
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        total += reward * ~over
        success |= (terminated | truncated) & ~over & info["is_success"]
        over |= terminated | truncated
    return success, total


def test_the_path_round_the_obstacle_passes_where_lqr_touches():
    plant, env = gym.make(ID).unwrapped, gym.make_vec(ID, 200, autoreset_mode="Disabled")
    found = {name: drive(control.make(name, plant), env, 700) for name in ("zero", "lqr", "evade-path")}
    assert [found[name][0].mean() for name in ("zero", "lqr")] == [0.0, 0.0]
    success, total = found["evade-path"]
    assert success.mean() > 0.35
    assert total[success].min() > total[~success].max()
    assert total.mean() > 2.0 * found["lqr"][1].mean()


def test_figures_of_an_episode():
    env = gym.make(ID, telemetry=True)
    policy = control.make("evade-path", env)
    figure = {}
    for friction in (1.0, 0.4):
        observation, info = env.reset(
            seed=0, options={"relative_friction": friction, "obstacle_time": 1.5, "obstacle_length": 0.6}
        )
        steps, over = [], False
        while not over:
            observation, reward, terminated, truncated, info = env.step(policy.act(observation))
            steps.append({**env.unwrapped.state._asdict(), **info, "reward": reward})
            over = terminated or truncated
        columns = {name: np.array([step[name] for step in steps]) for name in steps[0] if name != "end"}
        plant = env.unwrapped
        world = World(plant.configuration.car, plant.rules, None)
        figure[friction] = figures(plant.task.metrics, Run(columns, info["is_success"], world))
        assert figure[friction]["least_clearance"] == columns["clearance"].min()
        assert figure[friction]["touched"] == columns["touched"].max()
        assert figure[friction]["peak_sideslip"] == abs(columns["sideslip"]).max()
    assert (figure[1.0]["touched"], figure[0.4]["touched"]) == (0.0, 1.0)
    assert figure[1.0]["least_clearance"] > 0.0 > figure[0.4]["least_clearance"]
