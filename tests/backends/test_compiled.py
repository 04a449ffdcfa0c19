"""What makes a digest change, what entry points accept, and that compiled code survives the process."""

import math
import os
import re
import subprocess
import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.extending import intrinsic

from bicycle_env.backends import compiled, single_precision
from bicycle_env.backends.code_digest import digest
from bicycle_env.backends.compiled import NUMBA, entry_point
from bicycle_env.physics import elementary, tires
from bicycle_env.physics.car import CarState
from bicycle_env.physics.integrators import rk4
from bicycle_env.physics.single_track import SingleTrack

GAIN = 2.0


def law_with(constant):
    """A law whose closure holds a constant, inside another law."""

    def law(x):
        return constant * x

    return outer_law(law)


def outer_law(inner):
    inner = NUMBA.function(inner)

    def outer(x):
        return inner(x) + 1.0

    return outer


def law_with_global():
    def law(x):
        return GAIN * x

    return outer_law(law)


def law_with_default(value):
    def law(x, gain=value):
        return gain * x

    return outer_law(law)


def law_plus():
    def law(x):
        return x + 3.0

    return outer_law(law)


def law_minus():
    def law(x):
        return x - 3.0

    return outer_law(law)


def law_with_number(number):
    source = {3.0: lambda x: x + 3.0, 4.0: lambda x: x + 4.0}
    return outer_law(source[number])


@pytest.mark.parametrize(
    "build",
    [law_plus, law_minus, law_with_global, lambda: law_with(1.5), lambda: law_with((1.0, 2.0)), lambda: law_with(True)],
)
def test_two_builds_of_one_law_have_one_digest(build):
    assert digest(build()) == digest(build())


def test_another_operation_is_another_digest():
    assert digest(law_plus()) != digest(law_minus())


def test_another_number_in_the_text_is_another_digest():
    assert digest(law_with_number(3.0)) != digest(law_with_number(4.0))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1.5, 1.5000000000000002),
        (1, 1.0),
        (0.0, -0.0),
        (1, True),
        ((1.0, 2.0), (1.0, 2.5)),
        (((1.0,), 2.0), (1.0, 2.0)),
        (np.float64(1.0), np.float64(2.0)),
        (np.float32(1.0), np.float32(2.0)),
        (np.int64(3), np.int64(4)),
        (np.array([1.0, 2.0]), np.array([1.0, 3.0])),
        (np.array([1.0, 2.0]), np.array([[1.0, 2.0]])),
    ],
    ids=lambda value: repr(value).replace(" ", ""),
)
def test_another_constant_in_a_closure_is_another_digest(one, other):
    assert digest(law_with(one)) != digest(law_with(other))


def test_another_global_is_another_digest(monkeypatch):
    before = digest(law_with_global())
    monkeypatch.setitem(globals(), "GAIN", 2.5)
    assert digest(law_with_global()) != before


def test_another_default_is_another_digest():
    assert digest(law_with_default(1.0)) != digest(law_with_default(2.0))


def integrator(tire="fiala", geometry="exact", xp=NUMBA):
    return rk4(xp, CarState, SingleTrack.of(tire, geometry).rates(xp))


def test_the_digest_of_the_physics_sees_tire_and_geometry():
    variants = [
        integrator("fiala"),
        integrator("tanh"),
        integrator("linear"),
        integrator("fiala", "small_angle"),
        integrator(tires.MagicFormula(shape=1.3)),
        integrator(tires.MagicFormula(shape=1.4)),
        integrator(tires.MagicFormula(curvature=-2.0)),
    ]
    assert len({digest(variant) for variant in variants}) == len(variants)
    assert digest(integrator("fiala")) == digest(integrator("fiala"))
    assert digest(integrator("magic_formula")) == digest(integrator(tires.MagicFormula()))


@pytest.mark.parametrize("name", ["SIN", "ATAN", "PI_LOW", "TAN_PI_8"])
def test_the_digest_of_the_physics_sees_the_polynomials(monkeypatch, name):
    def made_anew():
        return digest(integrator(xp=elementary.namespace("numba", NUMBA.where, np.floor, compiled.inlined)))

    before = made_anew()
    assert made_anew() == before
    value = getattr(elementary, name)
    changed = (*value[:-1], value[-1] * 1.0000001) if isinstance(value, tuple) else value * 1.0000001
    monkeypatch.setattr(elementary, name, changed)
    assert made_anew() != before


def test_the_digest_sees_what_an_intrinsic_generates():
    """Two of one name, one of which looks at another bit, must not share what the cache holds."""

    def using(place):
        @intrinsic
        def looked_up(_typing, _number):
            def generate(_context, builder, _signature, arguments):
                return builder.ashr(arguments[0], arguments[0].type(place))

            return numba.int64(numba.int64), generate

        return digest(lambda number: looked_up(number))

    assert using(1) == using(1)
    assert using(1) != using(2)


def test_the_digest_of_the_physics_sees_a_function_of_the_namespace(monkeypatch):
    before = digest(integrator())
    monkeypatch.setattr(NUMBA, "near_cos", NUMBA.function(lambda r: 1.0 - 0.5 * r * r))
    assert digest(integrator()) != before


def test_an_entry_point_computes_and_accepts_no_other_types():
    def twice(x):
        return 2.0 * x

    function = entry_point(twice, numba.float64(numba.float64))
    assert function(1.5) == 3.0
    with pytest.raises(TypeError):
        function("text")


def test_constants_of_all_kinds_are_single_in_single_precision():
    """One that stayed double would make the whole law double."""
    enclosed, pair = 0.25, (0.5, 1.5)

    def law(x, gain=2.5):
        return gain * (x * enclosed + pair[1]) - GAIN * np.pi / math.tau + 3.0

    single = single_precision.in_single_precision(law)
    for function, number in ((single, numba.float32), (compiled.inlined(law), numba.float64)):
        assert called_by_compiled(function)(np.float32(0.3)) == pytest.approx(law(0.3), rel=1e-6)
        (overload,) = function.overloads.values()
        assert overload.signature.return_type == number


def called_by_compiled(function):
    return numba.njit(lambda x: function(x))


def test_a_part_refuses_to_be_called_from_python():
    """It has no way in: numba alone would jump to address 0."""
    part = compiled.inlined(lambda x: 2.0 * x)
    assert called_by_compiled(part)(3.0) == 6.0
    with pytest.raises(TypeError, match="part of compiled functions"):
        part(3.0)


def test_a_part_has_no_machine_code_and_keeps_its_constants_and_errors(empty_cache):
    table = np.linspace(0.0, 1.0, 5)

    def law(k):
        if k < 0:
            raise ValueError("k must not be negative")
        return table[k]

    part = compiled.inlined(law)

    def function(k):
        return part(k) + 1.0

    entry = compiled.entry_point(function, numba.float64(numba.int64))
    assert entry(2) == 1.5
    with pytest.raises(ValueError, match="k must not be negative"):
        entry(-1)
    (name,) = [result.fndesc.mangled_name for result in part.overloads.values()]
    (result,) = part.overloads.values()
    engine = next(iter(entry.overloads.values())).library.codegen._engine
    assert result.library.get_pointer_to_function(name) == 0
    assert not engine.is_symbol_defined(name)


def test_code_compiled_with_another_licence_is_other_code(monkeypatch):
    """What was compiled while the compiler might fuse must not be found when it may not."""

    def law(x):
        return x * x + 1.0

    before = compiled.inlined(law).content
    monkeypatch.setitem(compiled.COMMON, "fastmath", {"contract"})
    assert compiled.inlined(law).content != before


def test_nan_survives_compilation():
    """The licence to optimise must not include "there are no NaNs"."""

    def check(x):
        return x != x or not np.isfinite(x)

    function = entry_point(check, numba.boolean(numba.float64))
    assert function(np.nan)
    assert function(np.inf)
    assert not function(1.0)
    assert not compiled.COMMON["fastmath"]


def doubled(x):
    return 2.0 * x


class Pair(NamedTuple):
    one: float
    other: float


class Friction:
    value = 2.0


FRICTION = Friction()


def unbound(x):
    return doubled(x)


def replacing(x):
    return Pair(x, x)._replace(one=2.0).one


def of_an_object(x):
    return x + FRICTION.value


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (
            unbound,
            r"Untyped global name 'doubled': .*\). Call what xp.function\(doubled\) gives, where the law is made",
        ),
        (
            replacing,
            r"Unknown attribute '_replace' .*\). bicycle_env.physics.records has it for laws: replaced\(xp, Pair, ",
        ),
        (
            of_an_object,
            r"Untyped global name 'FRICTION': .*\). Take the numbers that the law needs from FRICTION before",
        ),
        (lambda x: [*x], r"\). A law may use its arguments, floats, tuples and the functions of xp"),
    ],
    ids=["function", "replace", "object", "other"],
)
def test_what_cannot_be_compiled_is_one_line_with_its_remedy(law, words):
    with pytest.raises(
        compiled.LawError, match=rf"test_compiled.py, line \d+: this law cannot be compiled \(.*{words}"
    ) as error:
        entry_point(law, numba.float64(numba.float64))
    assert "\n" not in str(error.value)
    assert len(re.findall("Unknown attribute|Untyped", str(error.value))) <= 1


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.parametrize(
    ("one", "other"),
    [(1.5, 2.5), (np.float32(1.5), np.float32(2.5)), (np.array([1.5]), np.array([2.5])), ((1.5,), (2.5,))],
    ids=lambda value: repr(value).replace(" ", ""),
)
def test_a_changed_constant_is_not_answered_from_the_cache(empty_cache, one, other):
    def build(constant):
        def law(x):
            return x * constant

        def law_of_sequence(x):
            return x * constant[0]

        return entry_point(law_of_sequence if np.ndim(constant) else law, numba.float64(numba.float64))

    assert build(one)(2.0) == 3.0
    assert build(other)(2.0) == 5.0
    assert build(one)(2.0) == 3.0


PROGRAM = """
import bicycle_env
run = bicycle_env.simulate("oversteer", 30.0, (0.02, 0.0), 0.1, tire="linear")
print(run["yaw_rate"][-1].hex())
"""


@pytest.fixture
def process(tmp_path):
    """Run a program in a new process whose compile cache is an empty folder at first."""

    def process(program, **settings):
        usual = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_CPU")}
        environment = usual | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} | settings
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", program], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done

    return process


def test_compiled_code_survives_the_process(process):
    first, second = process(PROGRAM), process(PROGRAM)
    assert first.stderr.count("compiling") == 1
    assert len(first.stderr.splitlines()) == 1
    assert "the Linear tire" in first.stderr
    assert second.stderr == ""
    assert second.stdout == first.stdout


@pytest.mark.exhaustive
def test_another_law_is_compiled_in_another_process(process):
    """In one process: test_a_changed_constant_is_not_answered_from_the_cache, and the digests above."""
    first, other = process(PROGRAM), process(PROGRAM.replace("linear", "tanh"))
    assert other.stderr.count("compiling") == 1
    assert other.stdout != first.stdout


def test_without_the_compiler_the_closed_forms_work_and_the_rest_says_why(process):
    program = """
import bicycle_env
print(bicycle_env.analysis.critical_speed("oversteer"))
try:
    bicycle_env.simulate("oversteer", 30.0, (0.02, 0.0), 0.1)
except RuntimeError as error:
    print(error)
"""
    done = process(program, NUMBA_DISABLE_JIT="1")
    speed, words = done.stdout.splitlines()
    assert float(speed) == pytest.approx(36.06, abs=0.01)
    assert words == "bicycle_env needs numba's compiler, and NUMBA_DISABLE_JIT is set: unset it"


@pytest.mark.exhaustive
def test_each_processor_has_files_of_its_own(process, tmp_path):
    """Some that share a disk must not run each other's code, whatever they are told to compile for."""
    settings = [{}, {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}, {"NUMBA_CPU_FEATURES": ""}]
    for setting in settings:
        assert process(PROGRAM, **setting).stderr.count("compiling") == 1
        assert process(PROGRAM, **setting).stderr == ""
    names = [path.name for path in (tmp_path / "cache").rglob("*.nbc")]
    assert len(names) == 3
    assert len({name.rpartition("-")[0] for name in names}) == 1
