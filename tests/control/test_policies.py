"""The one interface of all policies: by name, on every task, for every steer mode, one observation or many."""

import sys

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all, some_of

from bicycle_env import control
from bicycle_env.control.design.estimation import Noise
from bicycle_env.registration import ENVIRONMENTS

IDS, ACTIVE, EVADE = [row.id for row in ENVIRONMENTS], "BicycleActiveSteer-v0", "BicycleEvade-v0"
HOMES = {"evade-path": EVADE, **dict.fromkeys(control.REAR_STEERINGS, ACTIVE)}
"""Where those drive that are of one id alone."""
STEERS = ("front", "rear", "both")
ODD = [name for name in control.NAMES if name != "zero"]


def env_for(name):
    return gym.make(HOMES.get(name, "BicycleStab-v0"))


def cannot_drive(name, steer, env_id):
    """A driver sits at the front wheels; a rear-steer law needs both axles, and an id where nobody drives already."""
    if name in HOMES:
        return env_id != HOMES[name] or (env_id == ACTIVE and steer == "front")
    if env_id == ACTIVE:
        return name not in ("zero", "network")
    return ("+" in name and steer != "both") or (name in control.DRIVERS and steer == "rear")


SOON = ("zero", "lqr", "pole-placement", "preview+sano")
"""Policies that `make test` drives with every steer mode; the others with both axles or the front one, on one task."""
CASES = [
    (env_id, name, steer)
    for env_id in IDS
    for name in (*control.NAMES, "network")
    for steer in STEERS
    if not cannot_drive(name, steer, env_id)
]
DRIVES = [
    row
    if row[1] in (*SOON, "evade-path") or row[0] == ACTIVE or (row[0] == IDS[k % 2] and row[2] != "rear")
    else only_all(*row)
    for k, name in enumerate(control.NAMES)
    for row in ((env_id, name, steer) for env_id in IDS for steer in STEERS if not cannot_drive(name, steer, env_id))
]


AT_ONCE = [
    *(row for row in DRIVES if isinstance(row, tuple) and isinstance(row[0], str)),
    *(row for row in CASES if row[1] == "network" and row[0] in IDS[:2]),
]


def network(env, axles):
    rng = np.random.default_rng(0)
    names, mirror = list(env.observation_names), env.observation_mirror.astype(int).tolist()
    width = 2 * len(names)
    layers = [
        ((0.1 * rng.normal(size=(16, width))).astype(np.float32), rng.normal(size=16).astype(np.float32)),
        ((0.1 * rng.normal(size=(axles, 16))).astype(np.float32), np.zeros(axles, np.float32)),
    ]
    acts = {"hold": 2, "history": 2, "mirror": mirror}
    return control.Network(layers, "tanh", "clip", {"env_id": "x", "observation_names": names, **acts})


def policy_of(name, env):
    return network(env, env.action_space.shape[0]) if name == "network" else control.make(name, env)


@pytest.mark.parametrize(("env_id", "name", "steer"), some_of(CASES, AT_ONCE))
def test_one_observation_and_many(name, steer, env_id):
    env = gym.make(env_id, steer=steer).unwrapped
    policy = policy_of(name, env)
    axles = env.action_space.shape[0]
    rng = np.random.default_rng(2)
    bound = env.observation_space.high
    many = (rng.uniform(-0.01, 0.01, (8, len(bound))) * bound).astype(np.float32)
    many[0] = 0.0
    many[1:4] = [bound, -bound, bound * rng.uniform(-1, 1, len(bound))]
    if name == "mpc":  # it takes its time beyond all limits
        many = many[[0, 3, 4]]
    given = many.copy()
    policy.reset()
    actions = policy.act(many)
    assert np.array_equal(many, given)
    assert actions.shape == (len(many), axles)
    assert actions.dtype == np.float32
    assert np.all(np.abs(actions) <= 1.0)
    for observation, expected in zip(many, actions, strict=True):
        policy.reset()
        action = policy.act(observation)
        assert action.shape == (axles,)
        assert action.dtype == np.float32
        assert env.action_space.contains(action)
        np.testing.assert_allclose(action, expected, rtol=1e-5, atol=1e-6)
        policy.reset()
        assert np.array_equal(action, policy.act(observation)), "after reset() nothing is remembered"
    policy.reset()
    assert policy.act(many[:0]).shape == (0, axles)


class Unrounded:
    """numpy for a controller, which then gives its actions in double precision: no last bit is rounded away."""

    float32 = np.float64

    def __getattr__(self, name):
        return getattr(np, name)


AT_HOME = [
    (env_id, name, steer)
    for env_id, name, steer in CASES
    if env_id == HOMES.get(name, "BicycleLaneChange-v0") and name not in ("mpc", "network") and steer != "rear"
]


@pytest.mark.parametrize(("env_id", "name", "steer"), AT_HOME)
def test_each_of_many_cars_is_driven_as_if_alone(env_id, name, steer, monkeypatch):
    for module in [module for key, module in sys.modules.items() if key.startswith("bicycle_env.control.")]:
        if hasattr(module, "np"):
            monkeypatch.setattr(module, "np", Unrounded())
    env = gym.make(env_id, steer=steer).unwrapped
    policy = control.make(name, env)
    assert control.alone_among_many(policy)
    seen = 0.1 * np.random.default_rng(0).uniform(-1.0, 1.0, (3, 19, len(env.observation_names))).astype(np.float32)
    many = np.array([policy.act(now) for now in seen])
    for car in range(seen.shape[1]):
        policy.reset()
        alone = np.array([policy.act(now[car]) for now in seen])
        assert alone.dtype == np.float64
        np.testing.assert_array_equal(alone, many[:, car])


def test_of_which_policies_that_is_known():
    env = gym.make("BicycleStab-v0").unwrapped
    mine = type("Mine", (control.LQR,), {})(env)
    noisy = control.LQG(env, sensor_noise=Noise())
    assert control.alone_among_many(network(env, 2))
    for policy in (
        mine,
        noisy,
        control.make("mpc", env),
        control.DriverAndLaw(Mine(env), control.REAR_LAWS["sano"](env)),
    ):
        assert not control.alone_among_many(policy)


class Mine(control.DRIVERS["stanley"]):
    """A driver of one's own."""


@pytest.mark.parametrize(("env_id", "name", "steer"), [*DRIVES, (IDS[0], "network", "both")])
def test_the_mirror_image_is_steered_the_other_way(name, steer, env_id):
    """Over some steps, memory included; small angles, where nothing is clipped."""
    env = gym.make(env_id, steer=steer).unwrapped
    left, right = policy_of(name, env), policy_of(name, env)
    rng = np.random.default_rng(3)
    moved = False
    for _ in range(15):
        observation = (0.02 * rng.uniform(-1.0, 1.0, len(env.observation_names))).astype(np.float32)
        action = left.act(observation)
        mirrored = right.act(observation * env.observation_mirror.astype(np.float32))
        if name == "mpc":  # an interior-point method does not round symmetrically
            np.testing.assert_allclose(mirrored, -action, atol=1e-4)
        else:
            np.testing.assert_array_equal(mirrored, -action)
        moved = moved or bool(np.any(action != 0.0))
    assert moved == (name != "zero")


@pytest.mark.parametrize(("env_id", "name", "steer"), DRIVES)
def test_every_policy_drives(name, steer, env_id):
    """A slow car that is stable by itself: nobody throws it off the road."""
    env = gym.make(env_id, steer=steer, vehicle="oversteer", speed_ratio=0.5, horizon=None).unwrapped
    policy = control.make(name, env)
    assert policy.name == name
    observation, _ = env.reset(seed=3, options={"state": {"lateral_position": 0.2, "heading": 0.005}})
    for _ in range(40):
        observation, _, terminated, _, _ = env.step(policy.act(observation))
        assert not terminated


@pytest.mark.parametrize("name", [name for name in ODD if name not in control.DRIVERS])
def test_who_knows_its_model(name):
    policy = control.make(name, env_for(name))
    assert policy.model.A.shape == (6, 6)
    assert policy.model.state_names[2] == "lateral_velocity"


def test_zero_steers_nothing():
    env = gym.make("BicycleStab-v0").unwrapped
    policy = control.make("zero", env)
    assert not np.any(policy.act(np.ones((7, 8), np.float32)))
    first = policy.act(np.ones(8, np.float32))
    first[:] = 1.0
    assert not np.any(policy.act(np.ones(8, np.float32)))


# Names


def test_names_are_those_of_the_classes():
    for name, cls in control.POLICIES.items():
        env = env_for(name)
        assert cls.name == name
        assert isinstance(control.make(name, env), cls)
        assert isinstance(control.make(name, env.unwrapped), cls), "wrapped or not"
    combined = control.make("preview+sano", gym.make("BicycleStab-v0"))
    assert isinstance(combined, control.DriverAndLaw)
    assert (combined.driver.name, combined.law.name) == ("preview", "sano")
    assert set(control.NAMES) - set(control.POLICIES) == {
        f"{driver}+{law}" for driver in control.DRIVERS for law in control.REAR_LAWS
    }


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("lqe", "lqr"), ("poleplacement", "pole-placement"), ("preview+sanno", r"preview\+sano")],
)
def test_an_unknown_name_is_answered_with_the_nearest(name, nearest):
    with pytest.raises(ValueError, match=f"policy must be one of 'zero', 'lqr', .*; did you mean '{nearest}'"):
        control.make(name, gym.make("BicycleStab-v0"))


def test_a_law_alone_needs_a_driver():
    for law in control.REAR_LAWS:
        with pytest.raises(ValueError, match=rf"'{law}' steers the rear wheels only.*'preview\+{law}'"):
            control.make(law, gym.make("BicycleStab-v0"))


def test_a_name_is_a_word():
    with pytest.raises(TypeError, match="policy"):
        control.make(None, gym.make("BicycleStab-v0"))


def test_every_policy_has_a_line_about_it():
    rows = control.descriptions()
    assert set(rows) == {*control.POLICIES, *(f"DRIVER+{law}" for law in control.REAR_LAWS)}
    for text in rows.values():
        assert text.endswith(".")
        assert 20 < len(text) <= 120
        assert "``" not in text
    assert len(set(rows.values())) == len(rows)


def test_an_environment_of_another_package_is_refused():
    for env in (gym.make("CartPole-v1"), 3):
        with pytest.raises(TypeError, match="env must be an environment of this package, got"):
            control.make("lqr", env)
