"""Stability margins: loops whose margins are known, the LQR's guarantees, and what an estimate costs."""

import math

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env.control import LQG, LQR, ContinuousLQR, PolePlacement
from bicycle_env.control.design.estimation import Disturbance, Noise
from bicycle_env.control.design.margins import Loop, lqg_loop, margins, state_feedback_loop
from bicycle_env.control.lqr import tuned_weights

IDS = ("BicycleStab-v0", "BicycleLaneChange-v0")
STEERS = ("front", "rear", "both")


def plant(env_id="BicycleStab-v0", steer="both"):
    return gym.make(env_id, steer=steer).unwrapped


def single(numerator, roots, timestep=0.0):
    """The loop numerator / product (s - root) in controllable form."""
    polynomial = np.real(np.poly(roots))
    n = len(roots)
    A = np.vstack([-polynomial[1:], np.eye(n)[:-1]])
    B, C = np.eye(n)[:, :1], np.zeros((1, n))
    C[0, n - len(numerator) :] = numerator
    return Loop(A, B, C, timestep, ("u",))


def test_margins_of_a_third_order_loop_by_hand():
    """L = 4 / (s + 1)^3 meets the negative real axis at w = sqrt 3, where |L| = 1/2, and has |L| = 1 at
    w = sqrt(4^(2/3) - 1)."""
    found = margins(single([4.0], [-1.0, -1.0, -1.0]))["u"]
    assert found.gain_increase == pytest.approx(2.0, rel=1e-6)
    assert found.gain_decrease == 0.0
    crossover = math.sqrt(4.0 ** (2.0 / 3.0) - 1.0)
    assert found.phase == pytest.approx(math.pi - 3.0 * math.atan(crossover), rel=1e-6)
    # Any disk margin is at most what gain and phase alone allow.
    assert found.disk <= 2.0 * (found.gain_increase - 1.0) / (found.gain_increase + 1.0)
    assert found.disk <= 2.0 * math.tan(found.phase / 2.0)
    assert found.disk > 0.3


def test_margins_of_an_unstable_plant_by_hand():
    """L = 2 / (s - 1): stable from gain 1/2 on, |L| = 1 at sqrt 3 with -120 deg; S - T = (s - 3)/(s + 1), disk 2/3."""
    found = margins(single([2.0], [1.0]))["u"]
    assert found.gain_decrease == pytest.approx(0.5, rel=1e-6)
    assert math.isinf(found.gain_increase)
    assert found.phase == pytest.approx(math.pi / 3.0, rel=1e-6)
    assert found.disk == pytest.approx(2.0 / 3.0, rel=1e-6)


def test_margins_in_discrete_time_by_hand():
    """L = 0.5 / (z - 1): poles of 1 - 0.5 g reach -1 at g = 4; |L| = 1 where 2 sin(w/2) = 1/2."""
    found = margins(single([0.5], [1.0], timestep=0.02))["u"]
    assert found.gain_increase == pytest.approx(4.0, rel=1e-6)
    w = 2.0 * math.asin(0.25)
    assert found.phase == pytest.approx(math.pi - (math.pi / 2.0 + w / 2.0), rel=1e-6)


def test_an_unstable_loop_has_none():
    with pytest.raises(ValueError, match="stable"):
        margins(single([0.5], [1.0]))


@pytest.mark.parametrize("steer", STEERS)
@pytest.mark.parametrize("env_id", IDS)
def test_the_guarantees_of_the_lqr(env_id, steer):
    """Continuous, diagonal R: gain from 1/2 to infinity and 60 deg at every input; (I + L)* R (I + L) >= R."""
    policy = ContinuousLQR(plant(env_id, steer))
    loop = state_feedback_loop(policy.model, policy.gain)
    for found in margins(loop).values():
        assert found.gain_decrease <= 0.5
        assert math.isinf(found.gain_increase)
        assert found.phase >= math.radians(60.0)
    axles = len(policy.gain)
    R = tuned_weights(policy_task(env_id)).matrices(1.0, policy.model.input_names)[1]
    response = loop.frequency_response(np.geomspace(1e-2, 1e3, 200))
    difference = np.eye(axles) + response
    surplus = difference.conj().transpose(0, 2, 1) @ R @ difference - R
    assert np.min(np.linalg.eigvalsh(surplus)) > -1e-9 * np.max(np.abs(surplus))


def policy_task(env_id):
    return {"BicycleStab-v0": "stabilise", "BicycleLaneChange-v0": "lane_change"}[env_id]


@pytest.mark.parametrize("steer", STEERS)
def test_sampling_costs_some_of_it(steer):
    car = plant(steer=steer)
    sampled, ideal = (
        margins(state_feedback_loop(policy.model, policy.gain)) for policy in (LQR(car), ContinuousLQR(car))
    )
    for name, found in sampled.items():
        assert found.gain_increase < 100.0
        assert found.phase <= ideal[name].phase


def test_the_margins_are_where_the_closed_loop_turns_unstable():
    policy = PolePlacement(plant())
    model = policy.model
    found = margins(state_feedback_loop(model, policy.gain))
    for i, name in enumerate(model.input_names):
        for factor in (found[name].gain_decrease, found[name].gain_increase):
            for moved, stable in ((1.0 + 1e-3, factor < 1.0), (1.0 - 1e-3, factor > 1.0)):
                factors = np.ones(2)
                factors[i] = factor * moved
                radius = np.max(np.abs(np.linalg.eigvals(model.A - model.B * factors @ policy.gain)))
                assert factor == 0.0 or (radius < 1.0) == stable


def test_an_estimate_has_no_guarantees():
    """J. C. Doyle, IEEE Trans. Autom. Control 23, 1978. A filter that is slow to believe its sensors: with it the loop
    does not bear half the gain, as every LQR does in continuous time and this one even when it is sampled."""
    car = plant()
    slow = LQG(car, noise=Noise(0.5, 5.0), disturbance=Disturbance(1.0, 0.01))
    ideal = margins(state_feedback_loop(slow.model, slow.gain))
    found = margins(lqg_loop(slow.model, slow.gain, slow.filter))
    for name in ideal:
        assert found[name].disk < 0.5 * ideal[name].disk
    assert ideal["front_steer_command"].gain_decrease < 0.5
    assert found["front_steer_command"].gain_decrease > 0.5


@pytest.mark.parametrize("steer", STEERS)
def test_the_default_filter_costs_little(steer):
    policy = LQG(plant(steer=steer))
    ideal = margins(state_feedback_loop(policy.model, policy.gain))
    for name, found in margins(lqg_loop(policy.model, policy.gain, policy.filter)).items():
        assert 0.95 * ideal[name].disk < found.disk < 1.01 * ideal[name].disk


def test_the_loop_of_lqg_closes_to_the_union_of_both_spectra():
    """The separation principle: regulator poles and the filter's own, nothing else."""
    for steer in STEERS:
        policy = LQG(plant(steer=steer))
        model, known = policy.model, policy.filter
        loop = lqg_loop(model, policy.gain, known)
        closed = np.linalg.eigvals(loop.A - loop.B @ loop.C)
        union = np.concatenate(
            [
                np.linalg.eigvals(model.A - model.B @ policy.gain),
                np.linalg.eigvals(known.A - known.predictor_gain @ known.C),
            ]
        )
        np.testing.assert_allclose(np.sort_complex(closed), np.sort_complex(union), rtol=1e-6, atol=1e-8)


def test_the_frequency_response_is_the_transfer_function():
    loop = single([3.0, 1.0], [-1.0, -2.0, -0.5])
    frequency = np.array([0.1, 1.0, 7.0])
    s = 1j * frequency
    np.testing.assert_allclose(
        loop.frequency_response(frequency)[:, 0, 0], (3.0 * s + 1.0) / ((s + 1.0) * (s + 2.0) * (s + 0.5)), rtol=1e-12
    )
