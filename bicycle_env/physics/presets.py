"""The cars that come with the package, each with its source: ``bicycle_env.vehicles``."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, cast

from bicycle_env.files import shown
from bicycle_env.physics import tires
from bicycle_env.physics.car_files import ENDINGS, is_car_file
from bicycle_env.physics.tire_files import TireFile, TireFileWarning, is_tire_file
from bicycle_env.physics.validation import choice
from bicycle_env.physics.vehicle import Vehicle

_BODY: Any = {"mass": 1500.0, "yaw_inertia": 2500.0, "cg_to_front": 1.4, "cg_to_rear": 1.3}
_BODY_SOURCE = (
    "This package: a mid-size body (1500 kg, wheelbase 2.7 m) shared by `oversteer`, `neutral` and `understeer`; only "
    "the two cornering stiffnesses differ. "
)


class _Cars(dict[str, Vehicle]):
    """Answers a name that it does not have with the nearest one."""

    def __missing__(self, name: object) -> Vehicle:
        try:
            choice("vehicle", name, self)
        except (TypeError, ValueError) as error:
            raise KeyError(str(error)) from None
        raise KeyError(name)


_vehicles = _Cars(
    {
        "oversteer": Vehicle(
            name="oversteer",
            **_BODY,
            front_cornering_stiffness=110e3,
            rear_cornering_stiffness=90e3,
            source=_BODY_SOURCE + "a Cf > b Cr: unstable above 36.1 m/s.",
        ),
        "neutral": Vehicle(
            name="neutral",
            **_BODY,
            front_cornering_stiffness=97.5e3,
            rear_cornering_stiffness=105e3,
            source=_BODY_SOURCE + "a Cf = b Cr exactly.",
        ),
        "understeer": Vehicle(
            name="understeer",
            **_BODY,
            front_cornering_stiffness=90e3,
            rear_cornering_stiffness=110e3,
            source=_BODY_SOURCE + "a Cf < b Cr: stable at every speed.",
        ),
        "me303": Vehicle(
            name="me303",
            mass=1400.0,
            yaw_inertia=2420.0,
            cg_to_front=1.14,
            cg_to_rear=1.33,
            front_cornering_stiffness=25e3,
            rear_cornering_stiffness=21e3,
            source="Do, Chung, Dao, Smith, Beaudin: A Study of Vehicle Dynamics Using ODEs, ME 303 project, University "
            "of Waterloo, 2025 (GitHub hepromark/BicycleModelExploration, docs/report.pdf). Oversteering.",
        ),
        "mendes": Vehicle(
            name="mendes",
            mass=1300.0,
            yaw_inertia=10000.0,
            cg_to_front=1.6154,
            cg_to_rear=1.8846,
            front_cornering_stiffness=91090.26949615631,
            rear_cornering_stiffness=91090.26949615631,
            source="A. de Souza Mendes: Vehicle-Dynamics-Lateral, example 'Steering control' (GitHub andresmendes/"
            "Vehicle-Dynamics-Lateral). One tire per axle, 10000 sin(2 atan(4/50)) N/deg. Understeering.",
        ),
        "cabrol": Vehicle(
            name="cabrol",
            mass=1500.0,
            yaw_inertia=1500.0 * 1.2 * 1.6,
            cg_to_front=1.2,
            cg_to_rear=1.6,
            front_cornering_stiffness=120e3,
            rear_cornering_stiffness=180e3,
            source="E. Cabrol: VehicleDynamics, bicycle_model.ipynb (GitHub EricCabrol/VehicleDynamics, 54db46c). The "
            "source gives no yaw inertia: m a b is used. Understeering.",
        ),
        "civic": Vehicle(
            name="civic",
            mass=1450.0,
            yaw_inertia=2345.0,
            cg_to_front=0.996,
            cg_to_rear=1.624,
            front_cornering_stiffness=52622.70183963723,
            rear_cornering_stiffness=75567.28732276152,
            source="K. Tse: blog posts on cornering compliances, 2019 (GitHub kktse/kktse.github.io): front 9.6, rear "
            "4.1 deg/g. Understeering.",
        ),
        "tsx": Vehicle(
            name="tsx",
            mass=1619.0,
            yaw_inertia=2746.0,
            cg_to_front=1.041,
            cg_to_rear=1.629,
            front_cornering_stiffness=82865.45298681293,
            rear_cornering_stiffness=114450.1227642377,
            source="K. Tse: blog posts on cornering compliances, 2019 (GitHub kktse/kktse.github.io): front 6.7, rear "
            "3.1 deg/g. Understeering.",
        ),
    }
)
vehicles: Mapping[str, Vehicle] = MappingProxyType(_vehicles)
"""Name -> Vehicle: the presets, and what :func:`register_vehicle` added."""


def register_vehicle(name: str, vehicle: Vehicle | Mapping[str, Any]) -> None:
    """Let a car be known by a name: in ``vehicles``, in every ``vehicle=`` and on the command lines of this process.

    Workers that are spawned import the package anew and do not know it: give them the Vehicle itself.

    Args:
        name: one word of letters, digits and underscores that does not begin with a digit.
        vehicle: a Vehicle, or its fields by their names. Its own ``name`` gives way to this one.

    Raises:
        ValueError: the name is not such a word, or a different car has it.
        TypeError: the name is no string, or the car is neither a Vehicle nor a mapping.
    """
    if not isinstance(name, str):
        raise TypeError(f"name must be a string, got {name!r}")
    if not name.isidentifier():
        raise ValueError(f"name must be one word of letters, digits and underscores, got {name!r}")
    if not isinstance(vehicle, (Vehicle, Mapping)):
        raise TypeError(f"vehicle must be a Vehicle or a dict of its fields, got {vehicle!r}")
    vehicle = resolve_vehicle(vehicle)
    known = _vehicles.get(name)
    if known is not None and known != vehicle:
        raise ValueError(f"name must not be that of a different vehicle, got {name!r}")
    if known is None:
        _vehicles[name] = dataclasses.replace(vehicle, name=name)


def resolve_vehicle(vehicle: str | os.PathLike[str] | Vehicle | Mapping[str, Any]) -> Vehicle:
    """A car from its name in ``vehicles``, from a file, from its plain form, or from itself.

    Args:
        vehicle: a name; a file's name or path that ends in .json, .toml or .yaml, see ``Vehicle.read``; a mapping of
            the fields of ``Vehicle`` by their names; or a Vehicle.

    Raises:
        ValueError: an unknown name or field, with the nearest known one; a missing field; a bad value.
        TypeError: none of the four; a value of the wrong type.
        OSError: the file cannot be read.
    """
    if isinstance(vehicle, Vehicle):
        return vehicle
    if isinstance(vehicle, Mapping):
        return Vehicle.from_fields(vehicle)
    if isinstance(vehicle, os.PathLike):
        vehicle = os.fspath(vehicle)
    if not isinstance(vehicle, str):
        words = ", ".join(map(repr, vehicles))
        raise TypeError(f"vehicle must be one of {words}, a car's file, a Vehicle or a dict, got {vehicle!r}")
    if is_car_file(vehicle):
        return Vehicle.read(vehicle)
    try:
        return vehicles[choice("vehicle", vehicle, vehicles)]
    except ValueError as error:
        raise ValueError(f"{str(error).rstrip('.')} (a car's file ends in {ENDINGS})") from None


def resolve_tired(
    vehicle: str | os.PathLike[str] | Vehicle | Mapping[str, Any],
    tire: str | os.PathLike[str] | tires.Tire | Mapping[str, Any],
) -> tuple[Vehicle, tires.Tire]:
    """A car and the tire law of both its axles, as :func:`resolve_vehicle` and ``tires.resolve`` take them.

    Where `tire` is a property file (.tir), the car gets its cornering stiffnesses (``Vehicle.with_tires``) and the law
    is the file's at a quarter of the weight, the mean load of a tire. A ``TireFileWarning`` says what is dropped.
    """
    vehicle = resolve_vehicle(vehicle)
    if not is_tire_file(tire):
        return vehicle, tires.resolve(cast("Any", tire))
    file = TireFile.read(cast("str", tire))
    loads = vehicle.front_axle_load / 2.0, vehicle.rear_axle_load / 2.0
    law, tired = tires.MagicFormula.of_file(file, sum(loads) / 2.0), vehicle.with_tires(file)
    before = f"{vehicle.front_cornering_stiffness:.6g} and {vehicle.rear_cornering_stiffness:.6g}"
    front, rear = (f"{file.friction(load):.4g}" for load in loads)
    warnings.warn(
        f"{shown(file.path)}: the axles' cornering stiffnesses are its {tired.front_cornering_stiffness:.6g} and "
        f"{tired.rear_cornering_stiffness:.6g} N/rad at {loads[0]:.4g} and {loads[1]:.4g} N per tire (the vehicle "
        f"had {before}). Its friction, {front} in front and {rear} behind, is not taken: friction= is. "
        f"Dropped: {file.dropped or 'nothing'}.",
        TireFileWarning,
        stacklevel=3,
    )
    return tired, law
