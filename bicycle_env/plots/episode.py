"""One's own runs as a figure: path on the road, time histories, phase plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bicycle_env.physics.validation import number, positive
from bicycle_env.plots import style
from bicycle_env.plots.runs import Columns, Road, columns
from bicycle_env.plots.style import BLACK, GREY, ORANGE, PATCHES, LineStyle, dress, line_style

AREA = 50.0
"""m: the edges of what is wider are not drawn."""
HISTORIES = {
    "sideslip": "sideslip [deg]",
    "yaw_rate": "yaw rate [deg/s]",
    "front_steer": "front steer [deg]",
    "rear_steer": "rear steer [deg]",
}


def episode(
    *runs: Any,
    labels: Sequence[str] | None = None,
    env: Any = None,
    speed: float | None = None,
    lane: tuple[float, float] | None = None,
    ends: Sequence[str] | None = None,
    duration: float | None = None,
    styles: Sequence[LineStyle] | None = None,
    title: str | None = None,
) -> Any:
    """Draw one or several runs: path on the road, time histories of the car and of both axles, phase plane.

    Args:
        runs: each a mapping of arrays, as ``bicycle_env.simulate`` returns it; or a list of the states of an episode,
            ``env.unwrapped.state`` after ``reset`` and after every ``step``. Needed are time, longitudinal_position,
            lateral_position, lateral_velocity, yaw_rate, front_steer, rear_steer (SI units, rad).
        labels: one per run, for the legend.
        env: the environment that the runs come from: gives the speed, the edges of its lane and the path to follow.
        speed: m/s, where the runs hold no sideslip and there is no `env`.
        lane: lateral positions (right, left) of the lane's edges, m; by default those of `env`, if there is one.
        ends: one per run: why it ended, such as ``info["end"]``; "" for one that did not.
        duration: s, how much of the time histories is shown; by default all.
        styles: one ``LineStyle(color, line)`` per run.
        title: of the figure; by default the speed, where it is known.

    Returns:
        A ``matplotlib.figure.Figure``; ``plots.save(figure, path)`` writes it.

    Raises:
        ValueError, TypeError: no run, a run without a needed name, or one label, end or style too many or too few.
        ModuleNotFoundError: matplotlib is missing.
    """
    if not runs:
        raise ValueError("give at least one run")
    for name, given in {"labels": labels, "ends": ends, "styles": styles}.items():
        if given is not None and (isinstance(given, str) or len(given) != len(runs)):
            raise ValueError(f"{name} must hold one entry for each of the {len(runs)} runs, got {given!r}")
    plant = None if env is None else getattr(env, "unwrapped", env)
    if plant is not None:
        speed = plant.speed if speed is None else speed
        title = f"At {style.speed_in_words(plant.vehicle, plant.speed)}" if title is None else title
    driven = [columns(run, f"runs[{k}]", speed) for k, run in enumerate(runs)]
    roads = [] if plant is None else _roads(plant, driven)
    edges = _edges(roads) if lane is None else _checked_lane(lane)
    first = min(float(run["time"][0]) for run in driven)
    last = max(float(run["time"][-1]) for run in driven) if duration is None else positive("duration", duration)

    figure = style.new_figure(13, 7.4, title or "")
    axes = figure.subplot_mosaic("RRRRRR;AABBPP;CCDDPP", height_ratios=[1.1, 1, 1])
    handles = []
    for k, run in enumerate(driven):
        label = f"run {k + 1}" if labels is None else labels[k]
        end = ends[k] if ends is not None else ""
        if end:
            label += f": {end.replace('left_', 'left the ').replace('_', ' ')} at the cross"
        handles += _draw_run(axes, run, label, line_style(k) if styles is None else styles[k], bool(end))
    if plant is not None:
        handles += _draw_histories(axes, plant, driven) + _draw_limits(axes, plant, driven)
    handles += _draw_road(axes["R"], driven, roads, edges)
    for key, label in zip("ABCD", HISTORIES.values(), strict=True):
        dress(axes[key], xlabel="time [s]" if key in "CD" else "", ylabel=label)
        if last > first:
            axes[key].set_xlim(first, last)
    dress(
        axes["P"], xlabel=HISTORIES["sideslip"], ylabel=HISTORIES["yaw_rate"], title="Phase plane, from the circle on"
    )
    style.cross_hair(axes["P"])
    style.legend_below(figure, handles, columns=4)
    return figure


def _draw_run(axes: Any, run: Columns, label: str, drawing: LineStyle, over: bool) -> list[Any]:
    """One run in all axes; the handle for the legend."""
    look = {"color": drawing.color, "linestyle": drawing.line}
    x, y = run["longitudinal_position"], run["lateral_position"]
    sideslip, yaw_rate = np.degrees(run["sideslip"]), np.degrees(run["yaw_rate"])
    handles: list[Any] = axes["R"].plot(x, y, label=label, **look)
    for key, quantity in zip("ABCD", HISTORIES, strict=True):
        axes[key].plot(run["time"], np.degrees(run[quantity]), **look)
    axes["P"].plot(sideslip, yaw_rate, **look)
    axes["P"].plot(sideslip[0], yaw_rate[0], "o", color=drawing.color, markerfacecolor="white", zorder=3)
    if over:
        cross = {"color": BLACK, "markersize": 9, "markeredgewidth": 1.8, "zorder": 4}
        axes["R"].plot(x[-1], y[-1], "x", **cross)
        axes["P"].plot(sideslip[-1], yaw_rate[-1], "x", **cross)
    return handles


def _draw_histories(axes: Any, plant: Any, driven: list[Columns]) -> list[Any]:
    """What the task wants of the car's quantities; the handles of the first run."""
    handles: list[Any] = []
    for k, run in enumerate(driven):
        if not all(name in run for name in plant.task.TaskState._fields):
            continue
        own = plant.task.TaskState(*(run[name] for name in plant.task.TaskState._fields))
        for history in plant.task.histories:
            values = np.degrees(history.law(own, run["time"], plant.configuration.car))
            key = "ABCD"[list(HISTORIES).index(history.quantity)]
            label = f"{history.quantity.replace('_', ' ')}: {history.label}"
            drawn = axes[key].plot(run["time"], values, color=BLACK, linewidth=1.2, linestyle=history.line, label=label)
            handles += drawn if history.label and not k else []
    return handles


def _draw_limits(axes: Any, plant: Any, driven: list[Columns]) -> list[Any]:
    """How far the wheels turn, on the sides where a run comes half as far; a handle of one line."""
    handles: list[Any] = []
    for key, axle in zip("CD", ("front", "rear"), strict=True):
        limit = getattr(plant, f"{axle}_actuator").angle_limit
        for side in (1.0, -1.0):
            if max(float(np.max(side * run[f"{axle}_steer"])) for run in driven) > 0.5 * limit:
                line = axes[key].axhline(side * np.degrees(limit), color=GREY, linestyle=":", label="steering limit")
                handles = [line]
    return handles


def _roads(plant: Any, driven: list[Columns]) -> list[Road]:
    """The different roads that the runs were on; a run that does not say where its task's path was has none."""
    length = max(float(np.max(run["longitudinal_position"])) for run in driven)
    roads: dict[bytes, Road] = {}
    for run in driven:
        if all(name in run for name in plant.task.TaskState._fields):
            road = Road(plant, run, length)
            roads.setdefault(np.concatenate([road.path, *road.edges]).tobytes(), road)
    return list(roads.values())


def _checked_lane(lane: Any) -> list[Edge]:
    try:
        right, left = lane
    except (TypeError, ValueError):
        raise TypeError(f"lane must be a pair (right edge, left edge) in m, got {lane!r}") from None
    right = number("lane[0]", right)
    both = (right, number("lane[1]", left, above=right))
    return [(np.zeros(1), np.array([edge])) for edge in both]


Edge = tuple[Any, Any]
"""Places along the road and lateral positions, m."""


def _edges(roads: list[Road]) -> list[Edge]:
    """The different edges of the roads."""
    found: dict[bytes, Edge] = {}
    for road in roads:
        if np.min(road.edges[1] - road.edges[0]) > AREA:
            continue
        for edge in road.edges:
            found.setdefault((edge[:1] if np.all(edge == edge[0]) else edge).tobytes(), (road.places, edge))
    return list(found.values())


def _draw_road(axes: Any, driven: list[Columns], roads: list[Road], edges: list[Edge]) -> list[Any]:
    """Edges and paths to follow, and limits of the axes in which a car far off the road does not hide it."""
    low = min(float(np.min(run["lateral_position"])) for run in driven)
    high = max(float(np.max(run["lateral_position"])) for run in driven)
    pad = max(0.5, 0.1 * (high - low))
    low, high = low - pad, high + pad
    handles = []
    if edges:
        look = {"color": BLACK, "linewidth": 1.5, "label": "edge of the lane"}
        for places, edge in edges:
            straight = np.all(edge == edge[0])
            handles.append(axes.axhline(edge[0], **look) if straight else axes.plot(places, edge, **look)[0])
        handles = handles[:1]
        right = min(float(np.min(edge)) for _, edge in edges)
        left = max(float(np.max(edge)) for _, edge in edges)
        low = max(min(low, right - 0.4 * (left - right)), right - 2.0 * (left - right))
        high = min(max(high, left + 0.4 * (left - right)), left + 2.0 * (left - right))
    for k, road in enumerate(road for road in roads if road.has_path):
        drawn = axes.plot(road.places, road.path, ":", color=BLACK, label="path to follow")
        handles += [] if k else drawn
    of_kinds = {}
    for mark in (mark for road in roads for mark in road.marks):
        x, y = zip(*mark.points, strict=True)
        if mark.kind in PATCHES:
            (of_kinds[mark.kind],) = axes.fill(x, y, color=PATCHES[mark.kind], label=mark.kind, zorder=0)
        else:
            (of_kinds["cones"],) = axes.plot(x, y, "^", color=ORANGE, markersize=4, label="cones")
    handles += of_kinds.values()
    dress(
        axes,
        xlabel="along the road [m]",
        ylabel="lateral position [m]",
        ylim=(low, high),
        title="Path of the centre of mass (to the left is up; the lateral scale is stretched)",
    )
    return handles
