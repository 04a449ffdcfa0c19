"""The numbers of a report, each with its unit, its equation and what it means; as rows for people and as JSON."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from bicycle_env import analysis
from bicycle_env.physics.vehicle import GRAVITY
from bicycle_env.report.study import BOX, LQR_SIZES, STEER_LIMITS, Study

DEGREE = math.pi / 180.0
AXLES = {"front": "front_steer", "rear": "rear_steer"}
NOT_STEADY = "none: no steady turn at exactly the critical speed"
TOO_FAST = "not computed: the fastest mode of this car needs too short steps"
STABLE = "none: stable"
UNSTABLE = "none: unstable, a deviation grows without oscillation"


class Quantity(NamedTuple):
    """One number of the report."""

    name: str
    """Its key in the JSON."""
    label: str
    value: Any
    """SI: a number, a word, True or False, a complex array, or a list of mappings."""
    unit: str = ""
    equation: str = ""
    """In Karnopp, Vehicle Stability, or "derived" from what stands there."""
    meaning: str = ""
    also: str = ""
    """The same in another unit."""
    absent: str = ""
    """What an infinite or undefined value means."""
    digits: int = 4
    """That are known of it."""

    @property
    def is_absent(self) -> bool:
        """Whether the value is infinite or undefined."""
        return isinstance(self.value, float) and not math.isfinite(self.value)


class Group(NamedTuple):
    """Rows under one heading."""

    title: str
    rows: tuple[Quantity, ...]


def groups(study: Study) -> tuple[Group, ...]:
    """All numbers of a report."""
    return (
        Group("Balance of the car", _balance(study)),
        Group("Straight running at this speed", _straight_running(study)),
        Group("Steady response to one axle", _gains(study)),
        Group("Zeros of the response to one axle", _zeros(study)),
        Group("At the limit of grip", _limits(study)),
        Group("What can be saved", _recovery(study)),
    )


def _balance(study: Study) -> tuple[Quantity, ...]:
    car = study.vehicle
    critical, characteristic = analysis.critical_speed(car), analysis.characteristic_speed(car)
    gradient, tangent = analysis.understeer_gradient(car), analysis.tangent_speed(car)
    return (
        Quantity("classification", "balance", analysis.classification(car), "", "(6.15), (6.16)", "b Cr against a Cf"),
        Quantity(
            "understeer_gradient",
            "understeer gradient K",
            gradient,
            "rad/(m/s²)",
            "derived",
            "front road-wheel angle that a turn needs beyond wheelbase / radius, per lateral acceleration; "
            "positive: understeer",
            f"{gradient * GRAVITY / DEGREE:.3g} deg/g",
        ),
        Quantity(
            "static_margin",
            "static margin (negative: understeer; SAE J670: positive)",
            analysis.static_margin(car),
            "of the wheelbase",
            "derived",
            "how far the neutral steer point lies ahead of the centre of mass; negative: behind it, understeer; "
            "SAE J670 gives it the opposite sign",
        ),
        Quantity(
            "critical_speed",
            "critical speed",
            critical,
            "m/s",
            "(6.17)",
            "straight running is unstable above it",
            _kmh(critical),
            "none: stable at every speed, because the car does not oversteer",
        ),
        Quantity(
            "characteristic_speed",
            "characteristic speed",
            characteristic,
            "m/s",
            "derived",
            "the yaw-rate gain is half of a neutral car's here, and largest",
            _kmh(characteristic),
            "none: the car does not understeer",
        ),
        Quantity(
            "tangent_speed",
            "tangent speed",
            tangent,
            "m/s",
            "section IV",
            "the steady sideslip of a turn changes sign; above it sideslip answers front steer the wrong way first",
            _kmh(tangent),
        ),
        Quantity("front_axle_load", "front axle load", car.front_axle_load, "N", "", "static, m g b/(a+b)"),
        Quantity("rear_axle_load", "rear axle load", car.rear_axle_load, "N", "", "static, m g a/(a+b)"),
    )


def _straight_running(study: Study) -> tuple[Quantity, ...]:
    car, speed = study.vehicle, study.speed
    found, modes = analysis.stability(car, speed), analysis.modes(car, speed)
    return (
        Quantity(
            "speed_ratio",
            "speed / critical speed",
            found.speed_ratio if math.isfinite(found.critical_speed) else math.nan,
            "",
            "(6.17)",
            "above 1: unstable",
            absent="none: no critical speed",
        ),
        Quantity(
            "stability_criterion",
            "stability criterion",
            analysis.stability_criterion(car, speed),
            "N² s²",
            "(6.14)",
            "(a+b)² Cf Cr/U² + m (b Cr - a Cf): positive is stable",
        ),
        Quantity("is_stable", "stable", analysis.is_stable(car, speed), "", "(6.13), (6.14)", "without steering"),
        Quantity("eigenvalues", "eigenvalues", found.eigenvalues, "1/s", "(6.27)", "a positive real part grows"),
        Quantity(
            "natural_frequency",
            "natural frequency",
            modes.natural_frequency,
            "rad/s",
            "(6.27)",
            "of the two modes as one second-order system",
            f"{modes.natural_frequency / (2.0 * math.pi):.3g} Hz",
            UNSTABLE,
        ),
        Quantity(
            "damping_ratio",
            "damping ratio",
            modes.damping_ratio,
            "",
            "(6.27)",
            "above 1: no oscillation",
            absent=UNSTABLE,
        ),
        Quantity(
            "time_to_double",
            "time to double",
            modes.time_to_double,
            "s",
            "(6.27)",
            "in which the fastest growing deviation doubles without steering",
            absent=STABLE,
        ),
    )


def _gains(study: Study) -> tuple[Quantity, ...]:
    outputs = {
        "yaw_rate": ("yaw rate", "1/s", 1.0, "deg/s per deg"),
        "lateral_acceleration": ("lateral acceleration", "(m/s²)/rad", DEGREE, "m/s² per deg"),
        "sideslip": ("sideslip", "rad/rad", 1.0, "deg per deg"),
    }
    meaning = "steady value per constant angle"
    if not analysis.is_stable(study.vehicle, study.speed):
        meaning += ", of a turn that is unstable"
    rows = []
    for axle, steer in AXLES.items():
        for output, (label, unit, factor, also) in outputs.items():
            gain = (
                math.nan
                if study.is_at_critical_speed
                else analysis.steady_state_gain(study.vehicle, study.speed, steer, output)
            )
            rows.append(
                Quantity(
                    f"{output}_gain_{axle}",
                    f"{label} per {axle} steer",
                    gain,
                    unit,
                    "(6.24)",
                    meaning,
                    f"{factor * gain:.3g} {also}",
                    NOT_STEADY,
                )
            )
    return tuple(rows)


def _zeros(study: Study) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(
            f"{output}_zeros_{axle}",
            f"{output.replace('_', ' ')} to {axle} steer",
            analysis.zeros(study.vehicle, study.speed, steer, output),
            "1/s",
            "section IV",
            "minimum phase"
            if analysis.is_minimum_phase(study.vehicle, study.speed, steer, output)
            else "one in the right half-plane: starts the wrong way",
        )
        for axle, steer in AXLES.items()
        for output in ("yaw_rate", "lateral_acceleration", "sideslip")
    )


def _limits(study: Study) -> tuple[Quantity, ...]:
    handling = study.handling
    largest = handling.largest_lateral_acceleration
    ends = {
        "plows": "the front axle slides first: the car plows straight on",
        "spins": "the rear axle slides first: the car spins",
        "neutral": "both axles slide together",
    }
    steady = [
        {"kind": turn.kind, "sideslip": turn.sideslip, "yaw_rate": turn.yaw_rate, "is_stable": turn.is_stable}
        for turn in study.equilibria
    ]
    return (
        Quantity(
            "largest_lateral_acceleration",
            "largest steady lateral acceleration",
            largest,
            "m/s²",
            "(6.18), (6.19)",
            "of a turn in which neither axle is beyond its peak",
            f"{largest / GRAVITY:.3g} g",
            "none: the linear tire has no limit",
        ),
        Quantity("limit", "at the limit", handling.limit, "", "", ends.get(handling.limit, "")),
        Quantity(
            "equilibria",
            "steady states with straight wheels",
            steady,
            "",
            "(6.18), (6.19)",
            "straight running, and turns in which the tires hold the car without steering",
        ),
    )


def _recovery(study: Study) -> tuple[Quantity, ...]:
    shares = study.shares
    box = f"|sideslip| <= {BOX[0] / DEGREE:.0f} deg, |yaw rate| <= {BOX[1] / DEGREE:.0f} deg/s"
    limits = f"at most {STEER_LIMITS[0] / DEGREE:.1f} deg of front and {STEER_LIMITS[1] / DEGREE:.1f} deg of rear steer"
    cells: tuple[float, ...] = (math.nan, math.nan)
    horizon = "some time"
    if not study.why_unknown:
        horizon, cells = f"{study.recoverable.horizon:g} s", study.recoverable.resolution
    return (
        Quantity(
            "recoverable_share",
            "states that can be saved",
            shares["recoverable"],
            "",
            "",
            f"share of {box} from which SOME steering, {limits}, brings the car back within {horizon}",
            f"{100 * shares['recoverable']:.0f} %",
            study.why_unknown or TOO_FAST,
            digits=2,
        ),
        Quantity(
            "lqr_share",
            "states that LQR saves",
            shares["lqr"],
            "",
            "",
            "the same share for a clipped linear regulator of sideslip and yaw rate, in whose cost "
            f"{LQR_SIZES[0] / DEGREE:.1f} deg and {LQR_SIZES[1] / DEGREE:.0f} deg/s weigh as much as full steer",
            f"{100 * shares['lqr']:.0f} %",
            study.why_unknown or TOO_FAST,
            digits=2,
        ),
        Quantity(
            "straight_share",
            "states that straight wheels save",
            shares["straight"],
            "",
            "",
            "the same share without any steering",
            f"{100 * shares['straight']:.0f} %",
            study.why_unknown or TOO_FAST,
            digits=2,
        ),
        Quantity(
            "recoverable_resolution",
            "cell of the grid",
            [{"lateral_velocity": finite(cells[0]), "yaw_rate": finite(cells[1])}],
            "m/s, rad/s",
            "",
            "the edge of the set is known to about one cell",
        ),
    )


def as_json(study: Study) -> dict[str, Any]:
    """The report for machines: SI units; None where a value is infinite or undefined, with the reason in "absent"."""
    rows = [row for group in groups(study) for row in group.rows]
    return {
        "vehicle": {**dataclasses.asdict(study.vehicle), "name": study.name},
        "speed": study.speed,
        "tire": study.tire.name,
        "friction": study.friction,
        "figures": {row.name: _plain(row.value) for row in rows},
        "units": {row.name: row.unit for row in rows if row.unit},
        "absent": {row.name: row.absent for row in rows if row.is_absent},
    }


def finite(value: Any) -> Any:
    """None for an infinite or undefined number, which JSON has no word for; anything else as it is."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [{"real": float(entry.real), "imaginary": float(entry.imag)} for entry in value]
    return finite(value)


def _kmh(speed: float) -> str:
    return f"{3.6 * speed:.0f} km/h"
