"""The parameters of one car."""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bicycle_env.files import naming, shown
from bicycle_env.physics.car_files import read_fields
from bicycle_env.physics.elementary import PYTHON
from bicycle_env.physics.tire_files import TireFile
from bicycle_env.physics.validation import explain_keywords, from_fields, in_range

GRAVITY = 9.81  # m/s^2
NEUTRAL = 1e-9
"""A car is neutral where a Cf and b Cr differ by no more than this share of the larger."""
LONGEST_NAME = 100
USUAL_COEFFICIENTS = (3.0, 60.0)
"""Cornering stiffness per axle load, 1/rad: tires of passenger cars have 8 to 25; beyond these a unit is wrong."""
USUAL_INERTIA = (0.1, 10.0)
"""Yaw inertia per m a b: cars have 0.7 to 1.3; beyond these a unit is wrong."""


class UnitWarning(UserWarning):
    """A vehicle's numbers look as if one of them were in another unit."""


QUANTITIES = {
    "mass": "mass",
    "yaw_inertia": "yaw_inertia",
    "front_cornering_stiffness": "cornering_stiffness",
    "rear_cornering_stiffness": "cornering_stiffness",
}
"""The rows of ``RANGES`` that the fields of a Vehicle are checked against; the others are lengths."""
LABELS = ("source", "name")
"""The fields of a Vehicle that are no numbers."""


@explain_keywords
@dataclasses.dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A car as the single-track model sees it; immutable, SI units, cornering stiffness per AXLE (both tires).

    Masses must be in [0.01, 1e6] kg, yaw inertias in [1e-6, 1e8] kg m^2, lengths in [0.001, 100] m and cornering
    stiffnesses in [0.01, 1e8] N/rad (ValueError, TypeError otherwise). Where a cornering stiffness is not 3 to 60 per
    rad of its axle's load, or the yaw inertia not 0.1 to 10 times m a b, a UnitWarning asks for the units; the car is
    made all the same. The first six are Karnopp's m, I_z, a, b, C_f, C_r; the lengths after them say how large the body
    is (lane departure, pictures) and where the wheels are (four-wheel form, equations 6.1-6.5), and do not enter the
    equations of motion.
    """

    mass: float
    """m, kg."""
    yaw_inertia: float
    """I_z about the vertical axis through the centre of mass, kg m^2."""
    cg_to_front: float
    """a, centre of mass to front axle, m."""
    cg_to_rear: float
    """b, centre of mass to rear axle, m."""
    front_cornering_stiffness: float
    """C_f, N/rad, both front tires together."""
    rear_cornering_stiffness: float
    """C_r, N/rad, both rear tires together."""
    front_half_track: float = 0.77
    """t_f, half of the front track width, m."""
    rear_half_track: float = 0.77
    """t_r, half of the rear track width, m."""
    front_overhang: float = 0.9
    """Front axle to the front end of the body, m."""
    rear_overhang: float = 0.9
    """Rear axle to the rear end of the body, m."""
    body_width: float = 1.8
    """Width of the body without mirrors, m."""
    source: str = ""
    """Where the numbers come from."""
    name: str = dataclasses.field(default="", compare=False)
    """A label for reports, one line of at most 100 characters; cars that differ in nothing else are equal."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.name not in LABELS:
                quantity = QUANTITIES.get(field.name, "length")
                object.__setattr__(self, field.name, in_range(field.name, getattr(self, field.name), quantity))
        for label in LABELS:
            if not isinstance(getattr(self, label), str):
                raise TypeError(f"{label} must be a string, got {getattr(self, label)!r}")
        if not self.name.isprintable() or len(self.name) > LONGEST_NAME:
            raise ValueError(
                f"name must be one line of at most {LONGEST_NAME} printable characters, got {self.name[:200]!r}"
            )
        self._remark_on_units()

    def _remark_on_units(self) -> None:
        low, high = USUAL_COEFFICIENTS
        for axle in ("front", "rear"):
            stiffness, load = getattr(self, f"{axle}_cornering_stiffness"), getattr(self, f"{axle}_axle_load")
            if not low <= stiffness / load <= high:
                warnings.warn(
                    f"{axle}_cornering_stiffness = {stiffness:g} N/rad is {stiffness / load:.3g} per rad of the axle's "
                    f"load of {load:.4g} N; cars have {low:g} to {high:g}. Is it in N/deg or kN, of one tire, or is "
                    "the mass in tonnes or a length in mm?",
                    UnitWarning,
                    stacklevel=5,  # of Vehicle(...): above are the dataclass's and the explaining __init__
                )
                return
        low, high = USUAL_INERTIA
        usual = self.mass * self.cg_to_front * self.cg_to_rear
        if not low <= self.yaw_inertia / usual <= high:
            warnings.warn(
                f"yaw_inertia = {self.yaw_inertia:g} kg m^2 is {self.yaw_inertia / usual:.3g} of mass x cg_to_front x "
                f"cg_to_rear = {usual:.4g}; cars have 0.7 to 1.3 of it, none {low:g} or {high:g}. Is it in t m^2, "
                "or the mass or a length in another unit?",
                UnitWarning,
                stacklevel=5,
            )

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> Vehicle:
        """A car from its plain form, the fields by their names, as ``dataclasses.asdict`` makes it.

        Raises:
            ValueError: an unknown field, with the nearest known one; a missing field; a bad value.
            TypeError: a value of the wrong type.
        """
        return from_fields("vehicle", cls, fields)

    @classmethod
    def read(cls, path: str | Path) -> Vehicle:
        """A car from a file that ends in .json or .toml: a table of the fields by their names.

        Or from CommonRoad's vehicle parameters, a file that ends in .yaml or .yml: m, I_z, a, b, the tracks T_f and
        T_r, and the body's l and w, which is taken to be centred between the axles. The stiffnesses are those of its
        single-track model, -p_ky1 per rad of an axle's static load: p_ky1 of the file's table `tire`, or CommonRoad's.

        Without a `name` in it, the car is called like the file.

        Raises:
            ValueError: the ending is another; the file holds no such table; the field is named. One line.
            OSError: the file cannot be read.
        """
        path = Path(path)
        fields = read_fields(path, GRAVITY)
        with naming(path):
            return cls.from_fields({"name": _printable(path.stem), **fields})

    def with_tires(self, tires: str | os.PathLike[str] | TireFile) -> Vehicle:
        """This car with two of a property file's (.tir) tires per axle: their cornering stiffness at the axle's load.

        Raises:
            ValueError: a bad file, see ``tires.TireFile.read``. One line.
            OSError: the file cannot be read.
        """
        file = tires if isinstance(tires, TireFile) else TireFile.read(tires)
        with naming(file.path):
            return dataclasses.replace(
                self,
                front_cornering_stiffness=2.0 * file.cornering_stiffness(self.front_axle_load / 2.0),
                rear_cornering_stiffness=2.0 * file.cornering_stiffness(self.rear_axle_load / 2.0),
                source=f"{self.source} Cornering stiffnesses of {shown(Path(file.path).name)}.".lstrip(),
            )

    @property
    def wheelbase(self) -> float:
        """a + b, m."""
        return self.cg_to_front + self.cg_to_rear

    @property
    def front_axle_load(self) -> float:
        """Static vertical load m g b/(a+b) on the front axle, N."""
        return self.mass * GRAVITY * self.cg_to_rear / self.wheelbase

    @property
    def rear_axle_load(self) -> float:
        """Static vertical load m g a/(a+b) on the rear axle, N."""
        return self.mass * GRAVITY * self.cg_to_front / self.wheelbase

    @property
    def front_extent(self) -> float:
        """Centre of mass to the front end of the body, m."""
        return self.cg_to_front + self.front_overhang

    @property
    def rear_extent(self) -> float:
        """Centre of mass to the rear end of the body, m."""
        return self.cg_to_rear + self.rear_overhang

    @property
    def body_length(self) -> float:
        """Length of the body, m."""
        return self.front_extent + self.rear_extent

    @property
    def yaw_stiffness(self) -> float:
        """b Cr - a Cf, N m/rad: positive = understeer (6.15), negative = oversteer (6.16), exactly 0 = neutral.

        The one place that decides between the three: it is 0 for moments that are equal up to rounding (``NEUTRAL``).
        """
        return float(_yaw_stiffness(self))

    @property
    def critical_speed(self) -> float:
        """U_crit of (6.17), m/s: an oversteering car is unstable above it; infinite when there is none."""
        return float(_critical_speed(self))


def yaw_stiffness(xp: Any) -> Callable[[Any], Any]:
    """The law ``(vehicle) -> N m/rad`` of :attr:`Vehicle.yaw_stiffness`."""

    def yaw_stiffness(vehicle: Any) -> Any:
        front = vehicle.cg_to_front * vehicle.front_cornering_stiffness
        rear = vehicle.cg_to_rear * vehicle.rear_cornering_stiffness
        return xp.where(abs(rear - front) <= NEUTRAL * xp.maximum(front, rear), 0.0, rear - front)

    return yaw_stiffness


def critical_speed(xp: Any) -> Callable[[Any], Any]:
    """The law ``(vehicle) -> m/s`` of :attr:`Vehicle.critical_speed`."""
    balance = yaw_stiffness(xp)

    def critical_speed(vehicle: Any) -> Any:
        moment = balance(vehicle)
        oversteers = moment < 0.0
        stiffness = vehicle.front_cornering_stiffness * vehicle.rear_cornering_stiffness
        squared = stiffness / (vehicle.mass * xp.where(oversteers, -moment, 1.0))
        return xp.where(oversteers, vehicle.wheelbase * xp.sqrt(squared), math.inf)

    return critical_speed


_yaw_stiffness, _critical_speed = yaw_stiffness(PYTHON), critical_speed(PYTHON)


def _printable(label: str) -> str:
    """What of a file's name can be a car's."""
    return "".join(character if character.isprintable() else "?" for character in label)[:LONGEST_NAME]
