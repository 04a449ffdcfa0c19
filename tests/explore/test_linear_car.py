"""What the page says of the linear car is what analysis says: eigenvalues, the sentence, both axles' responses."""

import dataclasses
import json
import math
import shutil
import subprocess

import numpy as np
import pytest

from bicycle_env import analysis, vehicles
from bicycle_env.analysis import linear_laws
from bicycle_env.control.four_wheel_steer import yaw_rate_feedback_matrix
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.plots.responses import wrong_way
from bicycle_env.report.words import both_units, stability_in_words

NODE = shutil.which("node")
FREQUENCIES = [0.1, 1.0, 7.0]
SCRIPT = """
import { bodyOf, eigenvalues, fedBack, responses, rightZeros } from "./car.mjs";
import { speedInWords, stabilityInWords, straight } from "./car.mjs";
import { placeOf, usual } from "./choices.mjs";
import { data } from "./data.mjs";
import { placed, stepResponse, wrongWay } from "./simulation.mjs";
import * as task from "./task_linear.mjs";
import * as fs from "node:fs";
const { cars, frequencies } = JSON.parse(fs.readFileSync("cars.json"));
console.log(JSON.stringify(cars.map(({ percent, speed }) => {
  const body = bodyOf(data, { vehicle: "oversteer", ...percent }), found = straight(body, speed);
  const world = placed(task, body, speed, placeOf(data, usual(data)));
  return {
    sentence: stabilityInWords(data, found), heading: speedInWords(data, speed, found.critical_speed),
    eigenvalues: eigenvalues(found), responses: responses(body, speed, frequencies), zeros: rightZeros(body, speed),
    fed_back: [0, 0.05, 0.4].map((gain) => fedBack(body, speed, gain)),
    wrong: ["front", "rear"].map((axle) => wrongWay(stepResponse(world, axle, 0.01, 1.5))),
  };
})));
"""
PARTS = (
    *("mass", "yaw_inertia", "cg_to_front", "cg_to_rear"),
    *("front_cornering_stiffness", "rear_cornering_stiffness"),
)


def cars():
    """(vehicle, percent of the preset's values, speed): oversteering, neutral, understeering, at many speeds."""
    draws, base = np.random.default_rng(3), vehicles["oversteer"]
    found = [(base, {}, 43.3), (base, {}, 12.0)]
    for k in range(12):
        percent = {part: int(draws.integers(70, 140)) for part in PARTS}
        changes = {part: float(f"{getattr(base, part) * percent[part] / 100:.6g}") for part in PARTS}
        found.append((dataclasses.replace(base, **changes), percent, 8.0 + 5.0 * k))
    front = float(f"{0.75 * base.front_cornering_stiffness:.6g}")
    found.append((dataclasses.replace(base, front_cornering_stiffness=front), {"front_cornering_stiffness": 75}, 30.0))
    return found


@pytest.fixture(scope="module")
def said(folder):
    """[(vehicle, speed, what the page says), ...]"""
    if NODE is None:
        pytest.skip("no node here")
    known, as_preset = cars(), dict.fromkeys(PARTS, 100)
    given = [{"percent": {**as_preset, **percent}, "speed": speed} for _, percent, speed in known]
    (folder / "linear_script.mjs").write_text(SCRIPT)
    (folder / "cars.json").write_text(json.dumps({"cars": given, "frequencies": FREQUENCIES}))
    done = subprocess.run([NODE, "linear_script.mjs"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [(car, speed, found) for (car, _, speed), found in zip(known, json.loads(done.stdout), strict=True)]


def test_the_page_says_what_analysis_says(said):
    kinds = set()
    for vehicle, speed, found in said:
        kinds.add((analysis.classification(vehicle), analysis.is_stable(vehicle, speed)))
        assert found["sentence"] == stability_in_words(vehicle, speed)
        assert found["heading"] == both_units(vehicle, speed)
        values = np.sort_complex([complex(*pair) for pair in found["eigenvalues"]])
        np.testing.assert_allclose(values, np.sort_complex(analysis.eigenvalues(vehicle, speed)), rtol=1e-9)
        for gain, pairs in zip((0.0, 0.05, 0.4), found["fed_back"], strict=True):
            matrix = yaw_rate_feedback_matrix(vehicle, speed, gain)
            values = np.sort_complex([complex(*pair) for pair in pairs])
            np.testing.assert_allclose(values, np.sort_complex(np.linalg.eigvals(matrix)), rtol=1e-9)
    assert len(kinds) > 2


@pytest.mark.exhaustive
def test_the_responses_are_those_of_analysis(said):
    for vehicle, speed, found in said:
        for name, response in found["responses"].items():
            axle, _, output = name.partition("_")
            law = analysis.transfer_function(vehicle, speed, f"{axle}_steer", output)
            wanted = law(2j * np.pi * np.array(FREQUENCIES))
            turned = np.exp(1j * np.radians(response["phase"]))
            np.testing.assert_allclose(np.array(response["gain"]) * turned, wanted, rtol=1e-9)
        for axle, wrong in zip(("front", "rear"), found["wrong"], strict=True):
            input = f"{axle}_steer"
            zeros = analysis.zeros(vehicle, speed, input, "lateral_acceleration")
            assert found["zeros"][axle] == pytest.approx(max(0.0, *(z.real for z in zeros if z.imag == 0.0), 0.0))
            there = wrong_way(vehicle, speed, input, "lateral_acceleration", 1.5)
            assert wrong == pytest.approx(0.0 if there is None else there.duration, abs=4e-3)


@pytest.mark.parametrize("polynomial", [(1.0, 2.0, 1.0), (2.0, -3.0, -5.0), (1.0, 0.0, -4.0), (1.0, 1e8, 1.0)])
def test_roots_of_a_quadratic(polynomial):
    found = [real for real, imaginary in linear_laws.roots(PYTHON)(*polynomial) if imaginary == 0.0]
    assert found == sorted(found)
    a, b, c = polynomial
    product, total = found[0] * found[1], found[0] + found[1]
    assert product == pytest.approx(c / a, rel=1e-14)
    assert total == pytest.approx(-b / a, rel=1e-14, abs=1e-15)


def test_roots_that_swing():
    (x, y), (u, v) = linear_laws.roots(PYTHON)(2.0, 4.0, 10.0)
    assert (x, u) == (-1.0, -1.0)
    assert (y, v) == (-2.0, 2.0)
    assert math.hypot(x, y) ** 2 == pytest.approx(5.0)
