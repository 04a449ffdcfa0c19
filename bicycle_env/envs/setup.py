"""The keywords of an environment, all but its task's own: one field is one keyword, with its default."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.actuators import FRONT, REAR, Actuator
from bicycle_env.physics.tires import Tire
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.tasks.rewards import Reward


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """What makes an environment from a task, as a user gave it: for one car, many and tensors. ``configure`` checks it.

    A row of the tables in the environments' docstrings says what each means.
    """

    vehicle: str | Vehicle | Mapping[str, Any] = "oversteer"
    tire: str | Tire | Mapping[str, Any] = "fiala"
    speed: float | None = None
    speed_ratio: float | None = None
    steer: str = "both"
    friction: float = 1.0
    geometry: str | None = None
    relaxation_length: float | None = None
    front_actuator: Actuator | Mapping[str, Any] = FRONT
    rear_actuator: Actuator | Mapping[str, Any] = REAR
    control_timestep: float = 0.02
    physics_timestep: float = 0.004
    reward: str | Reward | Mapping[str, Any] = "default"
    horizon: int | None = None
    randomise: Mapping[str, Any] | None = None
    disturbances: Any = ()
    driver: Any = None
    action_delay: int = 0
    observation_delay: int = 0
    action_repeat: int = 1
    sensors: Any = None


NAMES = tuple(field.name for field in dataclasses.fields(Setup))
ADDED = ("randomise", "disturbances", "driver", "action_delay", "observation_delay", "sensors")
"""Those that are added to a task: the arguments of ``tasks.options.altered``."""


def taken_from(keywords: dict[str, Any], defaults: Mapping[str, Any]) -> Setup:
    """The setup of some keywords, the task's `defaults` where they say nothing.

    They are taken out, and what is left is the task's.
    """
    return Setup(**{**defaults, **{name: keywords.pop(name) for name in NAMES if name in keywords}})


def shown(signature: inspect.Signature, defaults: Mapping[str, Any]) -> inspect.Signature:
    """What a class that takes ``**keywords`` shows: the fields of Setup, with a task's defaults, before its own."""
    fields = [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=defaults.get(field.name, field.default),
            annotation=field.type,
        )
        for field in dataclasses.fields(Setup)
    ]
    return inspect.Signature([*fields, *signature.parameters.values()])
