"""A tire's property file: the law, with the file's friction and stiffness, is the file's formula; the rest is said."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

from bicycle_env import report, tires, vehicles
from bicycle_env.cli import main
from bicycle_env.envs.configuration import configure
from bicycle_env.envs.fleet import configure_alike, with_options
from bicycle_env.envs.origin import origin_of
from bicycle_env.physics.presets import resolve_tired
from bicycle_env.physics.tires import MagicFormula, TireFile, TireFileWarning
from bicycle_env.tasks.stabilise import Stabilise

PLAIN = """\
[MDI_HEADER]
FILE_TYPE                ='tir'
! : COMMENT : made up for this test
$-----------------------------------------------------------------units
[UNITS]
FORCE                    = 'Newton'
ANGLE                    = 'radians'
[MODEL]
PROPERTY_FILE_FORMAT     = 'PAC2002'
[VERTICAL]
FNOMIN                   = 4000                $Nominal wheel load
[SCALING_COEFFICIENTS]
LMUY                     = 0.9
[LATERAL_COEFFICIENTS]
PCY1                     = 1.3507              $Shape factor Cfy
PDY1                     = 1.0489
PDY2                     = -0.12
PEY1                     = -0.5
PEY2                     = -0.3
PKY1                     = -21.92
PKY2                     = 1.8
$PKY2                    = 99
[SHAPE]
{radial width}
 1.0    0.0
"""
MORE = PLAIN.replace(
    "[SHAPE]", "PDY3 = -2.9\nPKY3 = 0.2\nPHY1 = 0.002\nPEY3 = 0\nPVY2 = -0.0\nRBY1 = 7.1\nQSX1 = 0\n[SHAPE]"
)
CAR = vehicles["civic"]


@pytest.fixture
def written(tmp_path):
    def write(content=PLAIN, name="my.tir"):
        (tmp_path / name).write_text(content, encoding="latin-1")
        return tmp_path / name

    return write


def formula(slip, load, sign=1.0, k4=2.0):
    """The file's lateral force by its own numbers, in size and sign as ISO's axes have it where PKY1 < 0."""
    share = (load - 4000.0) / 4000.0
    peak = sign * (1.0489 - 0.12 * share) * 0.9 * load
    stiffness = sign * -21.92 * 4000.0 * math.sin(k4 * math.atan(load / (1.8 * 4000.0)))
    bent, curvature = stiffness / (1.3507 * peak) * slip, -0.5 - 0.3 * share
    return peak * math.sin(1.3507 * math.atan(bent - curvature * (bent - math.atan(bent))))


@pytest.mark.parametrize("load", [1500.0, 4000.0, 6200.0])
@pytest.mark.parametrize(("k4", "line"), [(2.0, ""), (1.6, "PKY4 = 1.6\n")])
def test_the_law_with_the_files_numbers_is_the_files_formula(written, load, k4, line):
    file = TireFile.read(written(PLAIN.replace("[SHAPE]", f"{line}[SHAPE]")))
    with pytest.warns(TireFileWarning):
        law = MagicFormula.read(file.path, load)
    slips = np.array([-0.5, -0.1, -0.02, 0.001, 0.03, 0.08, 0.2, 1.0])
    forces = law.lateral_force(slips, file.cornering_stiffness(load), file.friction(load) * load)
    np.testing.assert_allclose(forces, [formula(slip, load, k4=k4) for slip in slips], rtol=1e-13)


def test_the_signs_of_the_files_axes_do_not_count(written):
    one, other = (
        PLAIN,
        PLAIN.replace("= -21.92", "= 21.92").replace("= 1.0489", "= -1.0489").replace("= -0.12", "= 0.12"),
    )
    assert one != other
    first, second = TireFile.read(written(one)), TireFile.read(written(other, "other.TIR"))
    for load in (1500.0, 6200.0):
        assert first.friction(load) == second.friction(load)
        assert first.cornering_stiffness(load) == second.cornering_stiffness(load)
        assert first.curvature(load) == second.curvature(load)


def test_each_scaling_factor_counts(written):
    usual = TireFile.read(written())
    scaled = PLAIN.replace("LMUY                     = 0.9", "LFZO = 1.1\nLCY = 1.2\nLMUY = 0.45\nLEY = 2\nLKY = 1.3")
    file = TireFile.read(written(scaled, "scaled.tir"))
    assert file.nominal_load == 4400.0
    assert file.shape == pytest.approx(1.2 * usual.shape, rel=1e-15)
    assert file.friction(4400.0) == usual.friction(4000.0) / 2.0
    assert file.curvature(4400.0) == 2.0 * usual.curvature(4000.0)
    assert file.cornering_stiffness(4400.0) == pytest.approx(1.3 * 1.1 * usual.cornering_stiffness(4000.0), rel=1e-14)


def test_what_is_dropped_is_said_with_what_belongs_elsewhere(written):
    file = TireFile.read(written(MORE))
    assert file.dropped == "camber (PDY3, PKY3), force at zero slip (PHY1), combined slip (RBY1)"
    stiffness = f"{file.cornering_stiffness(4000.0):.6g}"
    with pytest.warns(TireFileWarning, match=re.escape(stiffness)) as caught:
        assert MagicFormula.read(file.path) == MagicFormula(shape=1.3507, curvature=-0.5)
    assert "friction is 0.944" in str(caught[0].message)
    assert str(caught[0].message).endswith(f"Dropped: {file.dropped}.")
    assert caught[0].filename == __file__
    assert TireFile.read(written()).dropped == ""


def test_a_car_gets_two_tires_per_axle_at_its_load(written):
    file = TireFile.read(written())
    car = CAR.with_tires(file.path)
    assert car.front_cornering_stiffness == 2.0 * file.cornering_stiffness(CAR.front_axle_load / 2.0)
    assert car.rear_cornering_stiffness == 2.0 * file.cornering_stiffness(CAR.rear_axle_load / 2.0)
    assert car.source.endswith("Cornering stiffnesses of my.tir.")
    same = {"front_cornering_stiffness": 1e5, "rear_cornering_stiffness": 1e5, "source": ""}
    assert dataclasses.replace(car, **same) == dataclasses.replace(CAR, **same)


def test_where_a_car_is_made_the_file_sets_law_and_stiffnesses(written):
    path = written(MORE)
    with pytest.warns(TireFileWarning, match=r"in front and .* behind, is not taken: friction= is. Dropped: camber"):
        car, law = resolve_tired("civic", path)
    assert car == CAR.with_tires(path)
    assert law == MagicFormula(1.3507, TireFile.read(path).curvature((CAR.front_axle_load + CAR.rear_axle_load) / 4.0))
    with pytest.warns(TireFileWarning):
        origin = origin_of(Stabilise(), {"vehicle": "civic", "tire": str(path), "speed": 30.0})
    configuration = configure(*origin[:3])  # which reads no file, nor do the resets
    assert (configuration.vehicle, configuration.tire) == (car, law)
    other = configure(origin.task, with_options(configure_alike(origin), {"vehicle": "tsx"}), None)
    assert (other.vehicle, other.tire) == (vehicles["tsx"], law)
    with pytest.warns(TireFileWarning):
        study = report.study("civic", tire=str(path))
    assert (study.vehicle, study.tire) == (car, law)


def test_with_a_vehicle_per_car_the_file_is_refused_with_the_way(written):
    with pytest.raises(
        ValueError, match=r"^tire: a property file goes with one vehicle, .* each its vehicle.with_tires"
    ):
        origin_of(Stabilise(), {"vehicle": ["civic", "tsx"], "tire": written()})


def test_elsewhere_a_file_is_refused_with_the_way():
    with pytest.raises(ValueError, match=r"here give tires\.MagicFormula\.read\('my\.tir'\) and vehicle\.with_tires"):
        tires.resolve("my.tir")


def put(name, text):
    return re.sub(rf"(?m)^{name} .*$", text, PLAIN)


BAD = [
    ("", "missing coefficients FNOMIN, PCY1, PDY1, PEY1, PKY1, PKY2"),
    (put("PKY2", ""), "missing coefficient PKY2"),
    (put("PCY1", "PCY1 = 1.3\nPCY1 = 1.4"), "PCY1 stands twice"),
    (put("PCY1", "PCY1 = nan"), "PCY1 must be a finite number, got nan"),
    (put("PCY1", "PCY1 = 'x\x1b[2J'"), "PCY1 must be a finite number, got 'x"),
    (put("PCY1", "PCY1 = 2.5"), "shape must be < 2 unless curvature is exactly 1"),
    (put("PCY1", "PCY1 = -1"), "PCY1 x LCY must be a finite number in [0.1, 3.129], got -1.0"),
    (put("PDY1", "PDY1 = 0"), "friction must be a finite number in [0.001, 10], got 0.0"),
    (put("PEY1", "PEY1 = 1.5"), "curvature must be a finite number in [-1000, 1], got 1.5"),
    (put("PKY2", "PKY2 = 0"), "|PKY2| must be a finite number > 0"),
    (put("PKY1", "PKY1 = 1e300"), "cornering_stiffness must be a finite number in [0.01, 1e+08]"),
    (put("FNOMIN", "FNOMIN = -1"), "FNOMIN x LFZO must be a finite number > 0"),
    (put("FORCE", "FORCE = 'pound_force'"), "FORCE must be in 'newton', got 'pound_force'"),
    (put("ANGLE", "ANGLE = 'degree'"), "ANGLE must be in 'radians', got 'degree'"),
    (PLAIN.replace("PAC2002", "PAC_MC"), "PROPERTY_FILE_FORMAT must not be a motorcycle's, got 'PAC_MC'"),
    ("$" * 200_000, "must not be larger than 100000 bytes, has 200000"),
]


@pytest.mark.parametrize(("content", "text"), BAD, ids=range(len(BAD)))
def test_a_mistake_is_one_line_here_and_from_the_command(written, capsys, content, text):
    path = written(content)
    with pytest.raises(ValueError, match=re.escape(text)) as caught:
        resolve_tired("civic", str(path))
    assert str(caught.value).startswith(str(path))
    assert str(caught.value).isprintable()
    assert main(["report", "--vehicle", "civic", "--tire", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == f"bicycle-env: error: {caught.value}\n"


def test_another_ending_and_no_file(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.tir, got 'x\.txt'"):
        TireFile.read("x.txt")
    with pytest.raises(FileNotFoundError):
        TireFile.read(tmp_path / "x.tir")


@pytest.mark.exhaustive
def test_the_command_says_what_is_dropped(written, capsys):
    """Compiles what the report computes with this tire."""
    assert main(["report", "--vehicle", "civic", "--tire", str(written(MORE)), "--grid", "31", "--quiet"]) == 0
    printed = capsys.readouterr()
    assert "magic_formula" in printed.out
    assert printed.err.startswith("bicycle-env: remark: ")
    assert printed.err.endswith("Dropped: camber (PDY3, PKY3), force at zero slip (PHY1), combined slip (RBY1).\n")
