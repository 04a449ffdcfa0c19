"""The report on cars that nobody builds: as far as the ranges of a Vehicle go, it says something and ends."""

import json

import numpy as np
import pytest

from bicycle_env import Vehicle, analysis, report
from bicycle_env.physics.validation import RANGES
from bicycle_env.physics.vehicle import QUANTITIES
from bicycle_env.report import pictures
from bicycle_env.report.words import summary

LENGTHS = ("cg_to_front", "cg_to_rear", "front_half_track", "rear_half_track", "front_overhang", "rear_overhang")
COARSE = 31


def absurd(seed):
    """A study with every number log-uniform in its range."""
    rng = np.random.default_rng(seed)

    def drawn(low, high):
        return float(low * (high / low) ** rng.random())

    vehicle = Vehicle(
        **{name: drawn(*RANGES[quantity]) for name, quantity in QUANTITIES.items()},
        **{name: drawn(*RANGES["length"]) for name in (*LENGTHS, "body_width")},
    )
    return report.study(
        vehicle, speed=drawn(*report.SPEEDS), friction=drawn(*RANGES["friction"]), grid=COARSE, tire="fiala"
    )


def tables(study):
    """The numbers as text and as JSON."""
    return report.as_text(study), json.dumps(report.as_json(study), allow_nan=False)


@pytest.mark.parametrize("seed", range(8))
def test_the_numbers_of_an_absurd_car(seed):
    study = absurd(seed)
    study.__dict__["why_unknown"] = "not computed: a test of the other numbers"
    text, _ = tables(study)
    assert "What can be saved was not computed" in " ".join(text.split())


def test_a_car_too_fast_for_the_search_is_said_to_be():
    brick = Vehicle(
        mass=0.01,
        yaw_inertia=1e-6,
        cg_to_front=1.0,
        cg_to_rear=1.0,
        front_cornering_stiffness=1e8,
        rear_cornering_stiffness=1e8,
    )
    study = report.study(brick, speed=1.0, grid=COARSE)
    study.__dict__["recoverable"] = report.study("oversteer", grid=COARSE).recoverable
    object.__setattr__(study.recoverable, "vehicle", brick)
    _, found = tables(study)
    absent = json.loads(found)["absent"]
    assert "too short steps" in absent["lqr_share"]
    assert json.loads(found)["figures"]["lqr_share"] is None
    assert "unknown share" in summary(study)


MODEL = Vehicle(
    mass=3.0,
    yaw_inertia=0.05,
    cg_to_front=0.16,
    cg_to_rear=0.14,
    front_cornering_stiffness=150.0,
    rear_cornering_stiffness=120.0,
    name="model",
)


def test_a_model_at_a_tenth_of_the_size_at_walking_pace():
    study = report.study(MODEL, speed=0.1, grid=COARSE)
    text, found = tables(study)
    assert text.startswith("model at 0.1 m/s")
    figures = json.loads(found)["figures"]
    assert figures["is_stable"]
    assert figures["straight_share"] == figures["lqr_share"] == pytest.approx(1.0)
    assert figures["recoverable_share"] == pytest.approx(1.0)


def test_a_picture_that_cannot_be_drawn_is_left_out_and_named(tmp_path, monkeypatch):
    """The fold of this car's steady turns is lost between two roundings."""
    monkeypatch.setattr(
        pictures, "SUBJECTS", [s for s in pictures.SUBJECTS if s.name in ("root_locus", "steady_turns")]
    )
    study = absurd(0)
    study.__dict__["why_unknown"] = "not computed: a test of the pictures"
    told = []
    page = report.write(study, tmp_path, told.append).read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {"root_locus.png", "report.html"}
    assert "Handling diagram and steady turns&#x27; cannot be drawn of this car: the continuation lost" in page
    assert "cannot be drawn of this car" in told[-1]


def test_a_trajectory_that_would_take_hours_is_given_up(monkeypatch):
    monkeypatch.setattr("bicycle_env.analysis.phase_plane.MOST_EVALUATIONS", 300)
    with pytest.raises(analysis.IntractableError, match="takes more than 300 evaluations"):
        analysis.phase_portrait("oversteer", 30.0)
