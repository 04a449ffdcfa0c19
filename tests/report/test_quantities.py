"""Every number of the report is the analysis function's, and every number is valid JSON."""

from __future__ import annotations

import functools
import json
import math

import numpy as np
import pytest
from combinations import only_all, some_of

from bicycle_env import Vehicle, analysis, report, vehicles
from bicycle_env.report.quantities import groups
from bicycle_env.report.study import BOX, STEER_LIMITS
from bicycle_env.report.words import in_words, summary

COARSE = 31
AXLES = {"front": "front_steer", "rear": "rear_steer"}


@functools.cache
def studied(name):
    return report.study(name, grid=COARSE)


@pytest.fixture(scope="module", params=some_of(vehicles, ["civic"]))
def study(request):
    return studied(request.param)


def plain(value):
    if isinstance(value, np.ndarray):
        return [{"real": entry.real, "imaginary": entry.imag} for entry in value]
    return value if not isinstance(value, float) or math.isfinite(value) else None


def test_the_json_holds_the_analysis(study):
    car, speed = study.vehicle, study.speed
    stability, modes = analysis.stability(car, speed), analysis.modes(car, speed)
    handling = analysis.handling_diagram(car)
    recoverable, shares = study.recoverable, study.shares
    if study.name == "oversteer":  # the others' are computed once, to save time
        recoverable = analysis.recoverable_set(car, speed, steer_limits=STEER_LIMITS, grid=(COARSE, COARSE))
        shares = {
            "recoverable": recoverable.share(*BOX),
            "lqr": recoverable.saved_share(study.lqr_gain, *BOX),
            "straight": recoverable.saved_share(np.zeros((2, 2)), *BOX),
        }
    expected = {
        "classification": analysis.classification(car),
        "understeer_gradient": analysis.understeer_gradient(car),
        "static_margin": analysis.static_margin(car),
        "critical_speed": analysis.critical_speed(car),
        "characteristic_speed": analysis.characteristic_speed(car),
        "tangent_speed": analysis.tangent_speed(car),
        "front_axle_load": car.front_axle_load,
        "rear_axle_load": car.rear_axle_load,
        "speed_ratio": speed / car.critical_speed if math.isfinite(car.critical_speed) else math.nan,
        "stability_criterion": analysis.stability_criterion(car, speed),
        "is_stable": analysis.is_stable(car, speed),
        "eigenvalues": stability.eigenvalues,
        "natural_frequency": modes.natural_frequency,
        "damping_ratio": modes.damping_ratio,
        "time_to_double": stability.time_to_double,
        **{
            f"{output}_gain_{axle}": analysis.steady_state_gain(car, speed, steer, output)
            for axle, steer in AXLES.items()
            for output in ("yaw_rate", "lateral_acceleration", "sideslip")
        },
        **{
            f"{output}_zeros_{axle}": analysis.zeros(car, speed, steer, output)
            for axle, steer in AXLES.items()
            for output in ("yaw_rate", "lateral_acceleration", "sideslip")
        },
        "largest_lateral_acceleration": handling.largest_lateral_acceleration,
        "limit": handling.limit,
        "equilibria": [
            {"kind": turn.kind, "sideslip": turn.sideslip, "yaw_rate": turn.yaw_rate, "is_stable": turn.is_stable}
            for turn in analysis.equilibria(car, speed)
        ],
        **{f"{name}_share": share for name, share in shares.items()},
        "recoverable_resolution": [
            {"lateral_velocity": recoverable.resolution[0], "yaw_rate": recoverable.resolution[1]}
        ],
    }
    content = report.as_json(study)
    assert content["figures"] == {name: plain(value) for name, value in expected.items()}
    assert content["vehicle"]["mass"] == car.mass
    assert content["speed"] == speed
    assert (content["tire"], content["friction"]) == ("fiala", 1.0)


def test_null_has_a_reason_and_only_null(study):
    content = json.loads(json.dumps(report.as_json(study), allow_nan=False))
    assert {name for name, value in content["figures"].items() if value is None} == set(content["absent"])
    assert all(content["absent"].values())
    assert set(content["units"]) <= set(content["figures"])


def test_numbers_have_units_and_equations(study):
    without_unit = {"classification", "is_stable", "limit", "equilibria", "speed_ratio", "damping_ratio"}
    without_unit |= {"recoverable_share", "lqr_share", "straight_share"}
    rows = [row for group in groups(study) for row in group.rows]
    assert {row.name for row in rows if not row.unit} == without_unit
    computed_here = {"front_axle_load", "rear_axle_load", "limit", "recoverable_share", "lqr_share", "straight_share"}
    assert {row.name for row in rows if not row.equation} == computed_here | {"recoverable_resolution"}
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        assert "nan" not in in_words(row)
        assert "inf" not in in_words(row)


def test_linear_control_saves_what_can_be_saved_at_most(study):
    shares = study.shares
    assert shares["straight"] < shares["recoverable"]
    assert shares["lqr"] < shares["recoverable"] + 0.08  # this grid's cells are wide
    assert np.all(
        np.linalg.eigvals(
            analysis.state_matrix(study.vehicle, study.speed)
            - analysis.input_matrix(study.vehicle, study.speed) @ study.lqr_gain
        ).real
        < 0.0
    )


def test_degrees_per_g():
    (row,) = [row for group in groups(studied("civic")) for row in group.rows if row.name == "understeer_gradient"]
    assert row.also == "5.5 deg/g"  # the source: 9.6 deg/g in front, 4.1 deg/g behind


@pytest.mark.parametrize(
    ("speed", "ratio", "expected"),
    [(None, None, 1.2 * vehicles["oversteer"].critical_speed), (40.0, None, 40.0), (None, 0.5, 18.03037976845176)],
)
def test_speed_of_a_car_with_a_critical_speed(speed, ratio, expected):
    assert report.study("oversteer", speed, ratio).speed == pytest.approx(expected)


def test_speed_of_other_cars():
    assert report.study("understeer").speed == 30.0
    assert report.study("neutral").speed == 30.0
    almost_neutral = Vehicle(
        mass=1500.0,
        yaw_inertia=2500.0,
        cg_to_front=1.4,
        cg_to_rear=1.3,
        front_cornering_stiffness=97.6e3,
        rear_cornering_stiffness=105e3,
    )
    assert almost_neutral.critical_speed > 200.0
    assert report.study(almost_neutral).speed == 30.0
    assert report.study(almost_neutral).name == "car"


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"vehicle": "overster"}, "did you mean 'oversteer'"),
        ({"vehicle": "oversteer", "speed": 0.05}, r"speed must be a finite number in \[0.1, 150\], got 0.05"),
        ({"vehicle": "oversteer", "speed": math.nan}, "speed must be"),
        ({"vehicle": "oversteer", "speed": 30.0, "speed_ratio": 1.0}, "not both"),
        ({"vehicle": "oversteer", "speed_ratio": 5.0}, r"speed_ratio x critical speed must be .* \[0.1, 150\]"),
        ({"vehicle": "oversteer", "speed_ratio": -1.0}, "speed_ratio must be"),
        ({"vehicle": "civic", "speed_ratio": 1.2}, "no critical speed; give speed in m/s"),
        ({"vehicle": "civic", "tire": "fila"}, "did you mean 'fiala'"),
        ({"vehicle": "civic", "friction": 0.0}, "friction must be"),
        ({"vehicle": "civic", "grid": 3}, r"grid must be a whole number in \[31, 1001\]"),
    ],
)
def test_bad_input_is_named(keywords, text):
    with pytest.raises(ValueError, match=text):
        report.study(**keywords)


@pytest.mark.exhaustive
def test_exactly_at_the_critical_speed():
    study = report.study("oversteer", speed_ratio=1.0, grid=COARSE)
    content = report.as_json(study)
    assert content["figures"]["yaw_rate_gain_front"] is None
    assert "critical speed" in content["absent"]["yaw_rate_gain_front"]
    json.dumps(content, allow_nan=False)
    assert "critical" in report.as_text(study)
    with pytest.raises(ValueError, match="speed must differ from the critical speed 36"):
        report.study("oversteer", speed_ratio=1.0, tire="linear")


def test_the_linear_tire_has_no_limit():
    content = report.as_json(report.study("understeer", tire="linear", grid=COARSE))
    assert content["figures"]["largest_lateral_acceleration"] is None
    assert content["absent"]["largest_lateral_acceleration"] == "none: the linear tire has no limit"


@pytest.mark.parametrize(
    ("name", "speed", "text"),
    [
        ("oversteer", 43.0, "above 36.1 m/s (130 km/h) it is unstable: here a deviation eventually doubles every 1.1"),
        only_all("oversteer", 20.0, "becomes unstable above 36.1 m/s (130 km/h) and is stable here"),
        only_all("neutral", 30.0, "This car is neutral; it is stable at every speed"),
        only_all("civic", 30.0, "This car understeers; it is stable at every speed"),
    ],
)
def test_the_summary_fits_the_car(name, speed, text):
    study = report.study(name, speed, grid=COARSE)
    study.__dict__["shares"] = dict.fromkeys(("recoverable", "lqr", "straight"), 1.0)  # take long, and are not asked
    assert text in summary(study)


@pytest.mark.exhaustive
def test_just_at_the_critical_speed_it_is_not_stable():
    study = report.study("oversteer", speed_ratio=1.0, grid=COARSE)
    assert "becomes unstable above 36.1 m/s (130 km/h) and is just at this limit here" in summary(study)
