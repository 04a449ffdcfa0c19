"""MPC that is told the truth: its plans are what the car then does, follow what is asked, keep out of what is shut."""

import math

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import Actuator
from bicycle_env.analysis.linear_model import STATE_NAMES
from bicycle_env.optimum import HOLD, PREDICTIVE, Cars, Knowledge, drive
from bicycle_env.physics.car import CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.tasks.ends import clearance
from bicycle_env.tasks.episode import EpisodeState
from bicycle_env.tasks.steadiness import reference_yaw_rate

STEER, CHANGE, EVADE = PREDICTIVE
ALL = Knowledge(friction=True, command=True)
KEYWORDS = {STEER: {}, CHANGE: {"randomise": {"friction": (0.6, 1.0)}, "action_delay": 3}, EVADE: {}}
STARTS = {
    STEER: {"relative_speed": 0.95, "relative_friction": 0.7, "amplitude": 0.03},
    CHANGE: {},
    EVADE: {"relative_friction": 0.6, "obstacle_time": 1.4, "obstacle_length": 0.5, "return_time": 1.5},
}
BEGUN = {STEER: 30, CHANGE: 25, EVADE: 10}
"""Control steps after which the tests look at plans."""
SIZES = np.array([0.5, 0.2, 4.0, 0.5, 0.05, 0.04])


@pytest.fixture(scope="module")
def made():
    """Environment and controller of each id, built once."""
    found = {}

    def of(env_id, **more):
        if (env_id, *more) not in found:
            env = gym.make(env_id, **KEYWORDS[env_id], **more).unwrapped
            found[env_id, *more] = env, PREDICTIVE[env_id](env)
        return found[env_id, *more]

    return of


def usual(mpc):
    return np.array([one.start for one in mpc.searched])


def begun(env, direction="left", state=None, steps=0):
    env.reset(seed=3, options={"direction": direction, "state": state or {}, **STARTS[env.spec.id]})
    sign = 1.0 if direction == "left" else -1.0
    late = KEYWORDS[env.spec.id].get("action_delay", 0)
    for k in range(steps):  # the last ones are still under way where actions act late
        env.step(np.full(env.action_space.shape, sign * (0.05 if k < steps - late else 0.6), np.float32))
    return env.state


def states_of(env):
    return np.array([getattr(env.state, name) for name in STATE_NAMES])


@pytest.mark.parametrize("env_id", PREDICTIVE)
def test_the_plan_is_what_the_car_then_does(made, env_id):
    """With the hidden friction, the driver's future, the actions under way; the corner of rate limits left out."""
    free = {f"{axle}_actuator": Actuator(0.1, math.inf, 0.05) for axle in ("front", "rear")}
    env, mpc = made(env_id, **free)
    begun(env, steps=BEGUN[env_id])
    before = states_of(env)
    plan = mpc.plan(env.state, None, usual(mpc), ALL)
    states, actions = mpc.stages(plan)
    late = KEYWORDS[env_id].get("action_delay", 0)
    for k in range(late + HOLD * 15 + 1):
        if k >= late and (k - late) % HOLD == 0:
            assert np.all(np.abs(states_of(env) - states[(k - late) // HOLD]) < 0.02 * SIZES), k
        env.step(actions[min(k // HOLD, mpc.horizon - 1)].astype(np.float32))
    assert np.max(np.abs(states_of(env) - before) / SIZES) > 0.1
    assert mpc.failures == 0


@pytest.mark.parametrize("env_id", PREDICTIVE)
def test_the_mirror_image_has_the_mirrored_plan(made, env_id):
    env, mpc = made(env_id)
    state = {"lateral_position": 0.1, "heading": 0.01, "lateral_velocity": 0.3, "yaw_rate": -0.02}
    plans = []
    for direction, sign in (("left", 1.0), ("right", -1.0)):
        car = begun(env, direction, {name: sign * value for name, value in state.items()}, BEGUN[env_id])
        plans.append([sign * part for part in mpc.stages(mpc.plan(car, None, usual(mpc), Knowledge()))])
    for left, right in zip(*plans, strict=True):
        np.testing.assert_allclose(left, right, atol=1e-4)
    assert np.max(np.abs(plans[0][1])) > 0.05


def test_the_reference_yaw_rate_is_followed(made):
    """A gentle manoeuvre, no limit at work: with straight rear wheels the error is many times as large."""
    env, mpc = made(STEER)
    gentle = {"relative_speed": 0.9, "relative_friction": 1.0, "amplitude": 0.004, "direction": "left"}

    def largest_error(values):
        env.reset(seed=1, options=gentle)
        plan, worst = None, 0.0
        for k in range(100):
            if k % HOLD == 0 and values is not None:
                plan = mpc.plan(env.state, plan, values, ALL)
            action = np.zeros(1) if plan is None else mpc.stages(plan)[1][0]
            env.step(action.astype(np.float32))
            error = env.state.yaw_rate - reference_yaw_rate(NUMPY)(env.state, mpc.world.car)
            worst = max(worst, abs(error))
        return worst

    asked = usual(mpc)
    asked[-1] = 0.0  # the yaw rate alone
    assert largest_error(asked) < 0.1 * largest_error(None)


def test_what_it_is_not_told_it_does_not_use(made):
    """Two cars that differ in what is hidden have the same plan, until it is told; the driver's future likewise."""
    env, mpc = made(STEER)
    car = begun(env, steps=BEGUN[STEER])
    other = car._replace(relative_friction=0.9, frequency=0.9, dwell=0.1, amplitude=0.06)
    for knows, same in ((Knowledge(), True), (Knowledge(friction=True), False), (Knowledge(command=True), False)):
        plans = [mpc.plan(one, None, usual(mpc), knows) for one in (car, other)]
        assert np.array_equal(*plans) is same, knows
    for knows in (Knowledge(), ALL):
        _, asked = mpc._asked(car, None, usual(mpc), knows)
        command = asked[6 : 6 + mpc.horizon]
        assert (np.ptp(command) == 0.0) == (not knows.command)
        assert command[0] == pytest.approx(car.driver_command, abs=0.002)


def test_the_driver_is_known_as_he_will_be(made):
    env, mpc = made(STEER)
    car = begun(env, "right", steps=BEGUN[STEER])
    _, asked = mpc._asked(car, None, usual(mpc), ALL)
    done = []
    for _ in range(HOLD * mpc.horizon):
        done.append(env.state.driver_command)
        env.step(np.zeros(1, np.float32))
    expected = np.reshape(done, (-1, HOLD)).mean(axis=1)
    np.testing.assert_allclose(asked[6 : 6 + mpc.horizon], expected, atol=1e-12)
    assert np.ptp(expected) > 0.04


def test_the_displacement_is_asked_for(made):
    """Before it is judged, by the share of the straight car's that is asked for."""
    env, mpc = made(STEER)
    car = begun(env, steps=30)
    few, most = usual(mpc), usual(mpc)
    few[-1], most[-1] = 0.0, 1.3
    stage = int((1.57 - car.time) / mpc.timestep)
    there = [mpc.stages(mpc.plan(car, None, values, ALL))[0][stage, 0] for values in (few, most)]
    assert there[1] > there[0] + 0.05


def least_clearance(env, mpc, plan):
    """Along a plan, as the task judges it."""
    states, _ = mpc.stages(plan)
    judge = clearance(NUMPY, env.task)
    along = env.state.longitudinal_position
    found = []
    for state in states[:-1]:
        found.append(judge(CarState(along, *state), None, EpisodeState(0.0, 0.0, 0.0, 0.0, env.state), mpc.world))
        along += mpc.timestep * mpc._along(state)
    return min(found)


def test_the_gates_keep_the_body_out(made, monkeypatch):
    """Without them the plan, which also has to come to the other lane, goes through the obstacle."""
    env, mpc = made(EVADE)
    begun(env)
    kept = mpc.plan(env.state, None, usual(mpc), ALL)
    assert least_clearance(env, mpc, kept) > 0.0
    shape = len(mpc._forward), mpc.horizon + 1
    monkeypatch.setattr(mpc, "_corridor", lambda *_: (np.full(shape, -1e3), np.full(shape, 1e3)))
    free = mpc.plan(env.state, None, usual(mpc), ALL)
    assert least_clearance(env, mpc, free) < -0.5


def test_a_program_that_cannot_be_solved_is_counted(made, monkeypatch):
    env, mpc = made(EVADE)
    begun(env)
    plan = mpc.plan(env.state, None, usual(mpc), ALL)

    class Failing:
        def __call__(self, **_):
            return {"x": np.full(1, np.nan)}

        def stats(self):
            return {"success": False}

    monkeypatch.setattr(mpc._shooting, "quadratic_program", Failing())
    monkeypatch.setattr(mpc, "failures", 0)
    moved = mpc.plan(env.state, plan, usual(mpc), ALL)
    np.testing.assert_array_equal(mpc.stages(moved)[1][:-1], mpc.stages(plan)[1][1:])
    assert mpc.failures == 1


@pytest.mark.exhaustive
def test_told_everything_it_saves_what_it_else_loses():
    """Many cars, some of which end before the others: these are planned for no more."""
    cars = Cars(STEER, {"level": "hard"})
    mpc = PREDICTIVE[STEER](cars.plant)
    seeds = [(1 << 32) + k for k in range(8)]
    saved, steps = [], []
    for knows in (Knowledge(), ALL):
        mpc.plans = 0
        outcomes = drive(cars.of(8), mpc.by(cars.of(8), usual(mpc), knows), seeds)
        saved.append(np.sum(outcomes.success))
        steps.append(outcomes.steps.sum())
        most = np.sum(outcomes.steps // HOLD + 1)
        assert most - 8 <= mpc.plans <= most
    assert saved[1] == 8 > saved[0]
    assert steps[1] == 2400 > steps[0]
