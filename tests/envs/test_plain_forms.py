"""Keywords have a plain form: the JSON of a spec makes an equal environment."""

import copy
import dataclasses
import pickle
import re

import gymnasium as gym
import numpy as np
import pytest
from combinations import only_all
from gymnasium.envs.registration import EnvSpec

from bicycle_env import Actuator, disturbances, tires, vehicles
from bicycle_env.control import make as make_controller
from bicycle_env.tasks import rewards
from bicycle_env.wrappers import FrontDriver, RecordSuccess

STAB, LANE = "BicycleStab-v0", "BicycleLaneChange-v0"
KEYWORDS = [
    {},
    {"vehicle": vehicles["me303"], "tire": tires.Linear(), "front_actuator": Actuator(0.1)},
    {"tire": tires.MagicFormula(shape=1.5, curvature=-0.5), "speed": np.float32(41.5), "steer": np.str_("rear")},
    {"friction": np.array(0.5), "horizon": np.int64(200), "telemetry": True, "rear_actuator": Actuator(0.05, 0.2)},
    {"vehicle": "civic", "tire": "tanh", "speed": np.float64(25.0)},
]


def equal(one, other):
    for field in dataclasses.fields(one.configuration):
        mine, theirs = (getattr(env.configuration, field.name) for env in (one, other))
        if field.name == "task":
            mine, theirs = vars(mine), vars(theirs)
        assert mine == theirs, field.name
    return True


@pytest.mark.parametrize("keywords", KEYWORDS, ids=range(len(KEYWORDS)))
def test_the_json_of_a_spec_makes_an_equal_environment(keywords):
    env = gym.make(STAB, **keywords)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert equal(env.unwrapped, again.unwrapped)
    assert again.spec.max_episode_steps == env.spec.max_episode_steps


def test_a_spec_goes_round_twice_and_with_the_tasks_keywords():
    env = gym.make(LANE, direction="left", duration=np.float32(2.0), max_episode_steps=250)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    third = gym.make(EnvSpec.from_json(again.spec.to_json()))
    assert equal(env.unwrapped, third.unwrapped)
    assert third.spec.max_episode_steps == 250


def test_per_car_keywords_go_through_json_too():
    cars, speeds = [vehicles["oversteer"], vehicles["me303"]] * 3, [30.0, 40.0] * 3
    envs = gym.make_vec(LANE, 6, vehicle=cars, speed=np.array(speeds, np.float32), tire=tires.Tanh())
    again = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()), num_envs=6)
    assert again.unwrapped.vehicle == tuple(cars)
    assert again.unwrapped.speed.tolist() == speeds
    assert again.unwrapped.tire == tires.Tanh()


def test_dicts_and_files_are_keywords(tmp_path):
    fields = dataclasses.asdict(vehicles["me303"])
    file = tmp_path / "mine.toml"
    file.write_text("\n".join(f"{name} = {value!r}" for name, value in fields.items() if isinstance(value, float)))
    for vehicle in (fields, str(file)):
        env = gym.make(STAB, vehicle=vehicle, speed=30.0, tire={"name": "magic_formula", "shape": 1.5})
        assert env.unwrapped.vehicle.mass == vehicles["me303"].mass
        assert env.unwrapped.tire == tires.MagicFormula(shape=1.5)
    env = gym.make(STAB, rear_actuator={"angle_limit": 0.04, "rate_limit": 0.1})
    assert env.unwrapped.rear_actuator == Actuator(0.04, 0.1)
    with pytest.raises(ValueError, match=r"rear_actuator.*'angel_limit'; did you mean 'angle_limit'"):
        gym.make(STAB, rear_actuator={"angel_limit": 0.04})


@dataclasses.dataclass(frozen=True)
class Mine(tires.Tire):
    """A user's own tire."""

    def law(self, xp):
        return lambda slip_angle, cornering_stiffness, peak_force: -cornering_stiffness * slip_angle


@dataclasses.dataclass(frozen=True)
class Still(rewards.Reward):
    """A user's own reward."""

    name: str = "bounded"  # as one of the package's

    def law(self, xp):
        return lambda state, reference, action, episode, before, end, world: -abs(state.yaw_rate)


@dataclasses.dataclass(frozen=True)
class Warm(disturbances.FrictionStep):
    """A user's own disturbance."""


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [
        ("tire", Mine(), "Mine()"),
        only_all("reward", Still(), "Still(name='bounded')"),
        only_all("disturbances", (Warm(),), "(Warm("),
    ],
)
def test_json_refuses_to_lose_a_law_of_ones_own(name, value, shown):
    """It was written as its numbers, {"tire": {}}, or as another law of the same name."""
    keywords = {"tire": "linear", "geometry": "small_angle", name: value}
    for env in (gym.make(STAB, **keywords), gym.make_vec(STAB, 2, **keywords)):
        with pytest.raises(ValueError, match=re.escape(f"{name}={shown}") + ".*of one's own and has no plain form"):
            env.spec.to_json()
    alone = gym.make(STAB, **keywords)
    for spec in (alone.spec, pickle.loads(pickle.dumps(alone.spec)), copy.deepcopy(alone.spec)):
        again = gym.make(spec)
        assert again.spec == alone.spec
        assert equal(again.unwrapped, alone.unwrapped)


@pytest.mark.filterwarnings("ignore:(FrontDriver|RecordSuccess) is deprecated")
def test_wrappers_are_made_again_from_the_spec():
    env = RecordSuccess(gym.make(STAB, friction=np.float32(0.5)))
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert isinstance(again, RecordSuccess)
    assert equal(env.unwrapped, again.unwrapped)
    plant = gym.make(STAB)
    driven = gym.make(FrontDriver(plant, make_controller("preview", plant)).spec)  # an object: by the spec itself
    assert isinstance(driven, FrontDriver)
    assert driven.driver.name == "preview"
