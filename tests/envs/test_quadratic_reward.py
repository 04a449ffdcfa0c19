"""reward="quadratic": a failure pays for the rest of the horizon, so that ending early never pays."""

import gymnasium as gym
import numpy as np
import pytest
from combinations import ON_ROADS

from bicycle_env.control import make

IDS = list(ON_ROADS)


def worst(env):
    """By hand: the largest stage cost of a running episode."""
    limits, costs = env.task.limits, env.configuration.costs
    half_body = 0.5 * env.vehicle.body_width
    return (
        costs.lateral_cost * (2.0 * env.task.road_half_width + half_body) ** 2
        + costs.heading_cost * (2.0 * limits.heading) ** 2
        + costs.lateral_velocity_cost * (limits.sideslip * env.speed) ** 2
        + costs.yaw_rate_cost * limits.yaw_rate**2
        + costs.front_steer_cost * env.front_actuator.angle_limit**2
        + costs.rear_steer_cost * env.rear_actuator.angle_limit**2
        + costs.front_command_cost
        + costs.rear_command_cost
    )


def episode(env, plant, seed, act):
    """(return, steps, end) and the sum of the running costs computed here, from the telemetry and the state."""
    observation, info = env.reset(seed=seed)
    costs = plant.configuration.costs
    total, running, steps, over = 0.0, 0.0, 0, False
    while not over:
        state = plant.state
        action = np.clip(act(observation), -1.0, 1.0)
        running += (
            costs.lateral_cost * info["lateral_error"] ** 2
            + costs.heading_cost * info["heading_error"] ** 2
            + costs.yaw_rate_cost * state.yaw_rate**2
            + costs.front_command_cost * float(action[0]) ** 2
            + costs.rear_command_cost * float(action[1]) ** 2
        )
        observation, reward, terminated, truncated, info = env.step(action)
        total += reward
        steps += 1
        over = terminated or truncated
    return total, running, steps, info["end"]


@pytest.mark.parametrize("env_id", IDS)
def test_an_episode_that_ends_early_returns_less_than_any_that_survives(env_id):
    horizon = 120
    env = gym.make(env_id, reward="quadratic", horizon=horizon, telemetry=True, max_episode_steps=horizon)
    plant = env.unwrapped
    lqr = make("lqr", plant)
    rng = np.random.default_rng(4)
    survivors, failures = 0, 0
    for seed in range(7):
        survived, failed = [], []
        for attempt in range(12):
            noise = rng.uniform(0.0, 1.5) * (attempt > 0)
            share = rng.uniform(0.0, 1.2) if attempt else 1.0
            drift = rng.uniform(-0.5, 0.5, 2) * (attempt > 0)
            total, running, steps, end = episode(
                env,
                plant,
                seed,
                lambda o, n=noise, s=share, d=drift: s * lqr.act(o) + d + n * rng.uniform(-1.0, 1.0, 2),
            )
            if end:
                assert total == pytest.approx(-running - (horizon - steps) * worst(plant), rel=1e-12)
                if steps < horizon:  # at the last step there is nothing left to pay for: that is no early end
                    failed.append(total)
            else:
                assert steps == horizon
                assert total == pytest.approx(-running, rel=1e-12)
                survived.append(total)
        survivors += len(survived)
        failures += len(failed)
        if survived and failed:
            assert max(failed) < min(survived)
    assert survivors > 10
    assert failures > 10


@pytest.mark.parametrize("env_id", IDS)
def test_whoever_is_about_to_fail_does_better_to_survive(env_id):
    """Strictly: of two episodes with the same first steps, the one that then ends early returns less."""
    horizon = 120
    env = gym.make(env_id, reward="quadratic", horizon=horizon).unwrapped
    lqr = make("lqr", env)
    rng = np.random.default_rng(14)
    compared = 0
    for seed in range(24):
        observation, _ = env.reset(seed=seed)
        share, drift = rng.uniform(0.0, 1.2), rng.uniform(-0.6, 0.6, 2)
        past, end = [], False
        while not end and len(past) < horizon - 1:
            past.append((env.snapshot(), observation))
            action = share * lqr.act(observation) + drift + rng.uniform(-1.0, 1.0, 2)
            observation, reward, end, _, _ = env.step(action)
            past[-1] += (reward,)
        if not end:
            continue
        rewards = [reward for _, _, reward in past]
        for k in range(0, len(past), 2):
            env.restore(past[k][0])
            observation, saved, alive = past[k][1], 0.0, True
            for _ in range(horizon - k):
                observation, reward, terminated, _, _ = env.step(lqr.act(observation))
                saved += reward
                alive = not terminated
                if terminated:
                    break
            if alive:
                assert sum(rewards[k:]) < saved
                compared += 1
    assert compared > 30


@pytest.mark.parametrize("env_id", IDS)
def test_no_running_step_costs_more_than_the_worst(env_id):
    env = gym.make(env_id, reward="quadratic").unwrapped
    limit = worst(env)
    rng = np.random.default_rng(5)
    largest = 0.0
    for _ in range(300):
        side = rng.choice([-1.0, 1.0], 4)
        y = side[0] * rng.uniform(1.0, 6.0)
        state = {"lateral_position": y, "heading": side[1] * 1.19, "yaw_rate": side[2] * 1.99}
        env.reset(options={"state": state})
        first = env.step(rng.choice([-1.0, 1.0], 2))
        if not first[2]:  # the state before the next step is one of a running episode
            second = env.step(rng.choice([-1.0, 1.0], 2))
            if not second[2]:
                assert -second[1] <= limit
                largest = max(largest, -second[1])
    assert largest > 0.15 * limit


def test_the_horizon_decides_what_a_failure_costs():
    rewards = {}
    for horizon in (1, 2, 3, 400):
        env = gym.make("BicycleStab-v0", reward="quadratic", horizon=horizon).unwrapped
        env.reset(options={"state": {"yaw_rate": 2.5}})
        _, rewards[horizon], terminated, _, _ = env.step(np.zeros(2))
        assert terminated
    env = gym.make("BicycleStab-v0").unwrapped
    running = -env.configuration.costs.yaw_rate_cost * 2.5**2
    assert rewards[1] == pytest.approx(running, rel=1e-14)
    assert rewards[2] == pytest.approx(running - worst(env), rel=1e-14)
    assert rewards[3] == pytest.approx(running - 2 * worst(env), rel=1e-14)
    assert rewards[400] == pytest.approx(running - 399 * worst(env), rel=1e-14)
    # A failure after the horizon pays nothing more.
    env = gym.make("BicycleStab-v0", reward="quadratic", horizon=1).unwrapped
    env.reset(options={"state": {"yaw_rate": 1.9, "lateral_velocity": -8.0}})
    while not (result := env.step(np.array([1.0, -1.0])))[2]:
        pass
    assert result[1] > -worst(env)


@pytest.mark.parametrize("env_id", IDS)
def test_the_default_reward_by_hand(env_id):
    env = gym.make(env_id, telemetry=True)
    plant, weights = env.unwrapped, env.unwrapped.reward
    rng = np.random.default_rng(6)
    env.reset(seed=1)
    last = np.zeros(2)
    checked = 0
    for _ in range(60):
        action = rng.uniform(-1.3, 1.3, 2)
        _, reward, terminated, _, info = env.step(action)
        action = np.clip(action, -1.0, 1.0)
        c = (
            weights.lateral_weight * info["lateral_error"] ** 2
            + weights.heading_weight * info["heading_error"] ** 2
            + weights.sideslip_weight * info["sideslip"] ** 2
            + weights.yaw_rate_weight * plant.state.yaw_rate**2
            + weights.effort_weight * float(action @ action)
            + weights.smoothness_weight * float((action - last) @ (action - last))
        )
        assert reward == pytest.approx(1.0 / (1.0 + c), rel=1e-12)
        assert 0.0 < reward <= 1.0
        last = action
        checked += 1
        if terminated:
            break
    assert checked > 20


@pytest.mark.parametrize("env_id", IDS)
def test_a_perfect_step_is_worth_one(env_id):
    env = gym.make(env_id, **({"change_start": 50.0} if env_id == "BicycleLaneChange-v0" else {}))
    env.reset(options={"state": {}})
    assert env.step(np.zeros(2, np.float32))[1] == 1.0
