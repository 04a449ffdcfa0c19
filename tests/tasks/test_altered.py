"""A user's own addition to any task: an entry more, ice at a place; in one class, from a file of his own."""

import dataclasses

import gymnasium as gym
import pytest
from gymnasium.envs.registration import registry

import bicycle_env
from bicycle_env.envs.many.block_kernels import label
from bicycle_env.envs.many.blocks import Kind
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.records import replaced
from bicycle_env.physics.single_track import SingleTrack
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.checking import check
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.randomised import nominal
from bicycle_env.tasks.stabilise import Stabilise
from bicycle_env.tasks.task import Entry

ID = "Test/Icy-v0"
NOISY = bicycle_env.Sensors(noise={"course": 0.01})


@dataclasses.dataclass(frozen=True)
class Icy(AlteredTask):
    """Ice across the road from a place on; the course is observed, too, as a GPS has it."""

    begin: float = 12.0

    def conditions(self, xp):
        before, begin = xp.function(self.task.conditions(xp) or nominal), self.begin
        gripping = replaced(xp, CarParameters, ("front_peak_force", "rear_peak_force"))

        def conditions(state, episode, time, world):
            car = before(state, episode, time, world)
            grip = xp.where(state.longitudinal_position > begin, 0.2 + 0.0 * time, 1.0)
            return gripping(car, grip * car.front_peak_force, grip * car.rear_peak_force)

        return conditions

    def entries(self, speed, front_limit, rear_limit):
        entries = self.task.entries(speed, front_limit, rear_limit)
        seen = len(entries) - len(self.preview_times)
        return (*entries[:seen], Entry("course", "rad", 0.2, 10.0, "heading + sideslip"), *entries[seen:])

    def observe(self, xp):
        inner = xp.function(self.task.observe(xp))

        def observe(state, episode, world):
            return (*inner(state, episode, world), state.heading + xp.atan(state.lateral_velocity / world.car.speed))

        return observe

    def marks(self, task_state, world):
        begin, end = self.begin, self.begin + 100.0
        return *self.task.marks(task_state, world), Mark("ice", ((begin, -2.0), (end, -2.0), (end, 2.0), (begin, 2.0)))


@pytest.mark.parametrize("task", [Stabilise(), LaneChange(), altered(LaneChange(), observation_delay=1)], ids=repr)
def test_nothing_need_be_drawn_where_nothing_is_kept(task):
    check(Icy(task))
    check(altered(Icy(task), randomise={"mass": (0.9, 1.1, "relative")}, sensors=NOISY))


@pytest.mark.exhaustive
def test_it_is_driven_observed_and_a_keyword():
    bicycle_env.register(ID, Icy(Stabilise()))
    env = gym.make(ID, begin=20.0, telemetry=True).unwrapped
    registry.pop(ID)
    assert env.observation_names[-1] == "course"
    shares = []
    for place in (15.0, 25.0):
        observation, info = env.reset(
            options={"state": {"longitudinal_position": place, "yaw_rate": 1.5, "heading": 0.1}}
        )
        assert observation[-1] == pytest.approx(0.1 / 0.2, rel=1e-6)
        shares.append(abs(info["front_lateral_force"]) / info["front_saturation"])
    assert shares[1] == pytest.approx(0.2 * shares[0])
    assert env.task.marks(None, None)[0].points[0] == (20.0, -2.0)


def test_what_is_kept_must_be_drawn():
    task = dataclasses.dataclass(frozen=True)(type("Keeping", (AlteredTask,), {"kept": ("depth",)}))(Stabilise())
    words = "task Keeping: its law 'start' cannot be made .NotImplementedError: what is kept, depth, needs a law 'draw'"
    with pytest.raises(ValueError, match=words):
        check(task)


@pytest.mark.parametrize("task", [3, Stabilise, None])
def test_a_task_of_something_else_is_refused(task):
    with pytest.raises(TypeError, match=r"task must be a bicycle_env.tasks.task.Task, got"):
        Icy(task)
    with pytest.raises(TypeError, match=r"task must be a bicycle_env.tasks.task.Task, got"):
        dataclasses.replace(altered(Stabilise(), sensors={"signals": "car"}), task=task)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Stabilise(), "stabilise with"),
        (Icy(Stabilise()), "Icy of stabilise with"),
        (altered(Icy(LaneChange()), action_delay=2), "LateActions of Icy of lane_change with"),
    ],
    ids=["plain", "altered", "twice"],
)
def test_what_is_compiled_is_named_by_all_that_it_is_made_of(task, words):
    assert label(Kind(task, SingleTrack.of("linear"), 9, 1, False, "float64")).startswith(words)
