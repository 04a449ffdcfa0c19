"""The evasion task: an obstacle blocks the lane; go round it through the next lane, come back, run straight."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from bicycle_env.physics.actuators import FRONT
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.records import replaced
from bicycle_env.physics.validation import check_fields, explain_keywords
from bicycle_env.tasks.draws import check_draws, drawn, draws_of, draws_record
from bicycle_env.tasks.ends import Tolerances, clearance, end_outside, settled
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.metrics import SHARED, Metric, Run, least
from bicycle_env.tasks.path import SIDES
from bicycle_env.tasks.rewards import Quadratic, Reward, plus_square
from bicycle_env.tasks.task import Entry, Law, Task, fixed_entries, observed_car

LANE_WIDTH = 3.5
"""m, of the own lane, whose middle is y = 0, and of the one beside it."""
FAR_OUTSIDE = 2.5
"""m outside of the corridor at which the episode ends."""
START = {"lateral_position": 0.2, "heading": 0.01, "sideslip": 0.005, "yaw_rate": 0.03}
"""Half-widths of the uniform start: m, rad, rad, rad/s."""
RANGES = {
    "relative_friction": (0.05, 2.0),
    "obstacle_time": (0.2, 2.5),
    "obstacle_length": (0.1, 1.5),
    "return_time": (0.2, 2.2),
}
"""What is drawn, and within which numbers: together they leave the half second that is judged."""
FURTHEST = 5.0
"""s, to which the distances of the gates are clipped."""


class Gates(NamedTuple):
    """What an episode has of its own."""

    side: Any
    """Where the other lane is: +1 left, -1 right."""
    relative_friction: Any
    """The true friction per the nominal one."""
    obstacle_time: Any
    """s from the start until the front bumper is at the obstacle."""
    obstacle_length: Any
    """s along it."""
    return_time: Any
    """s from its end to the last gate, from which on only the own lane is free."""
    touched: Any
    """1 once a point of the body was outside of the corridor, else 0."""


class Places(NamedTuple):
    """Of the three gates along the road, m."""

    begin: Any
    end: Any
    last: Any


@explain_keywords
@dataclasses.dataclass(frozen=True)
class FreeRoad(Reward):
    """1 / (1 + c) in (0, 1], c of what is outside of the corridor and of how the car moves; no path is prescribed.

    Outside counts from a margin within the corridor on. Heading, sideslip and yaw rate count little during the
    manoeuvre and more behind the last gate; effort is the squared action, smoothness its squared change, both per axle.
    After a touch, which forfeits success, only a share is paid. Numbers >= 0, per m^2, rad^2 and (rad/s)^2.
    """

    margin: float = 0.2
    """m."""
    outside_weight: float = 10.0
    sideslip_weight: float = 10.0
    yaw_rate_weight: float = 0.2
    effort_weight: float = 0.05
    smoothness_weight: float = 0.02
    settling_weight: float = 2000.0
    """Of heading, sideslip and a half of the yaw rate, behind the last gate."""
    share_after_touch: float = 0.1

    def __post_init__(self) -> None:
        check_fields(self, **{field.name: (0.0, 1e6) for field in dataclasses.fields(self)})
        check_fields(self, share_after_touch=(0.0, 1.0))

    def law(self, xp: Any) -> Law:
        plus, places_of = xp.function(plus_square(xp)), xp.function(places(xp))
        clearance_of = xp.function(clearance(xp, Evade()))
        margin, outside_weight, sideslip_weight = self.margin, self.outside_weight, self.sideslip_weight
        yaw_rate_weight, settling_weight = self.yaw_rate_weight, self.settling_weight
        effort_weight, smoothness_weight, share = self.effort_weight, self.smoothness_weight, self.share_after_touch

        def free_road(
            state: CarState,
            reference: Reference,
            action: Any,
            episode: EpisodeState,
            before: Any,
            end: Any,
            world: World,
        ) -> Any:
            own, car = episode.task_state, world.car
            sideslip = state.lateral_velocity / car.speed
            front_change = action[0] - episode.front_steer_command / car.front_angle_limit
            rear_change = action[1] - episode.rear_steer_command / car.rear_angle_limit
            through = state.longitudinal_position - car.rear_extent > places_of(own, car).last
            settling = xp.where(through, settling_weight + 0.0 * sideslip, 0.0)
            total = plus(1.0, outside_weight, xp.maximum(margin - clearance_of(state, reference, episode, world), 0.0))
            total = plus(total, settling, state.heading)
            total = plus(total, sideslip_weight + settling, sideslip)
            total = plus(total, yaw_rate_weight + 0.25 * settling, state.yaw_rate)
            total = plus(total, effort_weight, action[0])
            total = plus(total, effort_weight, action[1])
            total = plus(total, smoothness_weight, front_change)
            total = plus(total, smoothness_weight, rear_change)
            return xp.where(own.touched > 0.5, share + 0.0 * total, 1.0) / total

        return free_road


@dataclasses.dataclass(frozen=True)
class Evade(Task):
    """No point of the body outside of the free corridor, whatever the way; then straight on.

    Both lanes are free before the obstacle and behind it, only the other one beside it, and only the own one from
    the last gate on. The ranges are those of uniform draws, one for each episode: friction per the nominal one; s that
    the front bumper takes to the obstacle, along it, and from its end to the last gate.
    """

    name = "evade"
    episode_steps = 340
    TaskState = Gates
    Settings = draws_record(RANGES)
    uniforms = 5 + len(RANGES)
    ends = ("spun", "left_corridor")
    tolerances = Tolerances(lateral=0.5 * LANE_WIDTH, heading=0.05, sideslip=0.05, yaw_rate=0.1)
    settled_seconds = 0.5
    road_half_width = LANE_WIDTH
    uniform_corridor = False
    judged_points = 5
    rewards = {  # noqa: RUF012 (a constant)
        "default": FreeRoad(),
        "quadratic": Quadratic(lateral_cost=0.5, heading_cost=10.0, yaw_rate_cost=1.0),
    }
    defaults = {"steer": "front"}  # noqa: RUF012 (a constant)
    levels = {  # noqa: RUF012 (a constant)
        "easy": {
            "steer": "both",
            "relative_friction": (1.0, 1.0),
            "obstacle_time": (1.0, 1.6),
            "obstacle_length": (0.5, 0.8),
            "return_time": (1.3, 2.0),
        },
        "medium": {},
        "hard": {
            "front_actuator": dataclasses.replace(FRONT, rate_limit=math.radians(15.0)),
            "relative_friction": (0.35, 1.0),
            "obstacle_time": (0.8, 2.0),
            "obstacle_length": (0.2, 1.0),
            "return_time": (0.7, 2.0),
        },
    }
    flipped = ("side",)
    hidden = ("relative_friction",)
    forfeits = ("touched",)
    options = {"direction": SIDES, **RANGES}  # noqa: RUF012 (a constant)

    direction: str = "random"
    relative_friction: tuple[float, float] = (0.3, 1.0)
    obstacle_time: tuple[float, float] = (0.9, 1.6)
    obstacle_length: tuple[float, float] = (0.3, 0.6)
    return_time: tuple[float, float] = (0.9, 1.6)

    def __post_init__(self) -> None:
        check_draws(self, RANGES)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return (
            *SHARED,
            Metric(
                "least_clearance",
                "m",
                "from the edge of the corridor to the nearest point; < 0: outside",
                least("clearance"),
            ),
            Metric("touched", "", "1 if a point of the body was ever outside, else 0", _touched),
        )

    def settings(self, speed: float) -> Any:
        return draws_of(self, RANGES)

    def start(self, xp: Any) -> Law:
        lateral, heading, sideslip, yaw_rate = START.values()
        draw = drawn(xp, RANGES, 4)

        def start(uniforms: Any, world: World) -> tuple[CarState, Gates]:
            car, zero = world.car, 0.0 * uniforms[0]
            side, friction, until, along, back = draw(uniforms, world.settings)
            state = CarState(
                zero,
                lateral * (2.0 * uniforms[0] - 1.0),
                heading * (2.0 * uniforms[1] - 1.0),
                sideslip * (2.0 * uniforms[2] - 1.0) * car.speed,
                yaw_rate * (2.0 * uniforms[3] - 1.0),
                zero,
                zero,
            )
            return state, Gates(side, friction, until, along, back, zero)

        return start

    def reference(self, xp: Any) -> Law:
        half_lane, places_of = 0.5 * LANE_WIDTH, xp.function(places(xp))

        def reference(state: CarState, own: Gates, world: World) -> Reference:
            x, gates = state.longitudinal_position, places_of(own, world.car)
            zero = 0.0 * x
            beside, back = (x >= gates.begin) & (x <= gates.end), x >= gates.last
            middle = xp.where(beside, LANE_WIDTH * own.side + zero, zero)
            centre = xp.where(beside, LANE_WIDTH * own.side + zero, xp.where(back, zero, half_lane * own.side + zero))
            half = xp.where(beside | back, half_lane + zero, LANE_WIDTH)
            return Reference(middle, zero, zero, centre, half)

        return reference

    def observe(self, xp: Any) -> Law:
        car_law, places_of = xp.function(observed_car(xp)), xp.function(places(xp))

        def observe(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, ...]:
            own, front = episode.task_state, state.longitudinal_position + world.car.front_extent
            seen: tuple[Any, ...] = car_law(state, episode)
            begin, end, last = places_of(own, world.car)
            speed = world.car.speed + 0.0 * front
            return (*seen, speed, own.side, begin - front, end - front, last - front, own.touched)

        return observe

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        gates = (
            ("obstacle_begin", "from the front bumper; scale: speed, clipped at 5 s"),
            ("obstacle_end", "the same"),
            ("last_gate", "the same; from there on only the own lane is free"),
        )
        return (
            *fixed_entries(speed, front_limit, rear_limit),
            Entry("speed", "m/s", 40.0, 10.0, "constant", 1.0),
            Entry("side", "", 1.0, 1.0, "of the other lane: 1 left, -1 right"),
            *(Entry(name, "m", speed, FURTHEST, meaning, 1.0) for name, meaning in gates),
            Entry("touched", "", 1.0, 1.0, "1 once a point of the body was outside, else 0", 1.0),
        )

    def conditions(self, xp: Any) -> Law:
        gripped = replaced(xp, CarParameters, ("front_peak_force", "rear_peak_force"))

        def conditions(state: CarState, episode: EpisodeState, time: Any, world: World) -> CarParameters:
            grip, car = episode.task_state.relative_friction, world.car
            there: CarParameters = gripped(car, grip * car.front_peak_force, grip * car.rear_peak_force)
            return there

        return conditions

    def remember(self, xp: Any) -> Law:
        reference_law, clearance_of = xp.function(self.reference(xp)), xp.function(clearance(xp, self))
        changed = replaced(xp, Gates, ("touched",))

        def remember(state: CarState, episode: EpisodeState, action: Any, world: World) -> Gates:
            own = episode.task_state
            clear = clearance_of(state, reference_law(state, own, world), episode, world)
            now: Gates = changed(own, xp.where(clear < 0.0, 1.0 + 0.0 * clear, own.touched))
            return now

        return remember

    def end(self, xp: Any) -> Law:
        return end_outside(xp, self, FAR_OUTSIDE)

    def success(self, xp: Any) -> Law:
        straight = xp.function(settled(xp, self.tolerances))

        def success(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
            return straight(state, reference, episode, world) & (episode.task_state.touched < 0.5)

        return success

    def marks(self, own: Any, world: World) -> tuple[Mark, ...]:
        """The obstacle, which is as wide as the own lane, and cones at its corners."""
        begin, end, _ = map(float, places(PYTHON)(own, world.car))
        half = 0.5 * LANE_WIDTH
        corners = ((begin, -half), (begin, half), (end, half), (end, -half))
        return Mark("obstacle", corners), Mark("cones", corners)

    def task_state_with(self, own: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        changes = dict(numbers)
        if "direction" in changes:
            changes["side"] = changes.pop("direction")
        return own._replace(**changes)


def places(xp: Any) -> Law:
    """``places(own, car) -> Places``."""

    def places(own: Gates, car: CarParameters) -> Places:
        begin = xp.multiply_add(car.speed, own.obstacle_time, car.front_extent)
        end = xp.multiply_add(car.speed, own.obstacle_length, begin)
        return Places(begin, end, xp.multiply_add(car.speed, own.return_time, end))

    return places


def _touched(run: Run) -> float:
    return float(run.steps["touched"][-1])
