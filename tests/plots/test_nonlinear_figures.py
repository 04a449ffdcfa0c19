"""Phase plane, recoverable set and steady turns: the curves are those of the analysis, for stable and unstable cars."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from bicycle_env import analysis, plots, vehicles
from bicycle_env.plots.steady_turns import draw_handling

CARS = {"oversteer": 43.0, "understeer": 30.0}
DEGREES = 180.0 / math.pi
SLOW = 0.1  # 1/s


def lines(axes, label):
    return [line for line in axes.get_lines() if line.get_label() == label]


@pytest.fixture(scope="module", params=CARS)
def drawn(request):
    """(portrait, set, figure) of a car."""
    name, speed = request.param, CARS[request.param]
    portrait = analysis.phase_portrait(name, speed, trajectories=0)
    found = analysis.recoverable_set(name, speed, grid=(41, 41))
    return portrait, found, plots.phase_plane(portrait, found, np.zeros((2, 2)), box=(0.4, 1.0))


def test_the_phase_plane_marks_steady_states_and_manifolds(drawn):
    portrait, _, figure = drawn
    axes = figure.axes[0]
    (straight,) = portrait.equilibria
    (marker,) = lines(axes, straight.kind)
    assert (marker.get_xdata()[0], marker.get_ydata()[0]) == pytest.approx((0.0, 0.0), abs=1e-9)
    manifolds = [line for line in axes.get_lines() if len(line.get_xdata()) > 1]
    assert len(manifolds) == (4 if straight.kind == "saddle" else 0)
    for line, manifold in zip(manifolds, portrait.manifolds, strict=True):
        np.testing.assert_allclose(line.get_ydata(), DEGREES * manifold.orbit.yaw_rate)
        np.testing.assert_allclose(line.get_xdata(), DEGREES * manifold.orbit.lateral_velocity / portrait.speed)


def test_the_edge_is_that_of_the_set(drawn):
    _, found, figure = drawn
    axes = figure.axes[1]
    edges = [item for item in axes.collections if list(getattr(item, "levels", ())) == [found.horizon]]
    assert len(edges) == 1
    points = np.concatenate([path.vertices for path in edges[0].get_paths()]) / DEGREES
    inner, outer = 0.97 * points, 1.03 * points
    at_top = np.abs(points[:, 1]) > 0.9 * found.yaw_rate_limit
    assert np.mean(found.contains(inner[:, 0] * found.speed, inner[:, 1])[~at_top]) > 0.9
    assert np.mean(found.contains(outer[:, 0] * found.speed, outer[:, 1])[~at_top]) < 0.35
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"edge of what can be saved", "saved by straight wheels", "box whose shares are given"} <= set(texts)


def test_a_set_with_a_lane_or_a_gain_of_another_shape_is_refused(drawn):
    portrait, found, _ = drawn
    with pytest.raises(ValueError, match="a set without a lane; this one has lane=1 m"):
        plots.phase_plane(portrait, dataclasses.replace(found, lane=1.0))
    with pytest.raises(ValueError, match=r"gain must have shape \(2, 2\)"):
        plots.phase_plane(portrait, found, np.zeros((1, 2)))


@pytest.mark.parametrize(("name", "folding"), [("oversteer", "front"), ("understeer", "rear")])
def test_steady_turns_are_the_equilibria_and_folds_are_marked(name, folding):
    speed = CARS[name]
    figure = plots.steady_turns(name, speed)
    handling, front, rear = figure.axes
    (curve,) = lines(handling, "steer angle beyond wheelbase / radius")
    diagram = analysis.handling_diagram(name)
    np.testing.assert_allclose(curve.get_xdata(), DEGREES * diagram.curves[0].slip_difference)
    np.testing.assert_allclose(curve.get_ydata(), diagram.curves[0].lateral_acceleration)

    for axes, axle in ((front, "front"), (rear, "rear")):
        folds = lines(axes, "fold: the steady turn is lost")
        assert len(folds) == (2 if axle == folding else 0)
        for turn in analysis.equilibria(name, speed, steer=(0.005, 0.0) if axle == "front" else (0.0, 0.005)):
            growth = float(np.max(turn.eigenvalues.real))
            label = "steady turn, stable" if growth < -SLOW else "sliding: both axles at their limit, hardly stable"
            label = label if growth < 0.0 else "steady turn, unstable: needs a driver"
            gaps = [
                np.hypot(line.get_xdata() - 0.005 * DEGREES, line.get_ydata() - turn.yaw_rate * DEGREES)
                for line in lines(axes, label)
            ]
            assert min(float(np.nanmin(gap)) for gap in gaps) < 1.5  # deg, deg/s: between the points of a branch


def test_a_tire_without_limit_and_one_that_falls_beyond_its_peak():
    (handling, _, _) = plots.steady_turns("understeer", 30.0, "linear").axes
    (curve,) = lines(handling, "steer angle beyond wheelbase / radius")
    assert np.max(curve.get_ydata()) == pytest.approx(10.0, abs=0.5)
    handling, car = Figure().subplots(), vehicles["understeer"]
    draw_handling(handling, analysis.handling_diagram(car, "magic_formula", 0.5), car, 30.0)
    assert len(lines(handling, "an axle beyond its peak")) == 1
    low, high = handling.get_xlim()
    assert -25.0 < low < 0.0 < high < 25.0
