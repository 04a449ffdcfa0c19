"""The linear figures show the numbers of the analysis, for cars of every kind."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from bicycle_env import analysis, plots, vehicles

CARS = ("oversteer", "neutral", "understeer")


def speed_of(name):
    critical = analysis.critical_speed(vehicles[name])
    return 1.2 * critical if math.isfinite(critical) else 30.0


def axes_by_label(figure, label):
    return [axes for axes in figure.axes if label in axes.get_ylabel()]


@pytest.mark.parametrize("name", CARS)
def test_root_locus_shows_the_eigenvalues(name):
    speed = speed_of(name)
    figure = plots.root_locus(name, speed)
    real, *others = axes_by_label(figure, "part")
    assert len(others) == (2 if name == "understeer" else 1)  # where nothing oscillates no panel is empty
    lines = real.get_lines()[:2]
    for k in (0, 300, 599):
        at = float(lines[0].get_xdata()[k])
        drawn = sorted(line.get_ydata()[k] for line in lines)
        np.testing.assert_allclose(drawn, np.sort(analysis.eigenvalues(vehicles[name], at).real), rtol=1e-12)
    texts = [text.get_text() for axes in figure.axes if axes.get_legend() for text in axes.get_legend().get_texts()]
    assert f"this speed, {speed:.1f} m/s" in texts
    assert any("critical speed" in text for text in texts) == (name == "oversteer")


def test_each_branch_of_the_root_locus_is_continuous():
    """mendes' pair of real eigenvalues becomes complex with rising speed: no line jumps from one to the other."""
    figure = plots.root_locus("mendes", 30.0)
    real, _, imaginary = axes_by_label(figure, "part")
    assert np.max(np.abs(imaginary.get_lines()[0].get_ydata())) > 0.5
    for axes in (real, imaginary):
        for line in axes.get_lines()[:2]:
            y = line.get_ydata()
            assert np.max(np.abs(np.diff(y))) < 0.12 * np.ptp(np.concatenate([y, [0.0, 1.0]]))


@pytest.mark.parametrize("name", CARS)
def test_the_map_draws_the_critical_speed_and_marks_the_car(name):
    car, speed = vehicles[name], speed_of(name)
    left, right = plots.stability_map(name, speed).axes[:2]
    shares = {
        left: car.cg_to_front / car.wheelbase,
        right: car.rear_cornering_stiffness / (car.front_cornering_stiffness + car.rear_cornering_stiffness),
    }
    for axes, share in shares.items():
        lines = {line.get_label(): line for line in axes.get_lines()}
        star = lines["this car at this speed"]
        assert star.get_xdata()[0] == pytest.approx(100 * share)
        assert star.get_ydata()[0] == speed
        limit = lines["critical speed (6.17)"]
        finite = limit.get_ydata() < 1000.0
        assert 0 < finite.sum() < finite.size
        if name == "oversteer":
            at = np.interp(100 * share, limit.get_xdata()[finite], limit.get_ydata()[finite])
            assert at == pytest.approx(analysis.critical_speed(car), rel=1e-4)


@pytest.mark.parametrize("name", CARS)
def test_bode_starts_at_the_steady_gain(name):
    """At 0.05 Hz a stable car is within a few percent of its steady state; the phase tells the sign."""
    speed = 20.0  # below every critical speed here
    figure = plots.bode(name, speed)
    outputs = ("yaw_rate", "lateral_acceleration", "sideslip")
    for k, (output, unit) in enumerate(zip(outputs, (1.0, math.pi / 180.0, 1.0), strict=True)):
        for column, axle in enumerate(("front_steer", "rear_steer")):
            gain, phase = (figure.axes[4 * k + 2 * row + column].get_lines()[0].get_ydata()[0] for row in (0, 1))
            steady = analysis.steady_state_gain(vehicles[name], speed, axle, output)
            assert gain == pytest.approx(unit * abs(steady), rel=0.05)
            assert math.copysign(1.0, math.cos(math.radians(phase))) == math.copysign(1.0, steady)
            assert abs(phase) < 200.0


@pytest.mark.parametrize("name", CARS)
def test_rear_steering_starts_the_wrong_way(name):
    car, speed = vehicles[name], speed_of(name)
    (zero,) = [
        value.real for value in analysis.zeros(car, speed, "rear_steer", "lateral_acceleration") if value.real > 0
    ]
    found = plots.wrong_way(name, speed, "rear_steer", "lateral_acceleration")
    assert found.zero == zero
    run = plots.step_response(name, speed, "rear_steer", 2.0 * found.duration, tire="linear")
    early = run["time"] < found.duration - 2e-3
    assert np.all(run["lateral_acceleration"][early] > 0.0)
    assert np.all(run["lateral_acceleration"][run["time"] > found.duration + 2e-3] < 0.0)
    assert plots.wrong_way(name, speed, "rear_steer", "yaw_rate") is None
    assert plots.wrong_way(name, speed, "front_steer", "lateral_acceleration") is None


def test_front_steering_turns_the_body_the_wrong_way_above_the_tangent_speed_only():
    tangent = analysis.tangent_speed(vehicles["understeer"])
    assert plots.wrong_way("understeer", 1.5 * tangent, "front_steer", "sideslip") is not None
    assert plots.wrong_way("understeer", 0.8 * tangent, "front_steer", "sideslip") is None


@pytest.mark.parametrize(("name", "tire", "curves"), [("oversteer", "fiala", 2), ("understeer", "linear", 1)])
def test_step_responses_show_both_tires_and_the_wrong_way(name, tire, curves):
    figure = plots.step_responses(name, speed_of(name), tire)
    assert isinstance(figure, Figure)
    front, rear = figure.axes[0], figure.axes[1]
    assert sum("tire" in str(line.get_label()) for line in rear.get_lines()) == curves
    assert not front.child_axes
    (inset,) = rear.child_axes
    assert "starts the wrong way" in inset.get_title()


@pytest.mark.parametrize("draw", [plots.root_locus, plots.stability_map, plots.bode, plots.step_responses])
def test_bad_input_is_named(draw):
    with pytest.raises(ValueError, match=r"vehicle must be one of .* did you mean 'oversteer'"):
        draw("overster", 30.0)
    with pytest.raises(ValueError, match="speed must be"):
        draw("oversteer", -1.0)


@pytest.mark.filterwarnings("ignore::bicycle_env.physics.vehicle.UnitWarning")
def test_a_car_with_a_very_fast_mode():
    light = dataclasses.replace(vehicles["oversteer"], yaw_inertia=1.0)
    found = plots.wrong_way(light, 43.0, "rear_steer", "lateral_acceleration")
    assert found is not None
    assert found.duration == pytest.approx(1.0 / found.zero, rel=0.05)
