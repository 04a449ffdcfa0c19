"""The linear car as figures: eigenvalues against speed, stability map, frequency responses of both axles."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.analysis.stability import critical_speed, eigenvalues, state_matrix, static_margin
from bicycle_env.analysis.transfer_functions import INPUTS, transfer_function
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import RANGES, checked_speed
from bicycle_env.physics.vehicle import UnitWarning, Vehicle
from bicycle_env.plots import style
from bicycle_env.plots.style import BLACK, BLUE, GREY, RED, dress

Array = NDArray[np.float64]
AXLES = {"front_steer": "front axle steered", "rear_steer": "rear axle steered"}
RESPONSES = {
    "yaw_rate": "yaw rate [deg/s per deg]",
    "lateral_acceleration": "lateral acceleration\n[m/s$^2$ per deg]",
    "sideslip": "sideslip [deg per deg]",
}
FREQUENCIES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # Hz: labelled; the axis begins at half the first
HERE = {"marker": "*", "markersize": 15, "color": BLACK, "markeredgecolor": "white", "linestyle": "none", "zorder": 5}
"""How this car at this speed is marked."""


def top_speed(vehicle: Vehicle, speed: float) -> float:
    """Where the axis of speeds ends, m/s: beyond the car's speed, and beyond its critical speed if that is near."""
    critical = critical_speed(vehicle)
    return max(60.0, 1.35 * speed, 1.35 * critical if critical < 2.5 * speed else 0.0)


def root_locus(vehicle: str | Vehicle, speed: float) -> Any:
    """Real and imaginary parts of both eigenvalues against speed, and their path in the complex plane.

    Raises ValueError or TypeError for a bad vehicle or speed, ModuleNotFoundError if matplotlib is missing.
    """
    vehicle, speed = resolve_vehicle(vehicle), checked_speed(speed)
    speeds = np.geomspace(min(10.0, 0.5 * speed), top_speed(vehicle, speed), 600)
    values = np.array([_sorted(eigenvalues(vehicle, float(u))) for u in speeds])
    here, critical = _sorted(eigenvalues(vehicle, speed)), critical_speed(vehicle)
    figure = style.new_figure(12, 5.6, "Eigenvalues of straight running")
    parts: dict[str, tuple[Any, str]] = {"R": (np.real, "real part [1/s]")}
    if np.any(values.imag):  # else there is no oscillation to be shown
        parts["I"] = (np.imag, "imaginary part [rad/s]")
    axes = figure.subplot_mosaic("RL;IL" if "I" in parts else "RL", width_ratios=[1, 1.1])
    for key, (part, name) in parts.items():
        for k, line in enumerate((BLUE, RED)):
            axes[key].plot(speeds, part(values[:, k]), color=line, linestyle=("-", "--")[k])
        axes[key].plot([speed, speed], part(here), **HERE)
        axes[key].axvline(speed, color=BLACK, linewidth=1.0)
        if math.isfinite(critical):
            axes[key].axvline(critical, color=RED, linewidth=1.2, linestyle=":")
        dress(axes[key], ylabel=name, xlim=(speeds[0], speeds[-1]))
        low, high = axes[key].get_ylim()
        axes[key].set_ylim(min(low, -1.0), max(high, 1.0))
    axes["R"].set_title("growth (above zero, grey: unstable) or decay")
    if "I" in parts:
        axes["I"].set_title("oscillation")
    axes["I" if "I" in parts else "R"].set_xlabel("speed [m/s]")
    axes["R"].axhspan(0.0, axes["R"].get_ylim()[1], color=GREY, alpha=0.25, linewidth=0)

    plane = axes["L"]
    for k in (0, 1):
        points = plane.scatter(values[:, k].real, values[:, k].imag, c=speeds, s=6, cmap="viridis_r")
    figure.colorbar(points, ax=plane, label="speed [m/s]")
    _label_speeds(plane, vehicle, [u for u in range(10, 200, 10) if speeds[0] <= u <= speeds[-1]])
    handles = plane.plot(here.real, here.imag, label=f"this speed, {speed:.1f} m/s", **HERE)
    if speeds[0] < critical < speeds[-1]:
        ring = {"color": RED, "markersize": 12, "markerfacecolor": "none", "markeredgewidth": 2}
        handles += plane.plot(0.0, 0.0, "o", **ring, label=f"critical speed, {critical:.1f} m/s")
    right = max(1.0, 1.3 * float(np.max(values.real)))
    plane.axvspan(0.0, right, color=GREY, alpha=0.25, linewidth=0)
    largest = 1.3 * max(2.0, float(np.max(values.imag)))
    dress(
        plane, xlabel="real part [1/s]", ylabel="imaginary part [rad/s]", xlim=(None, right), ylim=(-largest, largest)
    )
    plane.set_title("root locus (at the dots: the speed in m/s)")
    plane.legend(handles=handles, loc="lower left")
    return figure


def stability_map(vehicle: str | Vehicle, speed: float) -> Any:
    """Which cars are stable at which speed, if the centre of mass or the balance of the tires moves; the car marked.

    Raises as :func:`root_locus`.
    """
    vehicle, speed = resolve_vehicle(vehicle), checked_speed(speed)
    total = vehicle.front_cornering_stiffness + vehicle.rear_cornering_stiffness
    length = vehicle.wheelbase

    def changed(quantity: str, **values: float) -> Vehicle:
        inside: dict[str, Any] = {
            name: min(max(value, RANGES[quantity][0]), RANGES[quantity][1]) for name, value in values.items()
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnitWarning)  # what the tires of the others are is no mistake of the user's
            return dataclasses.replace(vehicle, **inside)

    def with_cg(share: float) -> Vehicle:
        return changed("length", cg_to_front=share * length, cg_to_rear=(1.0 - share) * length)

    def with_rear(share: float) -> Vehicle:
        front, rear = (1.0 - share) * total, share * total
        return changed("cornering_stiffness", front_cornering_stiffness=front, rear_cornering_stiffness=rear)

    cg, rear = vehicle.cg_to_front / length, vehicle.rear_cornering_stiffness / total
    figure = style.new_figure(12, 5.2, "Stability of straight running")
    left, right = figure.subplots(1, 2, sharey=True)
    _map(left, with_cg, cg, rear, vehicle, speed)
    _map(right, with_rear, rear, cg, vehicle, speed)
    left.set(
        xlabel="centre of mass behind the front axle [% of wheelbase]",
        ylabel="speed [m/s]",
        title="if the centre of mass moves",
    )
    handles = dress(
        right,
        xlabel="rear axle's share of the cornering stiffness [%]",
        title="if the balance of the tires changes",
    ).get_legend_handles_labels()[0]
    style.legend_below(figure, handles)
    return figure


def bode(vehicle: str | Vehicle, speed: float) -> Any:
    """Gain and phase of yaw rate, lateral acceleration and sideslip: the front axle steered, beside the rear.

    Raises as :func:`root_locus`; ModuleNotFoundError also if python-control is missing.
    """
    vehicle, speed = resolve_vehicle(vehicle), checked_speed(speed)
    frequency = np.geomspace(0.5 * FREQUENCIES[0], FREQUENCIES[-1], 400)
    figure = style.new_figure(11, 12.5, "Frequency response to the road-wheel angle of one axle (linear model)")
    grid = figure.subplots(6, 2, sharex=True, sharey="row", height_ratios=[1.4, 1] * 3)
    for column, axle in enumerate(INPUTS):
        look = {"color": style.AXLE[axle].color, "linestyle": style.AXLE[axle].line}
        for row, (output, label) in enumerate(RESPONSES.items()):
            response = transfer_function(vehicle, speed, axle, output)(2j * np.pi * frequency)
            scale = math.pi / 180.0 if output == "lateral_acceleration" else 1.0
            gain, phase = grid[2 * row, column], grid[2 * row + 1, column]
            gain.loglog(frequency, scale * np.abs(response), **look)
            turned = np.degrees(np.unwrap(np.angle(response)))
            # A phase that begins at 180 to rounding, above or below it, begins at +180.
            phase.semilogx(frequency, turned - 360.0 * round(turned[0] / 360.0 - 0.01), **look)
            dress(gain, title="" if row else AXLES[axle], ylabel="" if column else label)
            dress(phase, ylabel="" if column else "phase [deg]", xlim=(frequency[0], frequency[-1]))
    _round_ticks(grid)
    return figure


def _round_ticks(grid: Any) -> None:
    """Plain numbers at 1, 2 and 5 on the axes of frequency and gain, quarter turns on those of phase."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullLocator

    for row in range(0, len(grid), 2):
        gain, phase = grid[row, 0].yaxis, grid[row + 1, 0].yaxis
        gain.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        gain.set_minor_locator(NullLocator())
        gain.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        phase.set_major_locator(MultipleLocator(90.0))
    grid[0, 0].set_xticks(FREQUENCIES, labels=[f"{value:g}" for value in FREQUENCIES])
    grid[0, 0].xaxis.set_minor_locator(NullLocator())
    for axes in grid[-1]:
        axes.set_xlabel("frequency [Hz]")


def _sorted(values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """By real part, a conjugate pair by imaginary part: each of the two is then one curve over the speed."""
    return values[np.lexsort((values.imag, values.real))]


def _label_speeds(plane: Any, vehicle: Vehicle, speeds: list[int]) -> None:
    """Dots at round speeds; the upper or larger eigenvalue is labelled above, the other below."""
    left, right = plane.get_xlim()
    for k, above in ((0, False), (1, True)):
        last = None
        for speed in speeds:
            value = _sorted(eigenvalues(vehicle, float(speed)))[k]
            plane.plot(value.real, value.imag, "o", color=BLACK, markersize=3.5)
            if last is None or abs(value - last) > 0.045 * (right - left):
                plane.annotate(
                    f"{speed}",
                    (value.real, value.imag),
                    xytext=(0, 7 if above else -7),
                    textcoords="offset points",
                    ha="center",
                    va="bottom" if above else "top",
                    fontsize=8,
                )
                last = value


def _map(
    axes: Any, changed: Callable[[float], Vehicle], share: float, neutral: float, vehicle: Vehicle, speed: float
) -> None:
    """One stability map over a share in (0, 1); `neutral` is where the car would be neutral."""
    low = max(0.02, min(0.3, share - 0.15, neutral - 0.15))
    high = min(0.98, max(0.7, share + 0.15, neutral + 0.15))
    shares, speeds = np.linspace(low, high, 101), np.linspace(1.0, top_speed(vehicle, speed), 61)
    cars = [changed(float(value)) for value in shares]
    growth = np.max(np.linalg.eigvals([[state_matrix(car, float(u)) for car in cars] for u in speeds]).real, axis=-1)
    percent = 100.0 * shares
    dress(axes, xlim=(percent[0], percent[-1]), ylim=(0.0, speeds[-1]))  # labels of contours turn with the scales
    fine = np.linspace(low, high, 2001)  # near the neutral line the critical speed rises steeply
    limit = np.minimum([critical_speed(changed(float(value))) for value in fine], 1e4)
    unstable = "unstable; lines: time in which a deviation doubles"
    axes.fill_between(100.0 * fine, limit, 1e4, color=GREY, alpha=0.35, linewidth=0, label=unstable)
    for doubling, height in ((2.0, 0.5), (1.0, 0.86), (0.5, 0.79), (0.25, 0.72)):
        level = math.log(2.0) / doubling
        line = axes.contour(percent, speeds, growth, levels=[level], colors=BLACK, linewidths=0.8)
        for row in (round(h * (len(speeds) - 1)) for h in (height, 0.9, 0.6, 0.4)):
            (crossed,) = np.nonzero(np.diff(np.sign(growth[row] - level)))
            if crossed.size and 7 < crossed[0] < len(percent) - 8:  # else the label would be cut off
                axes.clabel(line, fmt=f"{doubling:g} s", fontsize=8, manual=[(percent[crossed[0]], speeds[row])])
                break
    axes.plot(100.0 * fine, limit, color=RED, linewidth=2, label="critical speed (6.17)")
    axes.axvline(100.0 * neutral, color=BLUE, linestyle="--", label="neutral steer (a Cf = b Cr)")
    axes.plot(100.0 * share, speed, label="this car at this speed", **HERE)
    at_right = static_margin(cars[-1]) > 0.0
    for word, right in (("oversteer", at_right), ("understeer", not at_right)):
        axes.text(0.98 if right else 0.02, 0.02, word, transform=axes.transAxes, ha="right" if right else "left")
