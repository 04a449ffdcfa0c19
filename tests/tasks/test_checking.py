"""A task that the environments would contradict is refused when it is first used, in one line that names its law."""

import dataclasses
from typing import ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
import pytest
import torch
from combinations import only_all

from bicycle_env.envs import BicycleStabEnv, TorchVectorEnv
from bicycle_env.envs.bicycle_stab import BicycleStabVectorEnv
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.records import replaced
from bicycle_env.tasks.checking import check
from bicycle_env.tasks.episode import Reference
from bicycle_env.tasks.evade import Evade
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.path import follows_path
from bicycle_env.tasks.stabilise import Stabilise
from bicycle_env.tasks.task import Entry, Task

TASKS = [Stabilise(), LaneChange(), LaneChange("left", 1.0, length=40.0), LaneChange(preview_length=0.0)]


def variant(**changes):
    """Stabilise with another law: a class of its own, frozen."""
    return dataclasses.dataclass(frozen=True)(type("Variant", (Stabilise,), changes))()


def law(function):
    """``task.name(xp)`` of a law that needs no namespace."""
    return lambda task, xp: function


def other_observation(observed):
    return law(lambda state, memory, world: observed(state, memory))


@pytest.mark.parametrize("task", TASKS, ids=repr)
def test_the_packages_own_tasks_pass(task):
    check(task)


def test_all_that_is_missing_is_named_at_once():
    class Bare(Task):
        name, uniforms, flipped = "bare", 1, None

    with pytest.raises(
        TypeError,
        match=r"^task Bare must have episode_steps, TaskState, Settings, ends, rewards, entries, observe, reference, "
        r"road_half_width, settings, start, tolerances \(or a success of its own\) \(docs/your_own.md",
    ):
        Bare()


def test_the_state_is_the_cars_the_commands_the_time_and_the_tasks_own():
    names = (*CarState._fields, "front_steer_command", "rear_steer_command", "time")
    assert Stabilise().State._fields == names
    assert LaneChange().State._fields == (*names, "direction", "change_start")
    assert LaneChange().State is LaneChange("left").State
    assert LaneChange().State.__name__ == "LaneChangeState"


def test_what_controllers_read_of_a_path_is_asked_for():
    assert [follows_path(task) for task in (Stabilise(), LaneChange(), LaneChange(preview_length=0.0), Evade())] == [
        *(False, True),
        *(True, False),
    ]


def test_tasks_are_values():
    assert LaneChange(duration=1.5) == LaneChange(duration=np.float32(1.5))
    assert LaneChange() != LaneChange(duration=2.0)
    assert len({Stabilise(), Stabilise(), LaneChange(), LaneChange("left")}) == 3
    with pytest.raises(dataclasses.FrozenInstanceError):
        LaneChange().lane_width = 3.0


def changed_in_place(state, reference, episode, world):
    size = state.heading
    size *= size
    return size


class Taken(NamedTuple):
    heading: float


FAULTS = {
    "one value too many": (
        {"observe": other_observation(lambda state, memory: (state.heading,) * 9)},
        r"'observe' must return a value for each of the 8 entries that are no preview \(lateral_position, .*got 9",
    ),
    "one value too few": (
        {"observe": other_observation(lambda state, memory: (state.heading,))},
        "'observe' must return a value for each of the 8 entries .*got 1",
    ),
    "a typo": (
        {"reference": law(lambda state, route, world: Reference(state.yawrate, 0.0, 0.0, 0.0))},
        "'reference' fails on two cars at once .*'CarState' object has no attribute 'yawrate'",
    ),
    "a branch": (
        {"end": law(lambda state, reference, episode, world: 1 if state.heading > 0.0 else 0)},
        "'end' fails on two cars at once .it branches on data: use xp.where",
    ),
    "a mean over the cars": (
        {"cost": law(lambda state, reference, episode, world: 0.0 * state.heading + np.mean(state.heading) ** 2)},
        "'cost' fails on two cars at once .it calls numpy's mean: a law may use xp's function, where, ",
    ),
    "the first car's": (
        {"cost": law(lambda state, reference, episode, world: 0.0 * state.heading + state.heading[0] ** 2)},
        "'cost' fails on two cars at once .it looks into a number as if it were an array: a law is of single numbers",
    ),
    "a function of numpy": (
        {"cost": law(lambda state, reference, episode, world: np.arctan(abs(state.heading)))},
        "'cost' fails on two cars at once .it calls numpy's arctan: use xp.atan.$",
    ),
    "a function of numpy for a builtin": (
        {"cost": law(lambda state, reference, episode, world: np.abs(state.heading))},
        "it calls numpy's absolute: use abs",
    ),
    "an argument changed in place": (
        {"cost": law(changed_in_place)},
        r"'cost' changes what it is given: write x = x \+ 1.0 in place of x \+= 1.0",
    ),
    "a function that xp does not have": (
        {"cost": lambda task, xp: lambda state, reference, episode, world: xp.exp(abs(state.heading))},
        "'cost' fails on two cars at once .xp has no 'exp'; it has function, where, multiply_add, .*tanh.$",
    ),
    "one that it does not have when the law is made": (
        {"cost": lambda task, xp: xp.exp},
        "'cost' cannot be made .xp has no 'exp'; it has",
    ),
    "a misspelt field": (
        {"conditions": lambda task, xp: replaced(xp, CarParameters, ("front_peak",))},
        "'conditions' cannot be made .ValueError: unknown field of CarParameters 'front_peak'; did you",
    ),
    "a constant": (
        {"cost": law(lambda state, reference, episode, world: 0.0)},
        "'cost' must give one finite number per car, got 0.0",
    ),
    "not finite": (
        {"cost": law(lambda state, reference, episode, world: state.heading / 0.0)},
        "'cost' must give one finite number per car",
    ),
    "no reference": (
        {"reference": law(lambda state, route, world: (state.heading,) * 4)},
        "'reference' must be a Reference, got tuple",
    ),
    "a start without a state of the task": (
        {"start": law(lambda uniforms, world: (CarState(*(uniforms[0],) * 7), (uniforms[0],)))},
        r"'start' must return \(CarState, TaskState\); the second must be a Nothing, got tuple",
    ),
    "an end without a word": (
        {"end": law(lambda state, reference, episode, world: 4 + 0 * state.heading)},
        r"'end' must return codes among \[0, 1, 2\], got \[4",
    ),
    "another one for the mirror image": (
        {"success": law(lambda state, reference, episode, world: state.heading > 0.0)},
        "law 'success' is another one for the mirror image.*`flipped`",
    ),
    "an entry without a side": (
        {"observe": other_observation(lambda state, memory: (abs(state.heading), *(state.heading,) * 7))},
        "entry 'lateral_position' is another one for the mirror image.*`mirror`",
    ),
    "the same name twice": (
        {"entries": lambda task, speed, front, rear: (Entry("x", "m", 1.0, 1.0, ""),) * 8},
        "names of its entries must differ, got x, x",
    ),
    "another state": ({"State": Taken}, "State must be left out, it follows from TaskState; got .'heading',"),
    "a name of the car's": ({"TaskState": Taken}, "TaskState must have other names than the car's, got heading"),
    "an option of no number": (
        {"options": {"place": (0.0, 1.0)}},
        r"options must be names of TaskState, \(\), or .*place",
    ),
    "a wider place than the widest": (
        {"reference": law(lambda state, route, world: Reference(*(0.0 * state.heading,) * 4, 2.0))},
        "road_half_width must be that of the widest place, got 1.75 where its law 'reference' says 2.0",
    ),
    "a time that is none": ({"settled_seconds": -1.0}, "settled_seconds must be a finite number >= 0, got -1"),
    "no road": ({"road_half_width": 0.0}, "road_half_width must be a finite number > 0, got 0"),
    "one point": ({"judged_points": 1}, r"judged_points must be a whole number in \[2, 100\], got 1"),
    "a name that flips and is not there": ({"flipped": ("direction",)}, "flipped must be names of TaskState"),
}


@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_line(fault):
    changes, words = FAULTS[fault]
    with pytest.raises((ValueError, TypeError), match=f"^task Variant: .*{words}") as caught:
        check(variant(**changes))
    assert "\n" not in str(caught.value)


def test_a_task_without_a_mirror_image_says_so():
    one_sided = law(lambda state, reference, episode, world: state.heading > 0.0)
    check(variant(success=one_sided, flipped=None))


def test_a_task_that_is_not_frozen_is_refused():
    laws = {name: value for name, value in vars(Stabilise).items() if not name.startswith("__")}
    with pytest.raises(TypeError, match="task Loose must be a frozen dataclass"):
        check(type("Loose", (Task,), laws)())


def test_a_task_with_a_list_is_refused():
    listed = dataclasses.make_dataclass("Listed", [("speeds", list)], bases=(Stabilise,), frozen=True)
    with pytest.raises(TypeError, match="task Listed: its fields must be hashable, a tuple in place of a list"):
        check(listed([1.0]))


# A task of one's own in all environments


@dataclasses.dataclass(frozen=True)
class Wide(Stabilise):
    """Ends, succeeds and costs by laws of its own, which read its own keyword."""

    limit: float = 0.5
    ends: ClassVar = ("spun", "left_lane", "turned", "went_back")

    def end(self, xp):
        limit = self.limit

        def end(state, reference, episode, world):
            return xp.where(abs(state.heading) > limit, 4, xp.where(state.lateral_velocity < -1e9, 5, 0))

        return end

    def success(self, xp):
        limit = self.limit
        return lambda state, reference, episode, world: abs(state.heading) < 1.5 * limit  # so settled when it ends

    def cost(self, xp):
        limit = self.limit
        return lambda state, reference, episode, world: xp.where(
            abs(state.heading) > 0.1 * limit, limit + 0.0 * state.heading, 0.0
        )


class WideEnv(BicycleStabEnv):
    default_task = Wide()


class WideVectorEnv(BicycleStabVectorEnv):
    single_class = WideEnv


@pytest.fixture
def wide(monkeypatch):
    for spec in [name for name in gym.registry if name.startswith("Wide")]:
        monkeypatch.delitem(gym.registry, spec)
    gym.register("Wide-v0", WideEnv, vector_entry_point=WideVectorEnv, max_episode_steps=100)
    yield
    gym.registry.pop("Wide-v0")


@pytest.mark.usefixtures("interpreted")  # the laws are asked, not the machine code
@pytest.mark.parametrize("limit", [0.3, only_all(0.4)])
def test_a_law_reads_the_tasks_own_keyword_in_every_environment(wide, limit):
    """Kernels of an earlier revision were made of `Wide()`, whatever the keyword."""
    given = {"limit": limit, "tire": "linear"}
    state = {"heading": limit - 0.1, "yaw_rate": 0.1}
    single = gym.make("Wide-v0", **given).unwrapped
    many = WideVectorEnv(3, **given, autoreset_mode="Disabled", max_episode_steps=100)
    tensors = TorchVectorEnv("Wide-v0", 3, **given, autoreset_mode="Disabled")
    single.reset(seed=0, options={"state": state})
    many.reset(seed=0, options={"state": state})
    tensors.reset(seed=0)
    tensors.set_state({**dict.fromkeys(single.state._fields[:9], 0.0), **state, "time": 0.0})
    assert (
        many.end_names[:6]
        == tensors.end_names[:6]
        == ("", "spun", "left_lane", "invalid_action", "turned", "went_back")
    )
    told = []
    for _ in range(99):
        _, _, terminated, _, info = single.step(np.zeros(2, np.float32))
        _, _, flags, _, infos = many.step(np.zeros((3, 2), np.float32))
        of_tensors = tensors.step(torch.zeros(3, 2))
        assert flags.tolist() == [terminated] * 3 == of_tensors[2].tolist()
        assert many.end_names[infos["end"][0]] == info["end"] == tensors.end_names[of_tensors[4]["end"][0]]
        assert infos["cost"].tolist() == [info["cost"]] * 3 == of_tensors[4]["cost"].tolist()
        assert many.is_success.tolist() == [single.is_success] * 3 == tensors.is_success.tolist()
        assert infos["is_success"].tolist() == [info["is_success"]] * 3 == of_tensors[4]["is_success"].tolist()
        told.append(info["is_success"])
        assert told[-1] is single.is_success
        if terminated:
            assert abs(single.state.heading) > limit
            assert info["end"] == "turned"
            break
        assert abs(single.state.heading) <= limit
    assert terminated
    assert told[:-1] == [False] * 49 + [True] * (len(told) - 50)
    assert told[-2:] == [True, False], "settled to the last, but an episode that has ended is no success"
