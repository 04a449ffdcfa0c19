"""A task of one's own, registered from a script: known everywhere, in other processes, too."""

import dataclasses
import inspect
import json
import re
import subprocess
import sys
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec, load_env_creator

import bicycle_env
from bicycle_env import control
from bicycle_env.envs import BicycleStabEnv, TorchVectorEnv, setup
from bicycle_env.envs.bicycle_stab import BicycleStabVectorEnv
from bicycle_env.envs.many.vector_env import SingleTrackVectorEnv
from bicycle_env.envs.single.single_track_env import SingleTrackEnv
from bicycle_env.envs.telemetry import check_metrics
from bicycle_env.registration import ENVIRONMENTS
from bicycle_env.tasks import SHARED, LaneChange, Metric
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

ID = "Mine/Narrow-v0"
STAB = "BicycleStab-v0"
LINEAR = {"tire": "linear", "geometry": "small_angle"}
SHORT = {**LINEAR, "max_episode_steps": 60}
QUICK = {"tire": "linear", "width": 0.8}


@dataclasses.dataclass(frozen=True)
class Narrow(Stabilise):
    """The lane of BicycleStab-v0, as narrow as one likes."""

    width: float = 1.0

    name = "narrow"
    episode_steps = 120
    ends: ClassVar = ("spun", "left_lane", "turned")

    @property
    def road_half_width(self):
        return 0.5 * self.width

    def end(self, xp):
        usual = xp.function(super().end(xp))
        width = self.width

        def end(state, reference, episode, world):
            return xp.where(abs(state.heading) > 0.1 * width, 4, usual(state, reference, episode, world))

        return end


@pytest.fixture(autouse=True)
def registered():
    bicycle_env.register(ID, Narrow)
    yield
    gym.registry.pop(ID, None)


@pytest.mark.exhaustive
def test_one_car_many_and_tensors_are_the_same_task():
    single, many = gym.make(ID, **QUICK), gym.make_vec(ID, 6, **QUICK, autoreset_mode="Disabled")
    observation, _ = single.reset(seed=3)
    observations, _ = many.reset(seed=3)
    assert single.spec.max_episode_steps == many.unwrapped.max_episode_steps == 120
    assert single.unwrapped.task == many.unwrapped.task == Narrow(width=0.8)
    tensors = TorchVectorEnv(ID, 6, **QUICK, autoreset_mode="Disabled")
    assert tensors.task == Narrow(width=0.8)
    tensors.reset(seed=0)
    tensors.set_state(many.unwrapped.state._asdict())
    words = set()
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2)).astype(np.float32):
        assert observation.tobytes() == observations[0].tobytes()
        observation, reward, terminated, _, info = single.step(action)
        observations, rewards, over, _, infos = many.step(np.tile(action, (6, 1)))
        _, of_tensors, _, _, _ = tensors.step(torch.from_numpy(np.tile(action, (6, 1))))
        assert (reward, terminated, info["cost"]) == (rewards[0], over[0], infos["cost"][0])
        np.testing.assert_allclose(of_tensors.numpy(), rewards, rtol=1e-12, atol=1e-12)
        words |= {many.unwrapped.end_names[code] for code in infos["end"]}
        if terminated:
            break
    assert words == {"", "turned"}
    assert info["end"] == "turned"


def test_a_spec_goes_through_json():
    env = gym.make(ID, **QUICK)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.task == env.unwrapped.task
    assert json.loads(env.spec.to_json())["entry_point"].endswith(f"Mine/Narrow-v0 for one of {__name__}")


def test_an_object_gives_the_defaults_and_a_new_registration_replaces_the_old():
    bicycle_env.register(ID, Narrow(width=2.0), max_episode_steps=50)
    env = gym.make(ID)
    assert (env.unwrapped.task.width, env.spec.max_episode_steps, env.unwrapped.horizon) == (2.0, 50, 120)
    assert gym.make(ID, width=1.5).unwrapped.task.width == 1.5


def test_its_keywords_have_the_errors_of_the_others():
    with pytest.raises(TypeError, match="'widht'; did you mean 'width'"):
        gym.make(ID, widht=1.0)
    with pytest.raises(ValueError, match="speed must be"):
        gym.make(ID, speed=-1.0)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (("BicycleStab-v0", Narrow), ValueError, "must not be one of this package's own, got 'BicycleStab-v0'"),
        ((ID, object()), TypeError, "task must be a bicycle_env.tasks.task.Task or a class of them, got <object"),
        ((ID, Narrow, 0), ValueError, "max_episode_steps must be .*got 0"),
    ],
)
def test_what_cannot_be_registered_changes_nothing(arguments, error, words):
    with pytest.raises(error, match=words):
        bicycle_env.register(*arguments)
    assert gym.spec(ID).max_episode_steps == 120
    assert gym.make("BicycleStab-v0").unwrapped.task == Stabilise()


@pytest.mark.parametrize("name", ["tire", "friction", "telemetry", "threads", "max_episode_steps"])
def test_a_field_that_a_keyword_would_hide_is_refused(name):
    """The environment took the keyword, and the task went on with its own."""
    hidden = dataclasses.make_dataclass("Hidden", [(name, float, 0.2)], bases=(Narrow,), frozen=True)
    words = f"task Hidden: its field '{name}' must have another name: environments have a keyword of this"
    with pytest.raises(ValueError, match=words):
        bicycle_env.register(ID, hidden)

    class Env(BicycleStabEnv):
        default_task = hidden()

    class Many(BicycleStabVectorEnv):
        single_class = Env

    for make in (Env, Many):
        with pytest.raises(ValueError, match=words):
            make()
    assert gym.make(ID).unwrapped.task == Narrow()


def test_all_keywords_are_known_to_the_check():
    makers = (gym.make, gym.make_vec, BicycleStabEnv, BicycleStabVectorEnv, TorchVectorEnv)
    names = {
        parameter.name
        for maker in makers
        for parameter in inspect.signature(maker).parameters.values()
        if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    }
    assert names <= {*setup.NAMES, *setup.OF_MAKERS}


@pytest.mark.parametrize("name", ["friction", "speed", "state"])
def test_a_reset_option_that_would_be_hidden_is_refused(name):
    hidden = dataclasses.dataclass(frozen=True)(type("Hidden", (Narrow,), {"options": {name: (0.0, 1.0)}}))
    with pytest.raises(ValueError, match=f"task Hidden: its reset option '{name}' must have another name"):
        bicycle_env.register(ID, hidden)
    bicycle_env.register(ID, altered(Narrow(), randomise={"friction": (0.5, 1.0)}))  # what it draws is an option


def test_a_metric_of_a_column_that_no_episode_has_is_refused():
    """It was a KeyError in the first evaluation."""

    def metrics_of(column):
        return (*SHARED, Metric("least", "m", "", lambda run: float(np.min(run.steps[column]))))

    bad = dataclasses.dataclass(frozen=True)(type("Bad", (Narrow,), {"metrics": metrics_of("clearence")}))
    words = r"unknown column of run.steps \(metric 'least' of the task narrow\) 'clearence'; did you mean 'clearance'"
    with pytest.raises(ValueError, match=words):
        bicycle_env.register(ID, bad)
    for column in ("clearance", "yaw_rate", "time", "reward", "cost"):
        good = dataclasses.dataclass(frozen=True)(type("Good", (Narrow,), {"metrics": metrics_of(column)}))
        bicycle_env.register(ID, good)


@pytest.mark.parametrize("row", ENVIRONMENTS, ids=lambda row: row.id)
def test_the_packages_metrics_ask_for_columns_that_are_there(row):
    check_metrics(load_env_creator(row.entry_point).default_task)


def test_a_time_that_is_too_short_to_pass_is_remarked_on():
    slow = {"seconds_to_pass": lambda task, car: 2.41, "episode_steps": 120}
    late = dataclasses.dataclass(frozen=True)(type("Late", (Stabilise,), slow))
    bicycle_env.register(ID, late)
    words = "max_episode_steps = 120 makes success impossible: at .* m/s it takes at least 121 steps"
    for make in (lambda: gym.make(ID, **LINEAR).reset(seed=0), lambda: gym.make_vec(ID, 2, **LINEAR)):
        with pytest.warns(UserWarning, match=words):
            make()
    gym.make_vec(ID, 2, **LINEAR, max_episode_steps=121)


def test_a_path_without_its_errors_is_refused_by_controllers():
    """Entries of other names were accepted, and a controller followed y = 0."""

    class Renamed(LaneChange):
        def entries(self, speed, front_limit, rear_limit):
            given = super().entries(speed, front_limit, rear_limit)
            return tuple(entry._replace(name=entry.name.replace("_error", "_off")) for entry in given)

    bicycle_env.register(ID, dataclasses.dataclass(frozen=True)(Renamed))
    for name in ("lqr", "stanley"):
        with pytest.raises(ValueError, match="this controller needs lateral_error in the observation, which has"):
            control.make(name, gym.make(ID, **LINEAR))


# The check of a task


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
def test_a_task_is_checked_in_every_environment():
    lines = bicycle_env.check_task(STAB, cars=3, **SHORT)
    assert [line.split(": ")[1] for line in lines] == ["one car and many", "tensors", "mirror image", "rendering"]
    assert re.fullmatch(rf"{STAB}: one car and many: the same to the bit in \d+ steps of 3 cars \(ends: .*\)", lines[0])


def stepped(change):
    """A step that gives other numbers."""

    def wrapped(step):
        def other(self, action):
            return change(*step(self, action))

        return other

    return wrapped


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize(
    ("owner", "change", "words"),
    [
        (
            SingleTrackVectorEnv,
            lambda seen, reward, *rest: (seen, reward + 1e-9, *rest),
            "one car and many: reward of car 0 after 1 steps is ",
        ),
        (
            TorchVectorEnv,
            lambda seen, reward, *rest: (seen, reward + 1e-9, *rest),
            "tensors: reward of car 0 after 1 steps is ",
        ),
        (
            SingleTrackEnv,
            lambda seen, *rest: (seen + np.float32(0.25), *rest),
            "one car and many: observation of car 0 after 1 steps is",
        ),
    ],
    ids=["many", "tensors", "one"],
)
def test_the_check_says_what_differs(monkeypatch, owner, change, words):
    monkeypatch.setattr(owner, "step", stepped(change)(owner.step))
    with pytest.raises(ValueError, match=f"^{STAB}: {words}"):
        bicycle_env.check_task(STAB, cars=1, **SHORT)


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
def test_the_check_sees_a_side(monkeypatch):
    """The law of the start apart: whatever a task draws, its mirror image must drive on mirrored."""
    monkeypatch.setattr(SingleTrackEnv, "observation_mirror", property(lambda env: np.ones(8)))
    with pytest.raises(ValueError, match="mirror image: mirrored observation of car 0 after 0 steps"):
        bicycle_env.check_task(STAB, cars=1, **SHORT)


MODULE = """
import dataclasses
import bicycle_env
from bicycle_env.tasks.stabilise import Stabilise

@dataclasses.dataclass(frozen=True)
class Short(Stabilise):
    name = "short"
    episode_steps = 30

bicycle_env.register("Mine/Short-v0", Short)
"""
PROGRAM = """
import gymnasium as gym

if __name__ == "__main__":
    alone = gym.make("my_task:Mine/Short-v0", tire="linear")
    first = alone.reset(seed=1)[0]
    envs = gym.make_vec("my_task:Mine/Short-v0", 1, "async", {"context": "spawn"}, tire="linear")
    print((envs.reset(seed=1)[0][0] == first).all())
    envs.close()
"""


@pytest.mark.exhaustive
def test_a_spawned_worker_imports_the_tasks_module(tmp_path):
    (tmp_path / "my_task.py").write_text(MODULE)
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, str(tmp_path / "program.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr
