"""The moving picture: which start is shown, and that it moves."""

from __future__ import annotations

import numpy as np
import pytest

from agents import moving_picture
from bicycle_env import control
from bicycle_env.optimum import Cars, Outcomes


def outcomes(success, on_road):
    count = len(success)
    return Outcomes(np.array(success, bool), np.array(on_road, bool), np.zeros(count), np.ones(count, int))


@pytest.mark.parametrize(
    ("before", "last", "place"),
    [
        (outcomes([1, 0, 0, 0], [1, 1, 1, 0]), outcomes([1, 0, 1, 1], [1, 1, 1, 1]), 3),  # ends early
        (outcomes([1, 0, 0, 1], [1, 1, 1, 1]), outcomes([1, 0, 1, 1], [1, 1, 1, 1]), 2),  # fails
        (outcomes([1, 1], [1, 1]), outcomes([0, 1], [0, 1]), 0),
    ],
)
def test_the_start_is_a_rule(before, last, place):
    assert moving_picture.chosen([before, last]) == place


@pytest.mark.exhaustive
def test_the_picture_moves_and_says_how_it_ended(tmp_path):
    image = pytest.importorskip("PIL.Image")
    plant = Cars("BicycleStab-v0", {}).plant
    policies = {"nobody": control.make("zero", plant), "LQR": control.make("lqr", plant)}
    caption = moving_picture.show("BicycleStab-v0", {}, policies, [3, 4, 5], tmp_path / "run.gif")
    assert caption.startswith("start ")
    assert "nobody - saves 0 % of 3" in caption
    with image.open(tmp_path / "run.gif") as picture:
        assert picture.n_frames > 50
        first = np.asarray(picture.convert("RGB"))
        picture.seek(20)
        later = np.asarray(picture.convert("RGB"))
    assert first.shape == later.shape
    assert np.mean(first != later) > 0.001
