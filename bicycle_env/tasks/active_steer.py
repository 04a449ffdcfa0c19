"""The active-steer task: a driver turns the front wheels suddenly, and the rear wheels keep the car from spinning.

The manoeuvre and the figures are those of FMVSS 126 (49 CFR 571.126), a sine with dwell at the road wheels.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.model import Model
from bicycle_env.physics.records import merged, record_of, replaced
from bicycle_env.physics.validation import check_fields, choice
from bicycle_env.tasks import fmvss126, rewards, twin
from bicycle_env.tasks.draws import check_draws, drawn, draws_of, draws_record
from bicycle_env.tasks.drivers import MOST_ANGLE, SineWithDwell
from bicycle_env.tasks.ends import LEFT, RUNNING, SPUN, Limits, spun
from bicycle_env.tasks.episode import EpisodeState, Reference, World
from bicycle_env.tasks.fmvss126 import (
    BEGIN,
    DISPLACEMENT_TIME,
    ROUNDING,
    SECOND_TIME,
    asked_yaw_rate,
    judgement,
    since_finish,
)
from bicycle_env.tasks.metrics import SHARED, Metric, Run
from bicycle_env.tasks.path import SIDES
from bicycle_env.tasks.steadiness import Steadiness, reference_yaw_rate
from bicycle_env.tasks.task import Entry, History, Law, Task

RANGES = {
    "relative_speed": (0.5, 2.0),
    "relative_friction": (0.05, 2.0),
    "amplitude": (0.0, MOST_ANGLE),
    "frequency": (0.3, 3.0),
    "dwell": (0.0, 2.0),
}
"""What is drawn, and within which numbers."""
OBSERVED = ("measured", "state")


class Manoeuvre(NamedTuple):
    """What an episode has of its own; what is drawn comes first."""

    side: Any
    """To which the driver turns first: +1 left, -1 right."""
    speed: Any
    """m/s, the true one."""
    relative_friction: Any
    """The true friction per the nominal one."""
    amplitude: Any
    """rad, of the road wheels."""
    frequency: Any
    """Hz."""
    dwell: Any
    """s at the second peak."""
    driver_command: Any
    """rad, for the control step that comes."""
    front_correction: Any
    """rad, what the last action added to it."""
    peak_yaw_rate: Any
    """rad/s, the largest |yaw rate| since `PEAK_FROM`."""
    yaw_rate_missed: Any
    """1 once the yaw rate was too large, else 0."""
    displacement_missed: Any
    """1 once the displacement was too small, else 0."""
    lateral_acceleration: Any
    """V' + U r, m/s^2, the mean over the last control step."""
    lateral_velocity_before: Any
    heading_before: Any
    twin_lateral_position: Any
    """Of the car with straight rear wheels, as the next four: until `DISPLACEMENT_TIME`."""
    twin_heading: Any
    twin_lateral_velocity: Any
    twin_yaw_rate: Any
    twin_front_steer: Any
    """Until the end: where the driver alone has turned the wheels."""


CHANGED = Manoeuvre._fields[
    Manoeuvre._fields.index("driver_command") : Manoeuvre._fields.index("twin_lateral_position")
]
"""By a control step, the twin apart."""
Script = record_of("Script", ("amplitude", "frequency", "dwell", "start"))
"""What the law of ``SineWithDwell`` asks for."""


@dataclasses.dataclass(frozen=True)
class ActiveSteer(Task):
    """A sine with dwell at the front wheels; the yaw rate has to die out after it, and the car to go where it was sent.

    The ranges are those of uniform draws, one for each episode: speed and friction per the nominal ones, rad, Hz, s.
    """

    name = "active_steer"
    episode_steps = 300
    TaskState = Manoeuvre
    Settings = draws_record(RANGES)
    uniforms = 1 + len(RANGES)
    ends = ("spun", "left_area")
    limits = Limits(heading=1.5)
    road_half_width = 100.0
    settled_seconds = 0.0  # what has failed is remembered: the last step tells
    rewards = {  # noqa: RUF012 (a constant)
        "default": Steadiness(),
        "quadratic": rewards.Quadratic(heading_cost=0.1, lateral_velocity_cost=0.01, yaw_rate_cost=10.0),
    }
    defaults = {"steer": "rear"}  # noqa: RUF012 (a constant)
    levels = {  # noqa: RUF012 (a constant)
        "easy": {
            "relative_speed": (0.65, 0.836),
            "relative_friction": (0.8, 1.0),
            "amplitude": (0.0349, 0.1047),
        },
        "medium": {},
        "hard": {
            "frequency": (0.45, 1.0),
            "dwell": (0.0, 0.8),
            "sensors": {"noise": {"lateral_acceleration": 0.2, "yaw_rate": 0.01}},
        },
    }
    flipped = (
        *("side", "driver_command", "front_correction", "lateral_acceleration"),
        *("lateral_velocity_before", "heading_before", *twin.NAMES),
    )
    options = {"direction": SIDES, **RANGES}  # noqa: RUF012 (a constant)
    companions = twin.NAMES
    hidden = ("relative_friction", "amplitude", "frequency", "dwell")
    forfeits = ("yaw_rate_missed", "displacement_missed")

    direction: str = "random"
    relative_speed: tuple[float, float] = (0.88, 1.0)
    relative_friction: tuple[float, float] = (0.5, 1.0)
    amplitude: tuple[float, float] = (0.0175, 0.0873)
    """1 to 5 degrees."""
    frequency: tuple[float, float] = (0.7, 0.7)
    dwell: tuple[float, float] = (0.5, 0.5)
    observed: str = "measured"

    def __post_init__(self) -> None:
        check_draws(self, RANGES)
        check_fields(self, choice, observed=(OBSERVED,))
        judged = BEGIN + 1.0 / self.frequency[0] + self.dwell[1] + SECOND_TIME
        if judged > 6.0:
            raise ValueError(
                f"frequency and dwell must leave time to judge, {BEGIN:g} + 1 / frequency + dwell + {SECOND_TIME:g} "
                f"<= 6 s, got {judged:.3g} s"
            )

    @property
    def undriven(self) -> ActiveSteer:
        return dataclasses.replace(self, amplitude=(0.0, 0.0))

    @property
    def metrics(self) -> tuple[Metric, ...]:
        return METRICS

    @property
    def histories(self) -> tuple[History, ...]:
        return (
            History("front_steer", "driver", lambda own, time, car: own.driver_command),
            History("yaw_rate", "reference", lambda own, time, car: reference_yaw_rate(NUMPY)(own, car)),
            History("yaw_rate", "allowed", lambda own, time, car: asked_yaw_rate(own, time), "-."),
            History("yaw_rate", "", lambda own, time, car: -asked_yaw_rate(own, time), "-."),
        )

    def settings(self, speed: float) -> Any:
        return draws_of(self, RANGES)

    def start(self, xp: Any) -> Law:
        placed, draw = xp.function(_placed(xp)), drawn(xp, RANGES, 0)

        def start(uniforms: Any, world: World) -> tuple[CarState, Manoeuvre]:
            zero = 0.0 * uniforms[0]
            side, speed, friction, amplitude, frequency, dwell = draw(uniforms, world.settings)
            own = Manoeuvre(
                *(side, world.car.speed * speed, friction, amplitude, frequency, dwell),
                *(zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero),
            )
            state = CarState(zero, zero, zero, zero, zero, zero, zero)
            return state, placed(state, own)

        return start

    def refilled(self, xp: Any) -> Law:
        placed = xp.function(_placed(xp))

        def refilled(state: CarState, episode: EpisodeState, world: World) -> Manoeuvre:
            own: Manoeuvre = placed(state, episode.task_state)
            return own

        return refilled

    def reference(self, xp: Any) -> Law:
        half_width = self.road_half_width

        def reference(state: CarState, own: Manoeuvre, world: World) -> Reference:
            zero = 0.0 * state.lateral_position
            return Reference(zero, zero, zero, zero, half_width)

        return reference

    def observe(self, xp: Any) -> Law:
        since = xp.function(since_finish)

        def measured(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, ...]:
            own = episode.task_state
            late = since(own, episode.steps * world.rules.control_timestep)
            return (
                state.yaw_rate,
                own.lateral_acceleration,
                state.front_steer,
                state.rear_steer,
                own.driver_command,
                own.speed,
                own.front_correction,
                episode.rear_steer_command,
                own.peak_yaw_rate,
                xp.where(late > -ROUNDING, 1.0 + 0.0 * late, 0.0),
            )

        law = xp.function(measured)

        def with_sideslip(state: CarState, episode: EpisodeState, world: World) -> tuple[Any, ...]:
            seen: tuple[Any, ...] = law(state, episode, world)
            return (*seen, state.lateral_velocity / episode.task_state.speed)

        return measured if self.observed == "measured" else with_sideslip

    def entries(self, speed: float, front_limit: float, rear_limit: float) -> tuple[Entry, ...]:
        measured = (
            Entry("yaw_rate", "rad/s", 0.5, 10.0, ""),
            Entry("lateral_acceleration", "m/s^2", 10.0, 10.0, "V' + U r, the mean over the last control step"),
            Entry("front_steer", "rad", front_limit, 1.0, "road-wheel angle; scale: the actuator's angle limit"),
            Entry("rear_steer", "rad", rear_limit, 1.0, "road-wheel angle; scale: the actuator's angle limit"),
            Entry("driver_command", "rad", front_limit, 1.0, "what the driver wants of the front wheels now"),
            Entry("speed", "m/s", speed, 10.0, "the true one; scale: the nominal one", 1.0),
            Entry("front_correction", "rad", front_limit, 1.0, "last action at the front"),
            Entry("rear_steer_command", "rad", rear_limit, 1.0, "last action at the rear"),
            Entry("peak_yaw_rate", "rad/s", 0.5, 10.0, "largest |yaw rate| so far, as judged", 1.0),
            Entry("driver_finished", "", 1.0, 1.0, "1 once the driver has finished, else 0", 1.0),
        )
        sideslip = Entry("sideslip", "rad", 0.2, 10.0, "of the centre of mass")
        return measured if self.observed == "measured" else (*measured, sideslip)

    def command(self, xp: Any) -> Law:
        def command(state: CarState, episode: EpisodeState, action: Any, world: World) -> tuple[Any, Any]:
            car = world.car
            front = xp.multiply_add(action[0], car.front_angle_limit, episode.task_state.driver_command)
            return front, action[1] * car.rear_angle_limit

        return command

    def conditions(self, xp: Any) -> Law:
        changed = replaced(xp, CarParameters, ("speed", "front_peak_force", "rear_peak_force"))

        def conditions(state: CarState, episode: EpisodeState, time: Any, world: World) -> CarParameters:
            own, car = episode.task_state, world.car
            grip = own.relative_friction
            there: CarParameters = changed(car, own.speed, grip * car.front_peak_force, grip * car.rear_peak_force)
            return there

        return conditions

    def accompany(self, xp: Any, model: Model) -> Law:
        return twin.advance(xp, model, BEGIN + DISPLACEMENT_TIME - ROUNDING)

    def remember(self, xp: Any) -> Law:
        judge, changed = xp.function(judgement(xp)), replaced(xp, Manoeuvre, CHANGED)
        script = xp.function(SineWithDwell().law(xp, self.reference(xp)))

        def remember(state: CarState, episode: EpisodeState, action: Any, world: World) -> Manoeuvre:
            own, car, step = episode.task_state, world.car, world.rules.control_timestep
            peak, fast, short = judge(state, episode, world)
            numbers = Script(own.amplitude, own.frequency, own.dwell, BEGIN)
            wanted = own.side * script(state, own, (episode.steps + 1.0) * step, numbers, world)
            most, one = car.front_angle_limit, 1.0 + 0.0 * peak
            faster = state.lateral_velocity - own.lateral_velocity_before
            felt = xp.multiply_add(own.speed, state.heading - own.heading_before, faster) / step
            after: Manoeuvre = changed(
                own,
                xp.maximum(xp.minimum(wanted, most), -most),
                action[0] * most,
                peak,
                xp.where(fast, one, own.yaw_rate_missed),
                xp.where(short, one, own.displacement_missed),
                felt,
                state.lateral_velocity,
                state.heading,
            )
            return after

        return remember

    def end(self, xp: Any) -> Law:
        has_spun, half_width = xp.function(spun(xp, self.limits)), self.road_half_width

        def end(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
            left = abs(state.lateral_position) > half_width
            return xp.where(has_spun(state, episode.task_state.speed), SPUN, xp.where(left, LEFT, RUNNING))

        return end

    def success(self, xp: Any) -> Law:
        since = xp.function(since_finish)

        def success(state: CarState, reference: Reference, episode: EpisodeState, world: World) -> Any:
            own = episode.task_state
            late = since(own, episode.steps * world.rules.control_timestep)
            missed = own.yaw_rate_missed + own.displacement_missed
            return (late > SECOND_TIME - ROUNDING) & (missed < 0.5) & (own.amplitude > 0.0)

        return success

    def task_state_with(self, own: Any, numbers: Mapping[str, Any], speed: Any) -> Any:
        changes = dict(numbers)
        if "direction" in changes:
            changes["side"] = changes.pop("direction")
        if "relative_speed" in changes:
            changes["speed"] = speed * changes.pop("relative_speed")
        return own._replace(**changes)


def _placed(xp: Any) -> Law:
    """``placed(state, own) -> Manoeuvre`` at a start: the twin in the same place; V' is not known."""
    beside = xp.function(twin.placed(xp))
    measured = replaced(xp, Manoeuvre, ("lateral_acceleration", "lateral_velocity_before", "heading_before"))
    join = merged(xp, Manoeuvre, twin.NAMES)

    def placed(state: CarState, own: Manoeuvre) -> Any:
        felt = measured(own, own.speed * state.yaw_rate, state.lateral_velocity, state.heading)
        return join(felt, beside(state))

    return placed


def _own(run: Run) -> Manoeuvre:
    return Manoeuvre(*(run.steps[name] for name in Manoeuvre._fields))


def _yaw_rate_error(run: Run) -> float:
    error = run.steps["yaw_rate"] - reference_yaw_rate(NUMPY)(_own(run), run.world.car)
    return float(np.sqrt(np.mean(error**2)))


def _spun(run: Run) -> float:
    limits = ActiveSteer.limits
    last = {name: abs(float(run.steps[name][-1])) for name in ("sideslip", "yaw_rate", "heading")}
    return float(
        last["sideslip"] > limits.sideslip or last["yaw_rate"] > limits.yaw_rate or last["heading"] > limits.heading
    )


METRICS = (
    *(metric for metric in SHARED if metric.name not in ("cost", "largest_tracking_error")),
    Metric("yaw_rate_error", "rad/s", "root of the mean of (yaw rate - reference)^2", _yaw_rate_error),
    Metric("spun", "", "1 where the car has spun, else 0", _spun),
    *fmvss126.METRICS,
)
