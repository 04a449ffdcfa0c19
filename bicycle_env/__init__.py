"""Reinforcement learning and control of a car at and beyond its stability limit.

Importing this package registers ``BicycleStab-v0``, ``BicycleLaneChange-v0``, ``BicycleDoubleLaneChange-v0``,
``BicycleActiveSteer-v0`` and ``BicycleEvade-v0`` with Gymnasium.
"""

from typing import Any

from bicycle_env import analysis
from bicycle_env.physics import tires
from bicycle_env.physics.actuators import Actuator
from bicycle_env.physics.presets import register_vehicle, vehicles
from bicycle_env.physics.vehicle import UnitWarning, Vehicle
from bicycle_env.registration import check_task, register
from bicycle_env.simulation import simulate
from bicycle_env.tasks import distributions, disturbances, drivers, rewards
from bicycle_env.tasks.sensors import Sensors

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "Sensors",
    "UnitWarning",
    "Vehicle",
    "__version__",
    "analysis",
    "check_task",
    "distributions",
    "disturbances",
    "drivers",
    "load_policy",
    "plots",
    "register",
    "register_vehicle",
    "rewards",
    "simulate",
    "tires",
    "vehicles",
]


def __getattr__(name: str) -> Any:
    if name == "plots":  # imported when first needed, and matplotlib with the first figure
        import bicycle_env.plots as plots  # "from bicycle_env import" would ask this function again

        return plots
    if name == "load_policy":  # the controllers are imported when first needed, too
        from bicycle_env.control import load_policy

        return load_policy
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
