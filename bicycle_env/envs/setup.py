"""The keywords of an environment, all but its task's own: one field is one keyword, with its default."""

from __future__ import annotations

import dataclasses
import inspect
import os
from collections.abc import Mapping
from typing import Any

from bicycle_env.physics.actuators import FRONT, REAR, Actuator
from bicycle_env.physics.presets import resolve_tired
from bicycle_env.physics.tires import Tire, is_tire_file
from bicycle_env.physics.vehicle import Vehicle
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.rewards import Reward
from bicycle_env.tasks.task import Task


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
    history: int = 1
    level: str | None = None


NAMES = tuple(field.name for field in dataclasses.fields(Setup))
ADDED = ("randomise", "disturbances", "driver", "action_delay", "observation_delay", "sensors", "history")
"""Those that are added to a task: the arguments of ``tasks.options.altered``."""
ONE_CAR = ("telemetry", "render_mode")
"""Keywords of the single environment that are no part of a car."""
OF_MAKERS = (
    *("id", "env_id", "num_envs", "max_episode_steps", "vectorization_mode", "vector_kwargs", "wrappers", "seed"),
    *("disable_env_checker", "autoreset_mode", "staggered_start", "on_invalid", "dtype", "threads", "device"),
    *("compile", "varied", "telemetry", "render_mode", "render_rows"),
)
"""Keywords of what makes environments: of ``gym.make``, ``gym.make_vec`` and ``TorchVectorEnv``."""


def taken_from(keywords: dict[str, Any]) -> Setup:
    """The setup of some keywords; they are taken out, and what is left is the task's.

    A tire's property file is read here, once: what a reset changes of a car later finds the law.
    """
    setup = Setup(**{name: keywords.pop(name) for name in NAMES if name in keywords})
    if not is_tire_file(setup.tire):
        return setup
    if not isinstance(setup.vehicle, (str, os.PathLike, Vehicle, Mapping)):
        raise ValueError(
            f"tire: a property file goes with one vehicle, as it sets its stiffnesses; got {setup.vehicle!r}: give "
            "each its vehicle.with_tires(...), and tires.MagicFormula.read(...) as the tire"
        )
    vehicle, tire = resolve_tired(setup.vehicle, setup.tire)
    return dataclasses.replace(setup, vehicle=vehicle, tire=tire)


def check_names(task: Task) -> None:
    """ValueError for a task with a field or a reset option that nobody could set: environments take that name."""
    own = task
    while isinstance(own, AlteredTask):  # its options may be a car's on purpose: of what it draws
        own = own.task
    name = f"task {type(task).__name__}"
    for field in inspect.signature(type(task)).parameters:
        if field in (*NAMES, *OF_MAKERS):
            raise ValueError(f"{name}: its field {field!r} must have another name: environments have a keyword of this")
    for option in own.options:
        if option in ("state", "reset_mask", *NAMES):
            raise ValueError(f"{name}: its reset option {option!r} must have another name: environments take this one")


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
