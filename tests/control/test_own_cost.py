"""A task for which no weights were tuned: the controllers have its own quadratic cost, and say so."""

import gymnasium as gym
import numpy as np
import pytest
import scipy.linalg

from bicycle_env import control
from bicycle_env.control import lqr

WORDS = "no weights were tuned for the task 'stabilise': the controller has the task's own quadratic cost"


@pytest.fixture
def plant(monkeypatch):
    monkeypatch.setattr(lqr, "_tuned", dict)
    return gym.make("BicycleStab-v0").unwrapped


def test_lqr_is_optimal_for_the_tasks_own_cost(plant):
    with pytest.warns(UserWarning, match=WORDS):
        policy = control.make("lqr", plant)
    A, B, Q, R, *_ = plant.linear_model()
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    expected = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(policy.gain, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["lqr-continuous", "scheduled-lqr", "lqg", "mpc"])
def test_the_others_too(plant, name):
    if name == "mpc":
        pytest.importorskip("casadi")
    with pytest.warns(UserWarning, match=WORDS):
        policy = control.make(name, plant)
    assert np.all(np.isfinite(policy.act(np.zeros(len(plant.observation_names), np.float32))))


def test_weights_that_are_given_need_none_tuned(plant):
    control.LQR(plant, control.Weights(1.0, 1.0, 1.0, 1.0, 1.0, 1.0))


def test_asking_for_tuned_weights_by_a_wrong_name():
    with pytest.raises(ValueError, match=r"task with tuned weights must be one of .*did you mean 'stabilise'"):
        control.tuned_weights("stabilize")
