"""CommonRoad's vehicle parameters: the car moves as their single-track model, and what is missing is said."""

from __future__ import annotations

import re

import numpy as np
import pytest

from bicycle_env import Vehicle, analysis
from bicycle_env.physics.presets import resolve_vehicle

VEHICLE_2 = """\
# BMW 320i: parameters_vehicle2.yaml of CommonRoad's vehicle models, in part
l: 4.508
w: 1.61
steering:
  max: 1.066
  v_max: 0.4
longitudinal:
  j_max: 10.0e+3
m: 1093.2952334674046
m_s: 965.7108098804363
a: 1.1561957064
b: 1.4227170936
I_z: 1791.5995300122856
T_f: 1.38684
T_r: 1.36398
E_f: 0
"""
VEHICLE_4 = "l: 5.1\nw: 2.55\nsteering:\n  max: 0.55\na: 1.8\nb: 1.8\ntrailer:\n# length\n  l: 13.6\n"


@pytest.fixture
def written(tmp_path):
    def write(content, name="parameters_vehicle2.yaml"):
        (tmp_path / name).write_text(content, encoding="utf-8")
        return tmp_path / name

    return write


def test_the_car_moves_as_their_single_track_model(written):
    """vehicle_dynamics_st without acceleration; it writes the sideslip where the state here is U times it."""
    car, speed, g = Vehicle.read(written(VEHICLE_2)), 25.0, 9.81
    m, inertia, lf, lr = 1093.2952334674046, 1791.5995300122856, 1.1561957064, 1.4227170936
    mu, c_s = 1.0489, 21.92 / 1.0489
    base = lf + lr
    sideslip = (
        -mu / (speed * base) * (c_s * g * lf + c_s * g * lr),
        mu / (speed**2 * base) * (c_s * g * lf * lr - c_s * g * lr * lf) - 1.0,
    )
    yaw = (
        mu * m / (inertia * base) * (lr * c_s * g * lf - lf * c_s * g * lr),
        -mu * m / (speed * inertia * base) * (lf**2 * c_s * g * lr + lr**2 * c_s * g * lf),
    )
    theirs = [[sideslip[0], sideslip[1] * speed], [yaw[0] / speed, yaw[1]]]
    np.testing.assert_allclose(analysis.state_matrix(car, speed), theirs, rtol=1e-12, atol=1e-12)
    steer = mu / base * c_s * g * lr, mu * m / (inertia * base) * lf * c_s * g * lr
    np.testing.assert_allclose(analysis.input_matrix(car, speed)[:, 0], steer, rtol=1e-12)


def test_the_body_and_the_label(written):
    car = resolve_vehicle(str(written(VEHICLE_2)))
    assert car.name == "parameters_vehicle2"
    assert car.body_length == pytest.approx(4.508, rel=1e-12)
    assert car.front_overhang == car.rear_overhang
    assert (car.front_half_track, car.rear_half_track, car.body_width) == (0.69342, 0.68199, 1.61)
    assert "21.92 per rad of an axle's load" in car.source


def test_the_tire_of_the_file_counts(written):
    usual = Vehicle.read(written(VEHICLE_2))
    other = Vehicle.read(written(VEHICLE_2 + "tire:\n  p_dy1: 1.0\n  p_ky1: -10.96\n", "mine.yml"))
    assert other.front_cornering_stiffness == pytest.approx(usual.front_cornering_stiffness / 2.0)
    assert other.source.endswith("the file's tire.")


def without(name):
    return "".join(line for line in VEHICLE_2.splitlines(keepends=True) if not line.startswith(f"{name}:"))


BAD = [
    (VEHICLE_4, "missing parameters 'm' (kg), 'I_z' (kg m^2). Without a mass no force moves a car: such a file, as"),
    (without("I_z"), "missing parameter 'I_z' (kg m^2)"),
    (without("m") + "m: heavy\n", "m must be a finite number in [0.01, 1e+06], got 'heavy'"),
    (without("a") + "a:\n  x: 1\n", "a must be a finite number in [0.001, 100], got {'x': 1.0}"),
    (without("l") + "l: 2\n", "l must be a finite number in [2.58891, 100], got 2.0"),
    (VEHICLE_2 + "K_raz: 1\n", "unknown parameter of CommonRoad's 'K_raz'; did you mean 'K_ras'?"),
    (VEHICLE_2 + "tire: 1\n", "tire must be a table with p_ky1, got 1.0"),
    (VEHICLE_2 + "tire:\n  p_ky1: 21.92\n", "tire.p_ky1 must be a finite number in [-1000, -0.001], got 21.92"),
    (VEHICLE_2 + "tire: !!python/name:os.system\n", "not YAML: line 17: a value must be a number or a plain text"),
    ("# nothing" * 20_000, "must not be larger than 100000 bytes"),
]


@pytest.mark.parametrize(("content", "text"), BAD, ids=range(len(BAD)))
def test_a_mistake_is_named(written, content, text):
    path = written(content)
    with pytest.raises(ValueError, match=re.escape(text)) as caught:
        Vehicle.read(path)
    assert str(caught.value).startswith(str(path))
    assert str(caught.value).isprintable()
