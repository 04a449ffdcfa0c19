"""Tire laws: lateral force of an axle against its slip angle.

To add one, write a class with a ``law`` and add a row to ``LAWS``; every environment, ``simulate``, the analysis and
the torch path then know it. A law is given the slip angle alpha [rad], the axle's cornering stiffness C [N/rad] and
the largest force mu F_z [N] that its friction allows, and returns the lateral force Y [N]. It must be odd in alpha to
the bit, branch-free, and have slope -C at zero slip: its linearisation is the book's model, equation (6.21).
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import os
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bicycle_env.files import naming, shown
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.tire_files import TireFile as TireFile
from bicycle_env.physics.tire_files import TireFileWarning as TireFileWarning
from bicycle_env.physics.tire_files import is_tire_file as is_tire_file
from bicycle_env.physics.trial import tried
from bicycle_env.physics.validation import check_value, choice, explain_keywords, from_fields, in_range, positive

Law = Callable[[Any, Any, Any], Any]


class Tire(abc.ABC):
    """Base of the tire laws: frozen, hashable, compared by value."""

    @property
    def name(self) -> str:
        """Its row in ``LAWS``; the class's name for a law of one's own, which has none."""
        law = type(self)
        return next((name for name, known in LAWS.items() if known is law), law.__name__)

    @abc.abstractmethod
    def law(self, xp: Any) -> Law:
        """The law as a function ``(slip_angle, cornering_stiffness, peak_force)`` written in the namespace xp.

        Write constants as floats: with ``2`` in place of ``2.0``, compiled code computes in double precision.
        """

    def lateral_force(self, slip_angle: Any, cornering_stiffness: Any, peak_force: Any) -> Any:
        """Lateral force [N], negative for positive slip.

        Args:
            slip_angle: rad; a scalar or an array.
            cornering_stiffness: N/rad, positive; a scalar or an array that broadcasts with the slip angle.
            peak_force: mu F_z in N, positive; a scalar or an array that broadcasts with the slip angle.

        Returns:
            A float for scalars, else an array of the common shape.

        Raises:
            ValueError: a value is not finite, or a stiffness or peak force is not positive.
        """
        values = {
            "slip_angle": np.asarray(slip_angle, dtype=np.float64),
            "cornering_stiffness": np.asarray(cornering_stiffness, dtype=np.float64),
            "peak_force": np.asarray(peak_force, dtype=np.float64),
        }
        check(self)
        for name, value in values.items():
            if not np.all(np.isfinite(value)):
                raise ValueError(f"{name} must be finite, got {value}")
            if name != "slip_angle" and not np.all(value > 0.0):
                raise ValueError(f"{name} must be > 0, got {value}")
        force = _on_arrays(self)(*np.broadcast_arrays(*values.values()))
        return float(force) if np.ndim(force) == 0 else np.asarray(force)


@functools.cache
def _on_arrays(tire: Tire) -> Law:
    return tire.law(NUMPY)


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Linear(Tire):
    """Y = -C alpha (6.6, 6.21): Karnopp's law, without limit. For small slip angles only."""

    name: str = dataclasses.field(init=False, repr=False, compare=False)
    """Its row in ``LAWS``: with it, what ``dataclasses.asdict`` makes is enough to make the tire again."""

    def law(self, xp: Any) -> Law:
        def lateral_force(slip_angle: Any, cornering_stiffness: Any, peak_force: Any) -> Any:
            return -cornering_stiffness * slip_angle

        return lateral_force


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Tanh(Tire):
    """Y = -D tanh(C alpha / D), D = mu F_z: the simplest smooth law that saturates."""

    name: str = dataclasses.field(init=False, repr=False, compare=False)
    """Its row in ``LAWS``: with it, what ``dataclasses.asdict`` makes is enough to make the tire again."""

    def law(self, xp: Any) -> Law:
        def lateral_force(slip_angle: Any, cornering_stiffness: Any, peak_force: Any) -> Any:
            return -peak_force * xp.tanh(slip_angle * (cornering_stiffness / peak_force))

        return lateral_force


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Fiala(Tire):
    """The brush tire with parabolic pressure and one friction coefficient (E. Fiala 1954; Pacejka 2012, ch. 3).

    z = C tan(alpha) / (3 mu F_z); Y = -mu F_z z (3 - 3|z| + z^2) up to |z| = 1, where the whole patch slides.
    """

    name: str = dataclasses.field(init=False, repr=False, compare=False)
    """Its row in ``LAWS``: with it, what ``dataclasses.asdict`` makes is enough to make the tire again."""

    def law(self, xp: Any) -> Law:
        def lateral_force(slip_angle: Any, cornering_stiffness: Any, peak_force: Any) -> Any:
            # Clipping the angle, not its tangent: past 90 degrees the tangent changes sign.
            sliding = xp.atan(3.0 * peak_force / cornering_stiffness)
            size = xp.minimum(abs(slip_angle), sliding)
            tangent = xp.near_sin(size) / xp.near_cos(size)
            z = xp.minimum(tangent * (cornering_stiffness / (3.0 * peak_force)), 1.0)
            force = peak_force * (z * xp.multiply_add(-z, 3.0 - z, 3.0))
            return xp.where(slip_angle > 0.0, -force, force)

        return lateral_force


@explain_keywords
@dataclasses.dataclass(frozen=True)
class MagicFormula(Tire):
    """Y = -D sin(c atan(B alpha - E (B alpha - atan(B alpha)))), D = mu F_z, B = C/(c D) (Pacejka 2012, ch. 4)."""

    name: str = dataclasses.field(init=False, repr=False, compare=False)
    """Its row in ``LAWS``: with it, what ``dataclasses.asdict`` makes is enough to make the tire again."""
    shape: float = 1.3
    """c, in [0.1, 2), so that the force never reverses; with a curvature of exactly 1 up to 3.129, see `law`."""
    curvature: float = -1.0
    """E, in [-1000, 1]."""

    def __post_init__(self) -> None:
        shape, curvature = in_range("shape", self.shape), in_range("curvature", self.curvature)
        if shape >= 2.0 and curvature != 1.0:
            raise ValueError(f"shape must be < 2 unless curvature is exactly 1, got {shape!r} and {curvature!r}")
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "curvature", curvature)

    @classmethod
    def read(cls, path: str | os.PathLike[str], load: float | None = None) -> MagicFormula:
        """The law in a tire's property file (.tir), whose formulas stand in ``bicycle_env.physics.tire_files``.

        With the file's cornering stiffness K and mu F_z, ``lateral_force`` is the file's at that load, in pure side
        slip without camber or shifts. A ``TireFileWarning`` says both numbers, which belong to the vehicle
        (``Vehicle.with_tires``) and the road (``friction=``), and what of the file is dropped.

        Args:
            path: a file that ends in .tir.
            load: vertical, of one tire, N; by default the file's nominal one.

        Raises:
            ValueError: a bad file, or numbers out of this law's ranges. One line.
            OSError: the file cannot be read.
        """
        file = TireFile.read(path)
        load = file.nominal_load if load is None else positive("load", load)
        law = cls.of_file(file, load)
        warnings.warn(
            f"{shown(file.path)}: at {load:.6g} N per tire its friction is {file.friction(load):.4g} (of the road: "
            f"friction=) and its cornering stiffness {file.cornering_stiffness(load):.6g} N/rad per tire (of the "
            f"vehicle: with_tires). Dropped: {file.dropped or 'nothing'}.",
            TireFileWarning,
            stacklevel=2,
        )
        return law

    @classmethod
    def of_file(cls, file: TireFile, load: float) -> MagicFormula:
        """The law of a file that is read already, at a load [N] of one tire, without remark."""
        with naming(file.path):
            return cls(shape=file.shape, curvature=file.curvature(load))

    def law(self, xp: Any) -> Law:
        """As of every tire.

        With E = 1 what stands in the outer arctangent is atan(B alpha), below pi/2: the force cannot reverse for c up
        to pi / atan(pi/2) = 3.1294. Sets for wet roads and ice need that. Written out, the difference of large numbers
        would lose it.
        """
        shape, curvature = self.shape, self.curvature
        if curvature == 1.0:

            def bend(x: Any) -> Any:
                return xp.atan(x)

        else:

            def bend(x: Any) -> Any:
                return xp.multiply_add(-curvature, x - xp.atan(x), x)

        bend = xp.function(bend)

        def lateral_force(slip_angle: Any, cornering_stiffness: Any, peak_force: Any) -> Any:
            x = slip_angle * (cornering_stiffness / (shape * peak_force))
            return -peak_force * xp.sin(shape * xp.atan(bend(x)))

        return lateral_force


LAWS: dict[str, type[Tire]] = {
    "linear": Linear,
    "tanh": Tanh,
    "fiala": Fiala,
    "magic_formula": MagicFormula,
}


def check(tire: Tire) -> None:
    """Refuse a tire that the rest of the package would contradict: ValueError or TypeError in one line names it.

    Its law must be odd, with slope -C, finite, and made of what a law may use.
    """
    check_value("tire", tire)
    _check_law(tire)


@functools.cache
def _check_law(tire: Tire) -> None:
    name = type(tire).__name__
    law = tried(f"tire {name}: its law", tire.law, of=("slip angle", "five slip angles"))
    angles, stiffness, peak = np.array([1e-6, 0.01, 0.1, 0.5, 1.5]), np.full(5, 1e5), np.full(5, 7e3)
    right, left = law(angles, stiffness, peak), law(-angles, stiffness, peak)
    if not np.array_equal(right, -left):
        raise ValueError(f"tire {name}: its law must be odd in the slip angle to the bit, got {right!r} and {left!r}")
    slope = right[0] / angles[0]
    if not abs(slope + 1e5) < 10.0:
        raise ValueError(f"tire {name}: its slope at zero slip must be -cornering_stiffness, got {slope / 1e5:g} of it")


def resolve(tire: str | Tire | Mapping[str, Any]) -> Tire:
    """A tire object from its name in ``LAWS``, from its plain form, or from itself.

    The plain form is what ``dataclasses.asdict`` makes: ``{"name": "magic_formula", "shape": 1.5}``.

    Raises:
        ValueError: an unknown name or field, with the nearest known one; a bad value; a law that the package would
            contradict.
        TypeError: none of the three; a value of the wrong type.
    """
    if isinstance(tire, Tire):
        check(tire)
        return tire
    if is_tire_file(tire):
        raise ValueError(
            "tire: a property file is taken where it can set the vehicle's stiffnesses, too (environments, simulate, "
            f"report, export); here give tires.MagicFormula.read({shown(repr(str(tire)))}) and vehicle.with_tires(...)"
        )
    if isinstance(tire, str):
        return LAWS[choice("tire", tire, LAWS)]()
    if not isinstance(tire, Mapping):
        raise TypeError(f"tire must be one of {', '.join(map(repr, LAWS))}, a Tire object or a dict, got {tire!r}")
    if "name" not in tire:
        raise ValueError(
            f"tire: a dict must have a 'name', one of {', '.join(map(repr, LAWS))}, got {dict(tire)!r}; a tire class "
            "of one's own has no plain form: pass the object"
        )
    name = choice("tire: name", tire["name"], LAWS)
    return from_fields(f"tire {name!r}", LAWS[name], {key: tire[key] for key in tire if key != "name"})
