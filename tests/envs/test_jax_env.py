"""JaxEnv: the single environment's laws as pure functions; jit, vmap and grad go through them."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils import seeding

import bicycle_env  # noqa: F401
from bicycle_env.envs import JaxEnv
from bicycle_env.registration import ENVIRONMENTS
from bicycle_env.tasks.ends import INVALID_ACTION

jax = pytest.importorskip("jax")

STAB = "BicycleStab-v0"
KEY = 7
CASES = [
    (STAB, {"tire": "linear"}),
    *(
        pytest.param(row.id, {"level": level}, marks=pytest.mark.exhaustive)
        for row in ENVIRONMENTS
        for level in ("medium", "hard")
    ),
    pytest.param(STAB, {"relaxation_length": 0.4, "action_repeat": 3}, marks=pytest.mark.exhaustive),
    pytest.param(STAB, {"reward": "quadratic", "tire": "magic_formula"}, marks=pytest.mark.exhaustive),
]


@pytest.fixture(autouse=True)
def _wide():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.fixture(scope="module")
def stab():
    jax.config.update("jax_enable_x64", True)
    return JaxEnv(STAB, dtype="float64")


@pytest.mark.parametrize(("env_id", "keywords"), CASES)
def test_it_is_the_single_environment(env_id, keywords):
    env, one = JaxEnv(env_id, dtype="float64", **keywords), gym.make(env_id, **keywords)
    observation, _ = one.reset(seed=3)
    uniforms = seeding.np_random(3)[0].random(env.task.uniforms)
    mine, state = env.start(uniforms)
    np.testing.assert_allclose(mine, observation, rtol=0.0, atol=1e-7)
    random, ended = np.random.default_rng(0), 0
    for _ in range(80):
        action = random.uniform(-0.3, 0.3, env.num_actions).astype(np.float32)
        observation, reward, terminated, truncated, info = one.step(action)
        mine, state, gained, over, timed_out, told = env.step(jax.random.key(KEY), state, action)
        np.testing.assert_allclose(told["final_observation"], observation, rtol=0.0, atol=1e-7)
        assert float(gained) == pytest.approx(reward, rel=1e-12, abs=1e-12)
        assert (bool(over), bool(timed_out)) == (terminated, truncated)
        assert one.unwrapped.end == (env.configuration.end_names[int(told["end"])] if terminated else "")
        assert bool(told["is_success"]) == info["is_success"]
        if terminated:
            ended += 1
            break
        np.testing.assert_allclose(state.state.yaw_rate, one.unwrapped.state.yaw_rate, rtol=1e-10, atol=1e-13)
    assert ended or float(state.episode.steps) == 80.0


@pytest.mark.exhaustive
def test_an_episode_that_is_over_begins_anew(stab):
    observation, state = stab.reset(jax.random.key(0))
    again, fresh = stab.reset(jax.random.key(KEY))
    found = stab.step(jax.random.key(KEY), state, np.full(2, np.nan))
    np.testing.assert_array_equal(found[0], again)
    np.testing.assert_array_equal(found[5]["final_observation"], observation)
    assert int(found[5]["end"]) == INVALID_ACTION
    assert (bool(found[3]), bool(found[4])) == (True, False)
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(a == b), found[1], fresh))
    limited = stab.default_params._replace(max_steps=1.0)
    found = stab.step(jax.random.key(KEY), state, np.zeros(2), limited)
    assert (bool(found[3]), bool(found[4])) == (False, True)
    np.testing.assert_array_equal(found[0], again)


@pytest.mark.exhaustive
def test_many_are_each_for_itself_also_in_what_they_are_made_of(stab):
    keys = jax.random.split(jax.random.key(1), 5)
    _, states = jax.vmap(stab.reset)(keys)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 2))
    car = stab.default_params.car
    grip = np.linspace(0.5, 1.0, 5)
    cars = car._replace(front_peak_force=grip * car.front_peak_force, rear_peak_force=grip * car.rear_peak_force)
    params = stab.default_params._replace(car=cars)
    axes = stab.default_params._replace(
        car=jax.tree.map(lambda _: None, car)._replace(front_peak_force=0, rear_peak_force=0),
        settings=None,
        max_steps=None,
    )
    many = jax.vmap(stab.step, in_axes=(0, 0, 0, axes))(keys, states, actions, params)
    for k in range(5):
        mine = params._replace(
            car=cars._replace(front_peak_force=cars.front_peak_force[k], rear_peak_force=cars.rear_peak_force[k])
        )
        one = stab.step(keys[k], jax.tree.map(lambda column, k=k: column[k], states), actions[k], mine)
        np.testing.assert_allclose(many[0][k], one[0], atol=1e-7)
        np.testing.assert_allclose(many[2][k], one[2], rtol=1e-12)
    assert len(np.unique(many[1].state.yaw_rate)) == 5


@pytest.mark.exhaustive
def test_gradients_are_the_slopes(stab):
    _, state = stab.reset(jax.random.key(2))

    def reward(action):
        return stab.step(jax.random.key(0), state, action)[2]

    action, step = np.array([0.2, -0.1]), 1e-5
    slopes = [(reward(action + step * e) - reward(action - step * e)) / (2.0 * step) for e in np.eye(2)]
    np.testing.assert_allclose(jax.grad(reward)(action), slopes, rtol=1e-6, atol=1e-11)
    assert np.all(np.abs(slopes) > 1e-7)


@pytest.mark.exhaustive
def test_64_bits_where_jax_has_them_not_are_refused():
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(ValueError, match=r"dtype 'float64' needs jax.config.update\(\"jax_enable_x64\", True\)"):
        JaxEnv(STAB, dtype="float64")
    with pytest.raises(ValueError, match="counts in 64 bits, noise for example, and needs"):
        JaxEnv("BicycleActiveSteer-v0", level="hard")
    env = JaxEnv(STAB)
    observation, state = env.reset(jax.random.key(0))
    assert (observation.dtype, state.state.yaw_rate.dtype) == (np.float32, np.float32)


@pytest.mark.parametrize(
    ("keywords", "error", "text"),
    [
        ({"dtype": "float16"}, ValueError, "dtype must be one of 'float64', 'float32'"),
        ({"friction": [0.5, 1.0]}, (TypeError, ValueError), "friction|one car"),
        ({"frictoin": 0.5}, TypeError, "frictoin"),
        ({"max_episode_steps": 0}, ValueError, "max_episode_steps"),
    ],
)
def test_bad_keywords_are_refused(keywords, error, text):
    with pytest.raises(error, match=text):
        JaxEnv(STAB, **keywords)
