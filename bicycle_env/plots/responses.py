"""Step responses, front and rear axle beside each other, with a start the wrong way marked."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.stability import eigenvalues
from bicycle_env.analysis.transfer_functions import INPUTS, zeros
from bicycle_env.physics import tires
from bicycle_env.physics.linear_single_track import fastest_rate
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import checked_speed, number, positive
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.plots import style
from bicycle_env.plots.linear import AXLES
from bicycle_env.plots.style import BLACK, GREY, YELLOW, dress
from bicycle_env.simulation import simulate

Array = NDArray[np.float64]
DEGREE = math.pi / 180.0
SHOWN = {
    "lateral_acceleration": ("lateral acceleration [m/s$^2$]", 1.0),
    "yaw_rate": ("yaw rate [deg/s]", 1.0 / DEGREE),
    "sideslip": ("sideslip [deg]", 1.0 / DEGREE),
    "lateral_position": ("lateral position [m]", 1.0),
}


class WrongWay(NamedTuple):
    """A response of the linear model that first goes one way, then the other; see :func:`wrong_way`."""

    zero: float
    """The right half-plane zero, 1/s."""
    duration: float
    """s from the step until the response changes sign."""


def wrong_way(vehicle: str | Vehicle, speed: float, input: str, output: str, duration: float = 3.0) -> WrongWay | None:
    """How the linear response to a step of one axle starts the wrong way; None where it does not within `duration`.

    Raises ValueError or TypeError for a bad vehicle, speed, input or output.
    """
    vehicle = resolve_vehicle(vehicle)
    right = [value.real for value in zeros(vehicle, speed, input, output) if value.real > 0.0 and value.imag == 0.0]
    if not right:
        return None
    run = step_response(vehicle, speed, input, positive("duration", duration), tire="linear")
    changes = np.flatnonzero(np.diff(np.sign(run[output][1:])))
    return WrongWay(float(min(right)), float(run["time"][1 + changes[0]])) if changes.size else None


def step_response(
    vehicle: str | Vehicle,
    speed: float,
    input: str,
    duration: float,
    tire: str | tires.Tire = "fiala",
    friction: float = 1.0,
    steer: float = DEGREE,
) -> dict[str, Array]:
    """Simulate straight running after a step of one road-wheel angle [rad]; as ``bicycle_env.simulate``."""
    vehicle = resolve_vehicle(vehicle)
    angles = (steer, 0.0) if input == "front_steer" else (0.0, steer)
    timestep = min(2e-3, 1.0 / fastest_rate(vehicle, speed))  # one time constant of the fastest mode
    return simulate(vehicle, speed, angles, duration, tire=tire, friction=friction, timestep=timestep)


def suitable_duration(vehicle: Vehicle, speed: float) -> float:
    """How long a step response is worth looking at, s: until it has settled, or an instability has grown."""
    slowest = float(np.max(eigenvalues(vehicle, speed).real))
    return min(3.0, max(1.0, 4.0 / abs(slowest))) if slowest < 0.0 else min(3.0, max(1.0, 0.8 / max(slowest, 1e-3)))


def step_responses(
    vehicle: str | Vehicle,
    speed: float,
    tire: str | tires.Tire = "fiala",
    friction: float = 1.0,
    steer: float = DEGREE,
) -> Any:
    """Lateral acceleration, yaw rate, sideslip and lateral position after a step of the front or the rear axle.

    Args:
        vehicle: a preset's name or a Vehicle.
        speed: m/s.
        tire: drawn beside the linear tire.
        friction: road friction coefficient.
        steer: the step, rad, in (0, 0.5].

    Raises:
        ValueError, TypeError: a bad value.
        ModuleNotFoundError: matplotlib is missing.
    """
    vehicle, speed, tire = resolve_vehicle(vehicle), checked_speed(speed), tires.resolve(tire)
    steer = number("steer", steer, high=0.5, above=0.0)
    duration = suitable_duration(vehicle, speed)
    laws: dict[str, tires.Tire] = {"linear tire (the book's model)": tires.Linear()}
    if tire != tires.Linear():
        laws[f"{type(tire).__name__} tire, friction {friction:g}"] = tire
    figure = style.new_figure(11, 10.5, f"Response to a step of {math.degrees(steer):g} deg of one axle's road wheels")
    grid = figure.subplots(len(SHOWN), 2, sharex=True, sharey="row")
    handles, largest = [], dict.fromkeys(SHOWN, 0.0)
    for column, axle in enumerate(INPUTS):
        runs = {
            label: step_response(vehicle, speed, axle, duration, law, friction, steer) for label, law in laws.items()
        }
        for row, (output, (name, factor)) in enumerate(SHOWN.items()):
            axes = grid[row, column]
            curves = [(run["time"], factor * run[output]) for run in runs.values()]
            looks = [{"color": style.AXLE[axle].color}, {"color": BLACK, "linestyle": "--"}]
            for (time, values), look, label in zip(curves, looks, runs, strict=False):
                axes.plot(time, values, **look, label=label)
            largest[output] = max(largest[output], *(float(np.max(np.abs(values))) for _, values in curves))
            found = wrong_way(vehicle, speed, axle, output, duration)
            if found is not None:
                _mark_wrong_way(axes, found, *curves[0], style.AXLE[axle].color)
            axes.axhline(0.0, color=GREY, linewidth=0.8)
            dress(axes, xlim=(0.0, duration), title="" if row else AXLES[axle], ylabel="" if column else name)
        grid[-1, column].set_xlabel("time [s]")
        handles += grid[0, column].get_legend_handles_labels()[0][: 1 + column * len(laws)]
    for row, limit in zip(grid, largest.values(), strict=True):
        row[0].set_ylim(-1.08 * limit, 1.08 * limit)
    style.legend_below(figure, handles)
    return figure


def _mark_wrong_way(axes: Any, found: WrongWay, time: Array, values: Array, color: str) -> None:
    """Shade the start and enlarge it above zero: the response goes up first, then down, so there is room."""
    early = time <= 1.5 * found.duration
    inset = axes.inset_axes((0.46, 0.62, 0.5, 0.24))
    inset.plot(time[early], values[early], color=color)
    inset.axhline(0.0, color=GREY, linewidth=0.8)
    inset.tick_params(labelsize=7)
    inset.locator_params(nbins=4)
    inset.set(xlim=(0.0, time[early][-1]))
    milliseconds = 1000.0 * found.duration
    inset.set_title(
        f"starts the wrong way, for {milliseconds:.0f} ms (enlarged):\nzero at +{found.zero:.3g} 1/s", fontsize=8, pad=3
    )
    for shaded in (axes, inset):
        shaded.axvspan(0.0, found.duration, color=YELLOW, alpha=0.6, linewidth=0)
