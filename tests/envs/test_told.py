"""What an environment is made of can be read and not set: an assignment would do nothing."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env.envs import TorchVectorEnv
from bicycle_env.wrappers import SB3VecEnv

STAB = "BicycleStab-v0"
NAMES = (
    *("task", "vehicle", "tire", "speed", "steer", "friction", "geometry", "reward", "horizon", "front_actuator"),
    *("model", "relaxation_length", "level", "action_repeat"),
    *("rear_actuator", "control_timestep", "physics_timestep", "substeps", "rules", "observation_entries"),
    *("observation_names", "observation_scale", "observation_mirror", "telemetry", "configuration", "state"),
)
OF_MANY = (*NAMES, "fleet", "max_episode_steps", "staggered_start", "on_invalid", "end_names", "dtype")
CASES = {
    "single": (lambda: gym.make(STAB).unwrapped, NAMES),
    "native": (lambda: gym.make_vec(STAB, 8).unwrapped, (*OF_MANY, "threads")),
    "torch": (lambda: TorchVectorEnv(STAB, 3), OF_MANY),
}


@pytest.mark.parametrize("kind", CASES)
def test_public_attributes_cannot_be_set_or_deleted(kind):
    make, names = CASES[kind]
    env = make()
    env.reset(seed=0)
    for name in names:
        before = getattr(env, name)
        with pytest.raises(AttributeError, match=rf"{name} cannot be set: .*gym\.make.*reset\(options="):
            setattr(env, name, 20)
        assert name == "state" or getattr(env, name) is before
    with pytest.raises(AttributeError, match="speed cannot be set"):
        del env.speed


@pytest.mark.parametrize("kind", CASES)
def test_every_field_of_the_configuration_is_told(kind):
    make, names = CASES[kind]
    env = make()
    assert set(vars(env.configuration)) <= set(names)


def test_what_is_gymnasiums_and_what_is_the_users_can_be_set():
    env = gym.make(STAB).unwrapped
    for name in ("metadata", "render_mode", "action_space", "observation_space", "spec", "mine"):
        setattr(env, name, None)
        assert getattr(env, name) is None


@pytest.mark.parametrize(
    "keywords",
    [
        {},
        {
            "speed": np.linspace(30.0, 40.0, 6),
            "friction": np.linspace(0.5, 0.7, 6),
            "tire": "magic_formula",
            "reward": "quadratic",
        },
    ],
)
def test_arrays_refuse_to_be_written_to(keywords):
    env = gym.make_vec(STAB, 6, **keywords).unwrapped
    arrays = [env.observation_scale, env.observation_mirror, env.speed, env.friction, *env.fleet.car]
    for array in arrays:
        if isinstance(array, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 0.0


def test_copies_and_pickles_tell_the_same():
    for make, names in CASES.values():
        env = make()
        for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
            assert (other.speed, other.friction, other.observation_names) == (
                env.speed,
                env.friction,
                env.observation_names,
            )
            with pytest.raises(AttributeError, match="cannot be set"):
                setattr(other, names[3], 20)


def test_vector_environments_of_others_hand_the_refusal_on():
    sync = gym.make_vec(STAB, 2, "sync", vector_kwargs={"autoreset_mode": "SameStep"})
    for setter in (lambda: sync.set_attr("friction", [0.5, 0.5]), lambda: SB3VecEnv(sync).set_attr("speed", 20.0)):
        with pytest.raises(AttributeError, match="cannot be set"):
            setter()
    native = SB3VecEnv(gym.make_vec(STAB, 2, autoreset_mode="SameStep"))
    with pytest.raises(AttributeError, match=r"keyword to gym\.make_vec"):
        native.set_attr("friction", 0.5)
