"""The phase plane of sideslip and yaw rate: motion with straight wheels, and what steering can save."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bicycle_env.analysis.phase_plane import PhasePortrait
from bicycle_env.analysis.recovery import RecoverableSet
from bicycle_env.plots import style
from bicycle_env.plots.style import BLACK, BLUE, GREEN, GREY, ORANGE, RED, dress

SIDESLIP, YAW_RATE = "sideslip [deg]", "yaw rate [deg/s]"
KINDS: dict[str, dict[str, Any]] = {
    "stable": {"marker": "o", "color": GREEN, "markersize": 10},
    "saddle": {"marker": "X", "color": RED, "markersize": 10},
    "other": {"marker": "s", "color": ORANGE, "markersize": 8},
}


def phase_plane(
    portrait: PhasePortrait,
    recoverable: RecoverableSet,
    gain: ArrayLike | None = None,
    box: tuple[float, float] | None = None,
) -> Any:
    """The motion of the unsteered car, beside the states that steering can save, on the same axes.

    Args:
        portrait: of ``analysis.phase_portrait``.
        recoverable: of ``analysis.recoverable_set``, without a lane.
        gain: K (2, 2) of a linear feedback steer = -K (lateral velocity, yaw rate) whose saved states are outlined.
        box: half-widths (sideslip, yaw rate), rad and rad/s, of a box to outline and to give the shares of.

    Raises:
        ValueError, TypeError: a gain of another shape, a set with a lane.
        ModuleNotFoundError: matplotlib is missing.
    """
    figure = style.new_figure(13, 7, "")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    handles = draw_portrait(left, portrait) + draw_recoverable(right, recoverable, gain, box)
    style.legend_below(figure, handles, columns=4)
    limits = np.degrees([portrait.lateral_velocity[-1] / portrait.speed, portrait.yaw_rate[-1]])
    left.set(xlim=(-limits[0], limits[0]), ylim=(-limits[1], limits[1]), ylabel=YAW_RATE)
    return figure


def draw_portrait(axes: Any, portrait: PhasePortrait) -> list[Any]:
    """Streamlines, steady states, and the manifolds of the saddles; handles for a legend."""
    sideslip = np.degrees(portrait.lateral_velocity / portrait.speed)
    axes.streamplot(
        sideslip,
        np.degrees(portrait.yaw_rate),
        np.degrees(portrait.lateral_velocity_rate / portrait.speed),
        np.degrees(portrait.yaw_acceleration),
        color=GREY,
        density=1.3,
        linewidth=0.7,
        arrowsize=0.8,
    )
    labels = {"stable": "stable manifold of a saddle: a border", "unstable": "unstable manifold: the way out"}
    looks: dict[str, dict[str, Any]] = {
        "stable": {"color": BLUE, "linewidth": 2.2},
        "unstable": {"color": RED, "linestyle": "--"},
    }
    for manifold in portrait.manifolds:
        orbit = manifold.orbit
        axes.plot(
            np.degrees(orbit.lateral_velocity / portrait.speed),
            np.degrees(orbit.yaw_rate),
            label=labels.pop(manifold.stability, None),
            **looks[manifold.stability],
        )
    named: set[str] = set()
    for state in portrait.equilibria:
        kind = "stable" if state.is_stable else "saddle" if state.kind == "saddle" else "other"
        axes.plot(
            math.degrees(state.sideslip),
            math.degrees(state.yaw_rate),
            linestyle="none",
            markeredgecolor="white",
            zorder=5,
            label=None if state.kind in named else state.kind,
            **KINDS[kind],
        )
        named.add(state.kind)
    dress(axes, xlabel=SIDESLIP, title="nobody steers: how the car moves")
    handles: list[Any] = axes.get_legend_handles_labels()[0]
    return handles


def draw_recoverable(
    axes: Any, recoverable: RecoverableSet, gain: ArrayLike | None = None, box: tuple[float, float] | None = None
) -> list[Any]:
    """The least time to recovery inside the set, its edge, and what feedback and straight wheels save; handles."""
    if recoverable.lane is not None:
        raise ValueError(f"the phase plane shows a set without a lane; this one has lane={recoverable.lane:g} m")
    sideslip, yaw_rate = np.degrees(recoverable.lateral_velocity / recoverable.speed), np.degrees(recoverable.yaw_rate)
    # Beyond the horizon too, so that the edge, where the least time is the horizon, is drawn between the nodes.
    time = -recoverable.horizon * np.log1p(-np.minimum(recoverable.value, 1.0 - 1e-9)).T
    levels = recoverable.horizon * np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0])
    axes.set_facecolor("#dddddd")
    filled = axes.contourf(sideslip, yaw_rate, time, levels=levels, cmap="GnBu")
    axes.figure.colorbar(filled, ax=axes, label="least time to recovery [s]; grey: lost", format="%g")
    handles = _outline(axes, sideslip, yaw_rate, time, recoverable.horizon, BLACK, "-", "edge of what can be saved")
    if gain is not None:
        label = "saved by LQR (clipped linear feedback)"
        handles += _outline(axes, sideslip, yaw_rate, recoverable.saved_by(gain).T, 0.5, RED, "--", label)
    alone = recoverable.saved_by(np.zeros((2, 2))).T
    handles += _outline(axes, sideslip, yaw_rate, alone, 0.5, BLUE, ":", "saved by straight wheels")
    if box is not None:
        x, y = np.degrees(box)
        handles += axes.plot(
            [-x, x, x, -x, -x], [-y, -y, y, y, -y], color=ORANGE, linestyle="-.", label="box whose shares are given"
        )
    dress(axes, xlabel=SIDESLIP, title="with steering: what can be saved at all")
    return handles


def _outline(axes: Any, x: Any, y: Any, values: Any, level: float, color: str, line: str, label: str) -> list[Any]:
    """One contour of values on a grid (x, y), and its handle for the legend; nothing where there is none."""
    from matplotlib.lines import Line2D

    values = np.asarray(values, dtype=np.float64)
    if not np.min(values) < level < np.max(values):
        return []
    axes.contour(x, y, values, levels=[level], colors=[color], linestyles=[line], linewidths=[2.0])
    return [Line2D([], [], color=color, linestyle=line, linewidth=2.0, label=label)]
