"""A tire from its property file (.tir) of Pacejka's Magic Formula: MF-Tyre 5 and 6, PAC2002.

Of pure side slip without camber, at a load F_z of one tire and dfz = (F_z - F_0) / F_0 with F_0 = LFZO FNOMIN
(Pacejka 2012, 4.E19-4.E25; the scaling factors L... are 1 where the file has none):

    shape C = PCY1 LCY,  friction mu = (PDY1 + PDY2 dfz) LMUY,  curvature E = (PEY1 + PEY2 dfz) LEY
    cornering stiffness K = PKY1 F_0 sin(PKY4 atan(F_z / (PKY2 F_0))) LKY, PKY4 = 2 where the file has none

Files differ in the signs of mu and K with their axes; here both are sizes, the force acts against the slip.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path

from bicycle_env.files import naming, read_bytes, shown
from bicycle_env.physics.validation import in_range, number, positive

LARGEST_FILE = 100_000  # bytes
EXTENSION = ".tir"
NEEDED = ("FNOMIN", "PCY1", "PDY1", "PEY1", "PKY1", "PKY2")
USUAL = {"PDY2": 0.0, "PEY2": 0.0, "PKY4": 2.0, **dict.fromkeys(("LFZO", "LCY", "LMUY", "LEY", "LKY"), 1.0)}
UNITS = {"FORCE": ("newton", "n"), "ANGLE": ("radians", "radian", "rad")}
DROPPED = {
    "camber": r"PDY3|PEY[45]|PKY[3567]|PHY3|PVY[34]",
    "force at zero slip": r"P[HV]Y[12]",
    "curvature unlike on both sides": "PEY3",
    "inflation pressure": r"PPY[1-5]",
    "combined slip": r"R[BCEHV][XY]\d",
    "longitudinal force": r"P[CDEKHVP]X\d",
    "moments": r"Q\w\w\d+|SSZ\d|PPM\w\d",
    "lag (relaxation_length= has it)": r"PT[XY]\d",
}
"""What the law has no place for, with the coefficients that say it; named in the remark where one is not 0."""
LINE = re.compile(r"\s*(\w+)\s*=\s*('[^']*'|\"[^\"]*\"|[^\s$!]*)")


class TireFileWarning(UserWarning):
    """What of a tire's property file the tire law has no place for, and what of it belongs elsewhere."""


def is_tire_file(tire: object) -> bool:
    """Whether what stands for a tire is the path of a property file."""
    return isinstance(tire, (str, os.PathLike)) and Path(tire).suffix.lower() == EXTENSION


@dataclasses.dataclass(frozen=True)
class TireFile:
    """What a property file says of pure side slip without camber, as functions of the vertical load of ONE tire, N."""

    path: str
    coefficients: Mapping[str, float]
    """Those of the formulas above, by their names in the file."""
    dropped: str
    """What the file says beyond them, in words; empty if nothing."""

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> TireFile:
        """From a file that ends in .tir.

        Raises:
            ValueError: another ending; too large; a coefficient is missing, stands twice or is no finite number; other
                units than newton and radian; a motorcycle's tire, whose formulas are others. One line.
            OSError: the file cannot be read.
        """
        if not is_tire_file(path):
            raise ValueError(f"tire: a tire's property file must end in {EXTENSION}, got {os.fspath(path)!r}")
        path = Path(path)
        content = read_bytes(path, LARGEST_FILE)
        with naming(path):
            found = _entries(content.decode("latin-1"))  # comments may be in any code page, names and numbers are ASCII
            for unit, allowed in UNITS.items():
                if found.get(unit, allowed[0]).lower() not in allowed:
                    raise ValueError(f"{unit} must be in '{allowed[0]}', got {found[unit]!r}")
            if (kind := found.get("PROPERTY_FILE_FORMAT", "")).upper().startswith("PAC_MC"):
                raise ValueError(f"PROPERTY_FILE_FORMAT must not be a motorcycle's, got {kind!r}")
            if missing := [name for name in NEEDED if name not in found]:
                raise ValueError(f"missing coefficient{'s' * (len(missing) > 1)} {', '.join(missing)}")
            coefficients = {name: _number(name, found[name]) for name in (*NEEDED, *USUAL) if name in found}
            file = cls(str(path), {**USUAL, **coefficients}, _dropped(found))
            file.shape, file.cornering_stiffness(file.nominal_load), file.friction(file.nominal_load)
            file.curvature(file.nominal_load)
        return file

    @property
    def nominal_load(self) -> float:
        """F_0 = LFZO FNOMIN, N."""
        return positive("FNOMIN x LFZO", self._of("FNOMIN") * self._of("LFZO"))

    @property
    def shape(self) -> float:
        """C = PCY1 LCY."""
        return in_range("PCY1 x LCY", self._of("PCY1") * self._of("LCY"), "shape")

    def friction(self, load: float) -> float:
        """mu at a load [N] of one tire: its largest lateral force is mu times the load."""
        return in_range("friction", abs(self._at(load, "PDY") * self._of("LMUY")), "friction")

    def curvature(self, load: float) -> float:
        """E at a load [N] of one tire."""
        return in_range("curvature", self._at(load, "PEY") * self._of("LEY"))

    def cornering_stiffness(self, load: float) -> float:
        """K at a load [N] of one tire, N/rad; an axle has twice this."""
        nominal = self.nominal_load
        inner = positive("load", load) / (positive("|PKY2|", abs(self._of("PKY2"))) * nominal)
        size = self._of("PKY1") * self._of("LKY") * nominal * math.sin(self._of("PKY4") * math.atan(inner))
        return in_range("cornering_stiffness", abs(size))

    def _of(self, name: str) -> float:
        return self.coefficients[name]

    def _at(self, load: float, name: str) -> float:
        share = (positive("load", load) - self.nominal_load) / self.nominal_load
        return self._of(f"{name}1") + self._of(f"{name}2") * share


def _entries(content: str) -> dict[str, str]:
    """The texts behind the names of a file, without comments ($, !); its tables of points are left out."""
    found: dict[str, str] = {}
    for line in content.splitlines():
        if entry := LINE.match(line):
            name, text = entry[1].upper(), entry[2].strip("'\" ")
            if name in (*NEEDED, *USUAL) and name in found:
                raise ValueError(f"{name} stands twice")
            found[name] = text
    return found


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{name} must be a finite number, got {shown(repr(text), 60)}") from None
    return number(name, value)


def _dropped(found: Mapping[str, str]) -> str:
    parts = []
    for what, names in DROPPED.items():
        acting = [name for name, text in found.items() if re.fullmatch(names, name) and text.strip("+-0.eE") != ""]
        if acting:
            parts.append(f"{what} ({', '.join(acting[:4])}{', ...' * (len(acting) > 4)})")
    return ", ".join(parts)
