"""The tire laws: slope, symmetry, saturation, and the figures of the brush and Magic Formula tires."""

import copy
import dataclasses
import json
import math
import pickle
import re

import numpy as np
import pytest
import torch

from bicycle_env import tires
from bicycle_env.backends.compiled import NUMBA
from bicycle_env.physics.elementary import array_namespace

C, PEAK = 90e3, 7000.0
NAMES = tuple(tires.LAWS)
SATURATING = tuple(name for name in NAMES if name != "linear")
WIDE = np.concatenate([np.linspace(0.0, 3.5, 4001), 10.0 ** np.linspace(-12.0, 0.0, 200)])


@pytest.mark.parametrize("name", NAMES)
def test_odd_to_the_bit(name):
    tire = tires.resolve(name)
    assert np.array_equal(tire.lateral_force(-WIDE, C, PEAK), -tire.lateral_force(WIDE, C, PEAK))
    assert tire.lateral_force(0.0, C, PEAK) == 0.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("stiffness", [20e3, C, 200e3])
@pytest.mark.parametrize("peak", [500.0, PEAK])
def test_slope_at_zero_is_minus_the_cornering_stiffness(name, stiffness, peak):
    step = 1e-9 * peak / stiffness
    forces = tires.resolve(name).lateral_force(np.array([-step, step]), stiffness, peak)
    assert (forces[1] - forces[0]) / (2.0 * step) == pytest.approx(-stiffness, rel=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_a_positive_slip_angle_pushes_to_the_right(name):
    assert np.all(tires.resolve(name).lateral_force(WIDE[1:], C, PEAK) < 0.0)


@pytest.mark.parametrize("name", SATURATING)
def test_never_above_the_peak_force(name):
    force = np.abs(tires.resolve(name).lateral_force(WIDE, C, PEAK))
    assert np.all(force <= PEAK * (1.0 + 1e-15))
    assert force.max() > 0.99 * PEAK


@pytest.mark.parametrize("name", SATURATING)
def test_continuous_to_beyond_90_degrees(name):
    angles = np.linspace(-2.0, 2.0, 400_001)
    jumps = np.abs(np.diff(tires.resolve(name).lateral_force(angles, C, PEAK)))
    assert jumps.max() <= 1.5 * C * (angles[1] - angles[0])


@pytest.mark.parametrize("name", ["tanh", "fiala"])
def test_stays_at_the_peak_beyond_90_degrees(name):
    beyond = np.array([math.pi / 2, math.nextafter(math.pi / 2, 2.0), 1.6, 2.0, 3.0, math.pi])
    np.testing.assert_allclose(tires.resolve(name).lateral_force(beyond, C, PEAK), -PEAK, rtol=1e-9)


def test_linear_by_hand():
    assert tires.Linear().lateral_force(0.02, 80e3, 1.0) == -1600.0


def test_tanh_by_hand():
    angles = np.array([0.01, 0.05, 0.2])
    np.testing.assert_allclose(
        tires.Tanh().lateral_force(angles, C, PEAK), -PEAK * np.tanh(C * angles / PEAK), rtol=1e-14
    )


def test_fiala_at_a_third_of_the_sliding_slip():
    """z = 1/3: Y = mu F_z (1/3)(3 - 1 + 1/9) = 19/27 mu F_z."""
    slip = math.atan(PEAK / C)
    assert tires.Fiala().lateral_force(slip, C, PEAK) == pytest.approx(-19.0 / 27.0 * PEAK, rel=1e-14)


def test_fiala_slides_from_z_equal_one():
    sliding = math.atan(3.0 * PEAK / C)
    tire = tires.Fiala()
    assert tire.lateral_force(sliding, C, PEAK) == pytest.approx(-PEAK, rel=1e-15)
    assert abs(tire.lateral_force(0.99 * sliding, C, PEAK)) < PEAK
    assert tire.lateral_force(1.5 * sliding, C, PEAK) == tire.lateral_force(1.01 * sliding, C, PEAK)
    # the slope vanishes there: the curve has no corner
    below = tire.lateral_force(np.array([sliding - 1e-4, sliding]), C, PEAK)
    assert abs(np.diff(below)[0]) < 1e-4 * C * 1e-4


def test_fiala_rises_until_it_slides():
    angles = np.linspace(0.0, math.atan(3.0 * PEAK / C), 2000)
    assert np.all(np.diff(tires.Fiala().lateral_force(angles, C, PEAK)) < 0.0)


@pytest.mark.parametrize("shape", [1.05, 1.3, 1.65, 1.9])
@pytest.mark.parametrize("curvature", [-5.0, -1.0, 0.0, 0.5])
def test_magic_formula_peaks_at_d_when_the_shape_exceeds_one(shape, curvature):
    tire = tires.MagicFormula(shape=shape, curvature=curvature)
    angles = np.concatenate([np.linspace(0.0, 2.0, 20001), 10.0 ** np.linspace(0.3, 4.0, 4000)])
    force = -tire.lateral_force(angles, C, PEAK)
    assert force.max() == pytest.approx(PEAK, rel=1e-5)
    assert np.all(force <= PEAK * (1.0 + 1e-15))


def test_magic_formula_does_not_reach_d_when_the_shape_is_below_one():
    force = -tires.MagicFormula(shape=0.8, curvature=0.0).lateral_force(10.0 ** np.linspace(0, 4, 100), C, PEAK)
    assert np.all(force < PEAK * math.sin(0.8 * math.pi / 2) + 1e-9)


def test_magic_formula_by_its_definition():
    shape, curvature, alpha = 1.4, -2.0, 0.07
    x = C / (shape * PEAK) * alpha
    expected = -PEAK * math.sin(shape * math.atan(x - curvature * (x - math.atan(x))))
    assert tires.MagicFormula(shape, curvature).lateral_force(alpha, C, PEAK) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("name", NAMES)
def test_scalars_give_floats_and_arrays_broadcast(name):
    tire = tires.resolve(name)
    assert type(tire.lateral_force(0.1, C, PEAK)) is float
    grid = tire.lateral_force(np.linspace(-0.1, 0.1, 5)[:, None], C, np.array([4000.0, 7000.0]))
    assert grid.shape == (5, 2)
    assert grid[3, 1] == tire.lateral_force(np.linspace(-0.1, 0.1, 5)[3], C, 7000.0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("parameter", "bad"),
    [
        ("slip_angle", math.nan),
        ("slip_angle", math.inf),
        ("cornering_stiffness", 0.0),
        ("cornering_stiffness", -1.0),
        ("cornering_stiffness", math.nan),
        ("peak_force", 0.0),
        ("peak_force", -5.0),
        ("peak_force", math.inf),
        ("peak_force", [1.0, math.nan]),
    ],
)
def test_a_bad_value_is_named(name, parameter, bad):
    values = {"slip_angle": 0.1, "cornering_stiffness": C, "peak_force": PEAK} | {parameter: bad}
    with pytest.raises(ValueError, match=parameter):
        tires.resolve(name).lateral_force(**values)


@pytest.mark.parametrize(
    ("keywords", "error", "named"),
    [
        ({"shape": 0.0}, ValueError, "shape"),
        ({"shape": 2.0}, ValueError, "shape"),
        ({"shape": math.nan}, ValueError, "shape"),
        ({"shape": "wide"}, TypeError, "shape"),
        ({"shape": True}, TypeError, "shape"),
        ({"curvature": 1.0001}, ValueError, "curvature"),
        ({"curvature": -math.inf}, ValueError, "curvature"),
        ({"curvature": None}, TypeError, "curvature"),
        ({"curveture": -1.0}, TypeError, "curvature"),
    ],
)
def test_magic_formula_checks_its_parameters(keywords, error, named):
    with pytest.raises(error, match=named):
        tires.MagicFormula(**keywords)


def test_magic_formula_accepts_the_edges():
    assert tires.MagicFormula(shape=1.9999, curvature=1).curvature == 1.0
    assert tires.MagicFormula(shape=1.9999, curvature=1.0 - 1e-16).shape == 1.9999
    assert tires.MagicFormula(shape=3.129, curvature=1).shape == 3.129 < math.pi / math.atan(math.pi / 2) < 3.1295


EVERY_SLIP = np.concatenate([np.linspace(0.0, 3.2, 4001), 10.0 ** np.linspace(-12.0, 18.0, 4001)])[1:]


@pytest.mark.parametrize(
    ("shape", "curvature"), [(3.129, 1.0), (2.5, 1.0), (2.0, 1.0), (1.9999, 1.0), (1.9999, 1.0 - 1e-12), (1.9999, -1e3)]
)
def test_the_force_of_the_magic_formula_does_not_reverse(shape, curvature):
    """Nor at slips and stiffnesses that no car has: B alpha is up to 1e24 here."""
    for stiffness, peak in ((C, PEAK), (C, 0.1), (1e8, 1e-3)):
        force = tires.MagicFormula(shape, curvature).lateral_force(EVERY_SLIP, stiffness, peak)
        assert np.all(force < 0.0)
        assert np.all(force >= -peak * (1.0 + 1e-15))


@pytest.mark.parametrize("shape", [2.0, 2.5, 3.129])
def test_with_a_curvature_of_one_the_slope_and_the_definition_hold(shape):
    tire = tires.MagicFormula(shape=shape, curvature=1.0)
    assert tire.lateral_force(1e-9, C, PEAK) == pytest.approx(-1e-9 * C, rel=1e-9)
    x = C / (shape * PEAK) * 0.07
    expected = -PEAK * math.sin(shape * math.atan(x - 1.0 * (x - math.atan(x))))
    assert tire.lateral_force(0.07, C, PEAK) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("law", tires.LAWS.values())
def test_tires_are_frozen_values(law):
    assert law() == law()
    assert hash(law()) == hash(law())
    with pytest.raises((dataclasses.FrozenInstanceError, AttributeError, TypeError)):
        law().shape = 1.5


def test_different_parameters_are_different_tires():
    assert tires.MagicFormula(shape=1.2) != tires.MagicFormula(shape=1.3)


def test_resolve():
    tire = tires.MagicFormula(shape=1.1)
    assert tires.resolve(tire) is tire
    assert tires.resolve("fiala") == tires.Fiala()
    with pytest.raises(ValueError, match="did you mean 'fiala'"):
        tires.resolve("fialla")
    for bad in (3, None, tires.Fiala):
        with pytest.raises(TypeError, match="tire must be"):
            tires.resolve(bad)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
def test_torch_keeps_its_type_and_agrees(name, dtype):
    law = tires.resolve(name).law(array_namespace(torch))
    alpha = torch.linspace(-2.0, 2.0, 201, dtype=dtype)
    stiffness, peak = torch.full_like(alpha, C), torch.full_like(alpha, PEAK)
    force = law(alpha, stiffness, peak)
    assert force.dtype == dtype
    expected = tires.resolve(name).lateral_force(alpha.numpy().astype(float), C, PEAK)
    tolerance = (1e-14 if dtype == torch.float64 else 3e-6) * max(PEAK, np.abs(expected).max())
    np.testing.assert_allclose(force.numpy(), expected, rtol=0.0, atol=tolerance)


@dataclasses.dataclass(frozen=True)
class _Wrong(tires.Tire):
    """A law with one fault, named by `fault`."""

    fault: str

    def law(self, xp):
        fault = self.fault

        def lateral_force(slip_angle, cornering_stiffness, peak_force):
            force = -cornering_stiffness * slip_angle
            if fault == "sign":
                return -force
            if fault == "slope":
                return 0.5 * force
            if fault == "even":
                return force + abs(slip_angle)
            return force * np.nan

        return lateral_force


@pytest.mark.parametrize(("fault", "text"), [("sign", "slope"), ("slope", "0.5"), ("even", "odd"), ("nan", "finite")])
def test_a_law_that_contradicts_the_package_is_refused(fault, text):
    with pytest.raises(ValueError, match=text):
        tires.resolve(_Wrong(fault))


def own(law, frozen=True, **fields):
    """A tire of one's own with a law of the usual three arguments, or of xp and them."""
    named = {"law": law, "__annotations__": dict.fromkeys(fields, object), **fields}
    return dataclasses.dataclass(frozen=frozen)(type("Own", (tires.Tire,), named))


def law(function):
    return lambda tire, xp: function


FAULTS = {
    "a branch": (
        law(lambda slip, stiffness, peak: -stiffness * slip if abs(slip) < peak else peak),
        "fails on five slip angles at once .it branches on data: use xp.where.$",
    ),
    "numpy": (
        law(lambda slip, stiffness, peak: -peak * np.tanh(stiffness * slip / peak)),
        "fails .*it calls numpy's tanh: use xp.tanh.$",
    ),
    "math": (
        law(lambda slip, stiffness, peak: -peak * math.tanh(stiffness * slip / peak)),
        "fails .*it asks for one float, as the functions of math do: use those of xp, function, where, .*tanh.$",
    ),
    "what xp has not": (
        lambda tire, xp: lambda slip, stiffness, peak: xp.exp(slip),
        "fails .*xp has no 'exp'; it has function, where, .*tanh.$",
    ),
    "two arguments": (
        law(lambda slip, stiffness: -stiffness * slip),
        r"fails on five slip angles at once .TypeError: .*takes 2 positional arguments but 3 were given.$",
    ),
    "no return": (law(lambda slip, stiffness, peak: None), "gives None: is its `return` missing"),
    "a sum": (law(lambda slip, stiffness, peak: sum(slip)), "fails .*it looks into a number as if it were an array"),
    "a constant": (law(lambda slip, stiffness, peak: -4000.0), "must give one finite number per slip angle, got -4000"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_a_law_of_ones_own_is_one_line(fault):
    made, words = FAULTS[fault]
    with pytest.raises(ValueError, match=f"^tire Own: its law {words}") as caught:
        tires.resolve(own(made)())
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"^tire Own: its law "):
        own(made)().lateral_force(0.1, C, PEAK)


def test_a_tire_of_ones_own_is_a_frozen_value():
    fine = law(lambda slip, stiffness, peak: -stiffness * slip)
    with pytest.raises(TypeError, match=r"^tire Own must be a frozen dataclass: write @dataclasses"):
        tires.resolve(own(fine, frozen=False)())
    with pytest.raises(TypeError, match=r"^tire Own: its fields must be hashable, a tuple in place of a list"):
        tires.resolve(own(fine, points=None)([1.0]))


@pytest.mark.parametrize("tire", [*(law() for law in tires.LAWS.values()), tires.MagicFormula(1.5, -0.3)], ids=repr)
def test_the_plain_form_makes_the_tire_again(tire):
    plain = json.loads(json.dumps(dataclasses.asdict(tire)))
    assert plain["name"] == tire.name
    assert tires.resolve(plain) == tire


def test_the_plain_form_has_defaults_and_takes_numpys_scalars():
    plain = {"name": "magic_formula", "shape": np.float64(1.5)}
    assert tires.resolve(plain) == tires.MagicFormula(shape=1.5)
    assert tires.resolve({"name": np.str_("fiala")}) == tires.Fiala()


def test_the_name_is_no_part_of_the_value():
    assert repr(tires.Fiala()) == "Fiala()"
    assert dataclasses.replace(tires.MagicFormula(), shape=1.5) == tires.MagicFormula(shape=1.5)
    assert copy.deepcopy(tires.MagicFormula(1.4)) == pickle.loads(pickle.dumps(tires.MagicFormula(1.4)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        tires.Fiala().name = "tanh"


@dataclasses.dataclass(frozen=True)
class _Wet(tires.MagicFormula):
    """A law of a user's own that begins where one of the package ends."""

    grip: float = 1.0


@pytest.mark.parametrize(
    ("bad", "error", "text"),
    [
        ({"name": "magic_formula", "shap": 1.5}, ValueError, "unknown field of tire 'magic_formula' 'shap'; did you"),
        ({"name": "magic_formular"}, ValueError, "got 'magic_formular'; did you mean 'magic_formula'?"),
        ({"name": "magic_formula", "shape": 9.0}, ValueError, "tire 'magic_formula': shape must be"),
        ({"name": "magic_formula", "shape": "wide"}, TypeError, "tire 'magic_formula': shape must be"),
        ({"name": 3}, TypeError, "tire: name must be one of"),
        ({"shape": 1.5}, ValueError, "tire: a dict must have a 'name', one of 'linear', "),
        (dataclasses.asdict(_Wet()), ValueError, "tire: name must be one of 'linear', "),
        (["fiala"], TypeError, "tire must be one of"),
    ],
)
def test_a_mistake_in_a_plain_form_is_named(bad, error, text):
    with pytest.raises(error, match=re.escape(text)):
        tires.resolve(bad)


@pytest.mark.parametrize("name", NAMES)
def test_the_name_is_outside_of_the_compiled_code(name):
    """Compiled code is found by what goes into it: a label must not make it anew."""
    law = tires.resolve(name).law(NUMBA)
    contents = [cell.cell_contents for cell in law.__closure__ or ()]
    assert not any(isinstance(content, (str, tires.Tire)) for content in contents)
