"""Numbers in words, for people."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bicycle_env import analysis
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.plots.style import speed_in_words
from bicycle_env.report.quantities import DEGREE, Quantity
from bicycle_env.report.study import BOX, Study

KINDS = {"oversteer": "oversteers", "neutral": "is neutral", "understeer": "understeers"}
_LIMIT = "it becomes unstable above {critical:.1f} m/s ({critical_kmh:.0f} km/h) and is "
STABILITY = {
    "always": "it is stable at every speed",
    "stable": f"{_LIMIT}stable here",
    "limit": f"{_LIMIT}just at this limit here",
    "unstable": "above {critical:.1f} m/s ({critical_kmh:.0f} km/h) it is unstable: here a deviation eventually "
    "doubles every {doubling:.2f} s unless somebody steers",
}
"""What is said of straight running; speeds in m/s and km/h, times in s."""
METRES = "{speed:.1f} m/s = "
"""Before ``plots.speed_in_words``."""


def title(study: Study) -> str:
    """The report's heading."""
    return f"{study.name} at {both_units(study.vehicle, study.speed)}"


def both_units(vehicle: Vehicle, speed: float) -> str:
    """``"43.3 m/s = 156 km/h = 1.2 x the critical speed"``."""
    return METRES.format(speed=speed) + speed_in_words(vehicle, speed)


def summary(study: Study) -> str:
    """The report in some sentences."""
    begin = f"{stability_in_words(study.vehicle, study.speed)} "
    if study.why_unknown:
        return f"{begin}What can be saved was {study.why_unknown}."
    shares = {
        name: "an unknown share" if math.isnan(share) else f"{100 * share:.0f} %"
        for name, share in study.shares.items()
    }
    coarse = study.shares["recoverable"] < max(study.shares["lqr"], study.shares["straight"])
    return (
        f"{begin}On {study.tire.name} tires and friction {study.friction:g}, from "
        f"{shares['recoverable']} of the states with up to {BOX[0] / DEGREE:.0f} deg of sideslip and "
        f"{BOX[1] / DEGREE:.0f} deg/s of yaw rate some steering brings it back; a linear regulator saves "
        f"{shares['lqr']}, straight wheels {shares['straight']}."
        + (" (Some steering cannot save fewer: the grid is too coarse for this car, see --grid.)" if coarse else "")
    )


def stability_in_words(car: Vehicle, speed: float) -> str:
    """How a car steers, and whether it is stable at a speed [m/s], in a sentence."""
    critical, doubling = car.critical_speed, analysis.modes(car, speed).time_to_double
    if math.isinf(critical):
        word = "always"
    elif math.isinf(doubling):
        word = "stable" if analysis.is_stable(car, speed) else "limit"
    else:
        word = "unstable"
    stability = STABILITY[word].format(critical=critical, critical_kmh=3.6 * critical, doubling=doubling)
    return f"This car {KINDS[analysis.classification(car)]}; {stability}."


def in_words(row: Quantity) -> str:
    """The value with its units; for one that is infinite or undefined, what that means."""
    if row.is_absent:
        return row.absent
    return f"{_value(row.value, row.digits)} {row.unit}".rstrip() + (f" ({row.also})" if row.also else "")


def _value(value: Any, digits: int) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return "; ".join(_mapping(entry) for entry in value) or "none"
    if isinstance(value, np.ndarray):
        return _complex(value)
    return value if isinstance(value, str) else _number(value, digits)


def _number(value: float, digits: int) -> str:
    """So many significant digits; thousands are grouped and not written as powers of ten."""
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.{digits}g}"


def _mapping(entry: dict[str, Any]) -> str:
    if "kind" in entry:
        sideslip, yaw_rate = entry["sideslip"] / DEGREE, entry["yaw_rate"] / DEGREE
        return f"{entry['kind']} at sideslip {sideslip:.1f} deg, yaw rate {yaw_rate:.1f} deg/s"
    return " x ".join("unknown" if value is None else f"{value:.3g}" for value in entry.values())


def _complex(values: Any) -> str:
    words = []
    for value in values:
        real = f"{value.real:.3g}"
        if value.imag > 0.0:
            words.append(f"{real} ± {value.imag:.3g} i")
        elif value.imag == 0.0:
            words.append(real)
    return ", ".join(words) or "none"
