"""A task from scratch in one file, with a path and a preview: a slalom round cones that are passed left and right.

export PYTHONPATH=examples
python examples/my_slalom.py       # checks it: one car, many and tensors do the same, and so does the mirror image
python -m agents.evaluate --env-id my_slalom:Mine/Slalom-v0 --policy lqr stanley zero
"""

import dataclasses
import math
from typing import Any, NamedTuple

import bicycle_env
from bicycle_env import disturbances
from bicycle_env.tasks import (
    DIRECTIONS,
    SHARED,
    SIDES,
    Bounded,
    CarState,
    Entry,
    Mark,
    Metric,
    Quadratic,
    Reference,
    Task,
    check_fields,
    check_preview,
    choice,
    chosen_side,
    observed_on_path,
    path_ahead,
    path_entries,
    replaced,
    times_ahead,
    whole,
)

HALF_CONE = 0.15  # m: half of the side of a cone's square foot
FAR = 10.0  # m: the clearance that is told before the first cone


class Run(NamedTuple):
    """What an episode of this task has of its own."""

    direction: Any  # 1: the first cone is passed on its left, -1: on its right
    least_clearance: Any  # m, until now; < 0 after a touch, or a cone passed on its wrong side


class Course(NamedTuple):
    """The numbers that do not compile anew, m."""

    direction: Any  # 1, -1, or 0 for random
    first_cone: Any
    spacing: Any
    margin: Any


def path_of(xp, cones):
    """``path(longitudinal_position, run, world) -> (lateral position, slope)``: a cosine, faded in and out."""
    last, last_side = float(cones - 1), 1.0 if cones % 2 else -1.0

    def path(longitudinal_position, run, world):
        course = world.settings
        amplitude = run.direction * (0.5 * world.car.body_width + HALF_CONE + course.margin)
        place = (longitudinal_position - course.first_cone) / course.spacing
        place = xp.minimum(xp.maximum(place, -1.0), last + 1.0)
        wave, before, behind = xp.cos(math.pi * place), place < 0.0, place > last
        shape = xp.where(before, 0.5 * (wave + 1.0), xp.where(behind, 0.5 * (wave + last_side), wave))
        slope = xp.where(before | behind, -0.5 * math.pi, -math.pi) * xp.sin(math.pi * place) / course.spacing
        return amplitude * shape, amplitude * slope

    return path


def next_cone(xp, cones):
    """``cone(longitudinal_position, course, direction, reach) -> (place, side)``: the first not `reach` behind."""

    def cone(longitudinal_position, course, direction, reach):
        index = xp.floor((longitudinal_position - course.first_cone - reach) / course.spacing) + 1.0
        index = xp.minimum(xp.maximum(index, 0.0), float(cones - 1))
        odd = index - 2.0 * xp.floor(0.5 * index)
        return course.first_cone + index * course.spacing, direction * (1.0 - 2.0 * odd)

    return cone


@dataclasses.dataclass(frozen=True)
class Slalom(Task):
    """Pass every cone on its own side; a cone that is touched, or passed on its wrong side, ends the episode."""

    name = "slalom"
    episode_steps = 760
    TaskState, Settings = Run, Course
    flipped = ("direction",)
    uniforms = 3
    ends = ("spun", "left_road", "hit_cone")  # the codes 1, 2, 4: 3 is the environments' own
    road_half_width = 5.0
    usual_speed = 20.0
    settled_seconds = 0.0  # to be behind the last cone when the time is over is enough
    defaults = {"vehicle": "understeer", "steer": "front"}  # noqa: RUF012
    rewards = {  # noqa: RUF012
        "default": Bounded(lateral_weight=4.0, heading_weight=20.0, sideslip_weight=20.0, smoothness_weight=0.2),
        "quadratic": Quadratic(lateral_cost=1.0, heading_cost=10.0, yaw_rate_cost=1.0),
    }
    levels = {  # noqa: RUF012
        "easy": {"speed": 16.0},
        "medium": {},
        "hard": {
            "speed": 24.0,
            "randomise": {"friction": (0.7, 1.0)},
            "disturbances": (disturbances.Gust(force=(300.0, 900.0), start=(2.0, 8.0)),),
        },
    }
    options = {"direction": SIDES}  # noqa: RUF012

    # Fields are keywords of gym.make.
    cones: int = 6
    spacing: float = 36.0  # m
    first_cone: float = 50.0  # m from the start
    margin: float = 0.45  # m that a car on the path keeps from the cones
    direction: str = "random"
    preview_length: float = 1.2  # s
    preview_spacing: float = 0.1  # s

    def __post_init__(self):
        check_fields(self, choice, direction=(DIRECTIONS,))
        check_fields(self, whole, cones=(1, 9))
        check_fields(self, spacing=(12.0, 100.0), first_cone=(10.0, 200.0), margin=(0.0, 2.0))
        check_preview(self)

    @property
    def preview_times(self):
        return times_ahead(self.preview_length, self.preview_spacing)

    def settings(self, speed):
        return Course(DIRECTIONS[self.direction], self.first_cone, self.spacing, self.margin)

    def seconds_to_pass(self, car):
        return (self.first_cone + (self.cones - 1) * self.spacing + HALF_CONE + car.rear_extent) / car.speed

    def start(self, xp):
        side = xp.function(chosen_side(xp))

        def start(uniforms, world):
            y, heading = 0.1 * (2.0 * uniforms[0] - 1.0), 0.01 * (2.0 * uniforms[1] - 1.0)
            zero, direction = 0.0 * y, side(uniforms[2], world.settings.direction)
            return CarState(zero, y, heading, zero, zero, zero, zero), Run(direction, FAR + zero)

        return start

    def refilled(self, xp):  # a car that is put behind a cone has not passed it
        keep = replaced(xp, Run, ("least_clearance",))

        def refilled(state, episode, world):
            begun = state.longitudinal_position + world.car.front_extent > world.settings.first_cone - HALF_CONE
            return keep(episode.task_state, xp.where(begun, -FAR, FAR))

        return refilled

    def reference(self, xp):
        path, half_width = xp.function(path_of(xp, self.cones)), self.road_half_width

        def reference(state, run, world):
            y, slope = path(state.longitudinal_position, run, world)
            zero = 0.0 * y
            return Reference(y, xp.atan(slope), zero, zero, half_width)

        return reference

    def preview(self, xp):
        return path_ahead(xp, path_of(xp, self.cones))

    def entries(self, speed, front_limit, rear_limit):
        usual = path_entries(self, speed, front_limit, rear_limit)
        own = (
            Entry("next_cone", "m", speed, 10.0, "from the front bumper to the next cone", mirror=1.0),
            Entry("next_side", "", 1.0, 1.0, "on which it must be passed: 1 left, -1 right"),
        )
        place = len(usual) - len(self.preview_times)  # the preview comes last
        return (*usual[:place], *own, *usual[place:])

    def observe(self, xp):
        usual, cone = xp.function(observed_on_path(xp, self)), xp.function(next_cone(xp, self.cones))

        def observe(state, episode, world):
            car, direction = world.car, episode.task_state.direction
            place, side = cone(state.longitudinal_position, world.settings, direction, car.rear_extent)
            return (*usual(state, episode, world), place - state.longitudinal_position - car.front_extent, side)

        return observe

    def remember(self, xp):
        cone, keep = xp.function(next_cone(xp, self.cones)), replaced(xp, Run, ("least_clearance",))

        def remember(state, episode, action, world):
            run, car, course = episode.task_state, world.car, world.settings
            # The cone that is nearest along the road, as the car sees it.
            place, side = cone(state.longitudinal_position, course, run.direction, 0.5 * course.spacing)
            dx, dy = place - state.longitudinal_position, -state.lateral_position
            cosine, sine = xp.cos(state.heading), xp.sin(state.heading)
            along, across = dx * cosine + dy * sine, dy * cosine - dx * sine
            beside = (along < car.front_extent + HALF_CONE) & (along > -car.rear_extent - HALF_CONE)
            clearance = -side * across - 0.5 * car.body_width - HALF_CONE
            return keep(run, xp.where(beside, xp.minimum(run.least_clearance, clearance), run.least_clearance))

        return remember

    def end(self, xp):
        usual = xp.function(super().end(xp))

        def end(state, reference, episode, world):
            code = usual(state, reference, episode, world)
            return xp.where((code == 0) & (episode.task_state.least_clearance < 0.0), 4, code)

        return end

    def success(self, xp):
        last = float(self.cones - 1)

        def success(state, reference, episode, world):
            course = world.settings
            rearmost = state.longitudinal_position - world.car.rear_extent - HALF_CONE
            return rearmost > course.first_cone + last * course.spacing

        return success

    def marks(self, run, world):
        course = world.settings
        return (Mark("cones", tuple((course.first_cone + k * course.spacing, 0.0) for k in range(self.cones))),)

    @property
    def metrics(self):
        def least(run):
            clearance = float(run.steps["least_clearance"][-1])
            return None if clearance == FAR else clearance  # no cone was reached

        return (*SHARED, Metric("least_clearance", "m", "of the body from a cone, < 0: touched or missed", least))


bicycle_env.register("Mine/Slalom-v0", Slalom)


if __name__ == "__main__":
    for line in bicycle_env.check_task("Mine/Slalom-v0"):
        print(line)
