"""The lane-change task: move one lane over along a smooth path, at a speed where the car is unstable by itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bicycle_env.physics.car import CarState
from bicycle_env.physics.validation import check_fields, choice, positive
from bicycle_env.tasks import rewards
from bicycle_env.tasks.ends import Tolerances
from bicycle_env.tasks.episode import Reference, World
from bicycle_env.tasks.metrics import SHARED, Metric, Run
from bicycle_env.tasks.path import (
    DIRECTIONS,
    SIDES,
    check_preview,
    chosen_side,
    observed_on_path,
    path_ahead,
    path_entries,
    quintic_rise,
    times_ahead,
)
from bicycle_env.tasks.task import Entry, Task

LATEST_START = 100.0  # s
DURATION = 1.5  # s


class Route(NamedTuple):
    """The path of one episode."""

    direction: Any
    """+1 to the left, -1 to the right."""
    change_start: Any
    """Longitudinal position at which the change begins, m."""


class Path(NamedTuple):
    """The task's numbers."""

    lane_width: Any
    """m."""
    road_half_width: Any
    """m."""
    change_length: Any
    """Along the road, m."""
    direction: Any
    """+1, -1, or 0 for random."""
    earliest_start: Any
    """Longitudinal position, m."""
    latest_start: Any
    offset: Any
    """Half-width of the uniform lateral start, m."""
    heading: Any
    """Half-width of the uniform start of the heading, rad."""


@dataclasses.dataclass(frozen=True)
class LaneChange(Task):
    """Follow y(s) = W (10 s^3 - 15 s^4 + 6 s^5), s from 0 to 1 over the length of the change, then run straight."""

    name = "lane_change"
    episode_steps = 300
    TaskState = Route
    Settings = Path
    uniforms = 4
    ends = ("spun", "left_road")
    tolerances = Tolerances(lateral=0.3)
    rewards = {  # noqa: RUF012 (a constant)
        "default": rewards.Bounded(
            lateral_weight=4.0,
            heading_weight=20.0,
            sideslip_weight=20.0,
            effort_weight=0.1,
            smoothness_weight=0.2,
        ),
        "quadratic": rewards.Quadratic(lateral_cost=1.0, heading_cost=10.0, yaw_rate_cost=1.0),
    }
    levels = {  # noqa: RUF012 (a constant)
        "easy": {"speed_ratio": 1.05},
        "medium": {},
        "hard": {"randomise": {"friction": (0.4, 1.0)}, "action_delay": 3},
    }
    flipped = ("direction",)
    options = {"direction": SIDES, "change_start": (0.0, LATEST_START)}  # noqa: RUF012 (a constant)

    direction: str = "random"
    change_start: float | None = None
    """s after the start; None for random."""
    duration: float | None = None
    """s; 1.5 unless the length is given."""
    length: float | None = None
    """m, in place of the duration."""
    lane_width: float = 3.5
    preview_length: float = 1.2
    """s."""
    preview_spacing: float = 0.1
    """s."""

    def __post_init__(self) -> None:
        check_fields(self, choice, direction=(DIRECTIONS,))
        if self.duration is not None and self.length is not None:
            raise ValueError(
                f"give duration or length of the change, not both; got {self.duration!r} and {self.length!r}"
            )
        given = [name for name in ("duration", "length") if getattr(self, name) is not None]
        check_fields(self, positive, lane_width=(), **dict.fromkeys(given, ()))
        check_preview(self)
        if self.change_start is not None:
            check_fields(self, change_start=(0.0, LATEST_START))

    @property
    def road_half_width(self) -> float:
        return self.lane_width

    @property
    def preview_times(self) -> tuple[float, ...]:
        return times_ahead(self.preview_length, self.preview_spacing)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return (
            *SHARED,
            Metric("overshoot", "m", "how far beyond the new lane's middle", overshoot),
            Metric(
                "settling_time",
                "s",
                "from the start of the change until |y error| stays below the tolerance; none without success",
                lambda run: settling_time(run, self.tolerances.lateral),
            ),
        )

    def settings(self, speed: float) -> Path:
        early, late = (0.5, 1.5) if self.change_start is None else (self.change_start, self.change_start)
        return Path(
            lane_width=self.lane_width,
            road_half_width=self.road_half_width,
            change_length=speed * (self.duration or DURATION) if self.length is None else self.length,
            direction=DIRECTIONS[self.direction],
            earliest_start=speed * early,
            latest_start=speed * late,
            offset=0.3,
            heading=0.02,
        )

    def start(self, xp: Any) -> Any:
        side = xp.function(chosen_side(xp))

        def start(uniforms: Any, world: World) -> tuple[CarState, Route]:
            path = world.settings
            lateral_position = path.offset * (2.0 * uniforms[0] - 1.0)
            heading = path.heading * (2.0 * uniforms[1] - 1.0)
            range_of_starts = path.latest_start - path.earliest_start
            change_start = xp.multiply_add(range_of_starts, uniforms[2], path.earliest_start)
            direction = side(uniforms[3], path.direction)
            zero = 0.0 * uniforms[0]
            state = CarState(zero, lateral_position, heading, zero, zero, zero, zero)
            return state, Route(direction, change_start)

        return start

    def reference(self, xp: Any) -> Any:
        quintic = xp.function(quintic_path(xp))

        def reference(state: CarState, route: Route, world: World) -> Reference:
            lateral_position, slope = quintic(state.longitudinal_position, route, world)
            path = world.settings
            goal = route.direction * path.lane_width
            return Reference(lateral_position, xp.atan(slope), goal, 0.5 * goal, path.road_half_width)

        return reference

    def observe(self, xp: Any) -> Any:
        return observed_on_path(xp, self)

    def preview(self, xp: Any) -> Any:
        return path_ahead(xp, quintic_path(xp))

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        return path_entries(self, speed, front_limit, rear_limit)

    def task_state_with(self, route: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        changes = dict(numbers)
        if "change_start" in changes:
            changes["change_start"] = speed * changes["change_start"]
        return route._replace(**changes)


def overshoot(run: Run) -> float:
    """m."""
    return max(0.0, float(np.max(run.steps["direction"] * run.steps["goal_error"])))


def settling_time(run: Run, tolerance: float) -> float | None:
    """s, or None without success; `tolerance` in m."""
    if not run.success:
        return None
    unsettled = np.abs(run.steps["goal_error"]) >= tolerance
    last = float(np.max(run.steps["time"][unsettled], initial=0.0))
    return last - float(run.steps["change_start"][-1] / run.world.car.speed)


def quintic_path(xp: Any) -> Any:
    """``(lateral position [m], slope dy/dx)`` of the path at a longitudinal position; flat outside of the change."""
    rise_of = xp.function(quintic_rise(xp))

    def quintic(longitudinal_position: Any, route: Route, world: World) -> tuple[Any, Any]:
        path = world.settings
        rise, slope = rise_of((longitudinal_position - route.change_start) / path.change_length)
        width = route.direction * path.lane_width
        return width * rise, width * slope / path.change_length

    return quintic
