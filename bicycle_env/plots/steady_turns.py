"""Steady turns of the car on saturating tires: handling diagram, and turns against the angle of one axle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bicycle_env.analysis.branches import EquilibriumBranch, equilibrium_branches
from bicycle_env.analysis.handling import HandlingDiagram, handling_diagram
from bicycle_env.analysis.stability import understeer_gradient
from bicycle_env.physics import tires
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.validation import checked_speed
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.plots import style
from bicycle_env.plots.style import BLACK, BLUE, GREEN, GREY, ORANGE, RED, dress

STEER_SHOWN = (0.035, 0.2)  # rad: the least and the most
WIDEST = 25.0  # deg: small angles
SLOW = 0.1  # 1/s: a turn that draws near by less than this is no turn that a driver would call stable
KINDS = (
    (GREEN, "-", "steady turn, stable"),
    (GREY, "-.", "sliding: both axles at their limit, hardly stable"),
    (RED, "--", "steady turn, unstable: needs a driver"),
)
LINEAR_SHOWN = 10.0  # m/s^2: how far the diagram of a tire without limit is drawn


def steady_turns(vehicle: str | Vehicle, speed: float, tire: str | tires.Tire = "fiala", friction: float = 1.0) -> Any:
    """The handling diagram, and every steady turn at this speed against the angle of the front and of the rear axle.

    Raises:
        ValueError, TypeError: a bad value; a linear tire at the critical speed.
        ModuleNotFoundError: matplotlib is missing.
    """
    vehicle, speed, tire = resolve_vehicle(vehicle), checked_speed(speed), tires.resolve(tire)
    figure = style.new_figure(14, 5.8, "")
    left, middle, right = figure.subplots(1, 3)
    diagram = handling_diagram(vehicle, tire=tire, friction=friction)
    draw_handling(left, diagram, vehicle, speed)
    needed = 1.6 * float(np.max(np.abs(diagram.steer_at_speed(speed))))
    limit = min(max(needed, STEER_SHOWN[0]), STEER_SHOWN[1])
    for axes, axle in ((middle, "front_steer"), (right, "rear_steer")):
        branches = equilibrium_branches(vehicle, speed, input=axle, tire=tire, friction=friction, steer_limit=limit)
        draw_branches(axes, branches, axle)
    handles = {
        handle.get_label(): handle for axes in (left, middle, right) for handle in axes.get_legend_handles_labels()[0]
    }
    style.legend_below(figure, list(handles.values()), columns=4)
    return figure


def draw_handling(axes: Any, diagram: HandlingDiagram, vehicle: Vehicle, speed: float) -> None:
    """Lateral acceleration against the steer angle beyond wheelbase / radius, and the whole angle at one speed."""
    main = diagram.curves[0]
    endless = math.isinf(diagram.largest_lateral_acceleration)
    shown = main.lateral_acceleration <= (LINEAR_SHOWN if endless else math.inf)
    y = main.lateral_acceleration[shown]
    for angle, look, label in (
        (understeer_gradient(vehicle) * y, {"color": BLACK, "linestyle": ":"}, "linear car: K x lateral acceleration"),
        (main.slip_difference[shown], {"color": BLUE}, "steer angle beyond wheelbase / radius"),
        (diagram.steer_at_speed(speed)[shown], {"color": ORANGE, "linestyle": "-."}, "whole steer angle at this speed"),
    ):
        axes.plot(np.degrees(angle), y, label=label, **look)
    for k, curve in enumerate(diagram.curves[1:]):
        label = "" if k else "an axle beyond its peak"
        axes.plot(np.degrees(curve.slip_difference), curve.lateral_acceleration, color=GREY, linewidth=1, label=label)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    angles = np.degrees(
        np.concatenate([main.slip_difference[shown], diagram.steer_at_speed(speed)[shown], [-0.01, 0.01]])
    )
    low, high = np.clip([np.min(angles), np.max(angles)], -WIDEST, WIDEST)
    pad = 0.1 * (high - low)
    dress(
        axes,
        xlim=(low - pad, high + pad),
        xlabel="front steer angle [deg]",
        ylabel="lateral acceleration [m/s$^2$]",
        title="handling diagram",
    )


def draw_branches(axes: Any, branches: tuple[EquilibriumBranch, ...], axle: str) -> None:
    """Yaw rate of all steady turns against one axle's steer: stable, barely so, or unstable; the fold marked."""
    for branch in branches:
        steer, yaw_rate = np.degrees(getattr(branch, axle)), np.degrees(branch.yaw_rate)
        slow = branch.is_stable & (np.max(branch.eigenvalues.real, axis=1) > -SLOW)
        kinds = np.where(branch.is_stable, np.where(slow, 1, 0), 2)
        for kind, (color, line, label) in enumerate(KINDS):
            shown = np.where(kinds == kind, yaw_rate, np.nan)
            # A run of one kind reaches the next kind's first point, so that the curve has no gap.
            edge = np.flatnonzero(np.diff(kinds) != 0)
            edge = edge[(kinds[edge] == kind) | (kinds[edge + 1] == kind)]
            if kind > 0:
                shown[edge], shown[edge + 1] = yaw_rate[edge], yaw_rate[edge + 1]
            if np.any(np.isfinite(shown)):
                axes.plot(steer, shown, color=color, linestyle=line, label=label)
        for found in branch.bifurcations:
            if found.kind == "fold":
                axes.plot(
                    np.degrees(getattr(found, axle)),
                    np.degrees(found.equilibrium.yaw_rate),
                    "o",
                    color=BLACK,
                    markerfacecolor="white",
                    markeredgewidth=2,
                    zorder=4,
                    label="fold: the steady turn is lost",
                )
    style.cross_hair(axes)
    dress(
        axes,
        xlabel=f"{axle.replace('_', ' ')} angle [deg]",
        ylabel="yaw rate [deg/s]",
        title=f"steady turns by {axle.removesuffix('_steer')} steer at this speed",
    )
