"""The cars that come with the package, each with its source: ``bicycle_env.vehicles``."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from bicycle_env.physics.validation import choice
from bicycle_env.physics.vehicle import Vehicle

_BODY: Any = {"mass": 1500.0, "yaw_inertia": 2500.0, "cg_to_front": 1.4, "cg_to_rear": 1.3}
_BODY_SOURCE = (
    "This package: a mid-size body (1500 kg, wheelbase 2.7 m) shared by `oversteer`, `neutral` and `understeer`; only "
    "the two cornering stiffnesses differ. "
)

vehicles: Mapping[str, Vehicle] = MappingProxyType(
    {
        "oversteer": Vehicle(
            **_BODY,
            front_cornering_stiffness=110e3,
            rear_cornering_stiffness=90e3,
            source=_BODY_SOURCE + "a Cf > b Cr: unstable above 36.1 m/s.",
        ),
        "neutral": Vehicle(
            **_BODY,
            front_cornering_stiffness=97.5e3,
            rear_cornering_stiffness=105e3,
            source=_BODY_SOURCE + "a Cf = b Cr exactly.",
        ),
        "understeer": Vehicle(
            **_BODY,
            front_cornering_stiffness=90e3,
            rear_cornering_stiffness=110e3,
            source=_BODY_SOURCE + "a Cf < b Cr: stable at every speed.",
        ),
        "me303": Vehicle(
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


def resolve_vehicle(vehicle: str | Vehicle) -> Vehicle:
    """A preset by its name, or the Vehicle itself; ValueError or TypeError otherwise."""
    if isinstance(vehicle, Vehicle):
        return vehicle
    if not isinstance(vehicle, str):
        raise TypeError(f"vehicle must be a Vehicle or one of {', '.join(map(repr, vehicles))}, got {vehicle!r}")
    return vehicles[choice("vehicle", vehicle, vehicles)]
