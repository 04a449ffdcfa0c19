"""What ``bicycle-env export`` does with its words."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gymnasium import spaces

from bicycle_env import export
from bicycle_env.control.network import read
from bicycle_env.control.pretrained import PRETRAINED, load_policy
from bicycle_env.control.registry import make
from bicycle_env.envs.configuration import Configuration
from bicycle_env.export.fmu import can_compile
from bicycle_env.export.task import configuration_of
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.validation import known_keys

CAR = ("vehicle", "tire", "speed", "speed_ratio", "friction", "geometry", "relaxation_length", "physics_timestep")
USUAL_ID = "BicycleStab-v0"
"""Of the environment that a controller is designed for."""


class Uncompiled:
    """A configuration as a controller sees an environment when it is designed; nothing is compiled for it."""

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self.observation_names = tuple(entry.name for entry in configuration.observation_entries)
        self.action_space = spaces.Box(-1.0, 1.0, (configuration.axles,))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._configuration, name)


def run(chosen: argparse.Namespace, tell: Callable[[str], None]) -> list[Path]:
    """Export what the words ask for; the paths of what was written.

    Raises:
        ValueError, TypeError: a bad value, in one line.
        OSError, ModuleNotFoundError: a folder that cannot be written to; something that is not installed.
    """
    given: dict[str, Any] = {name: getattr(chosen, name) for name in CAR if getattr(chosen, name) is not None}
    for name, usual in (("front_actuator", FRONT), ("rear_actuator", REAR)):
        if (words := getattr(chosen, name)) is not None:
            given[name] = _actuator(f"--{name.replace('_', '-')}", words, usual)
    if chosen.policy is None and chosen.env_id is None:
        if chosen.level is not None:
            raise ValueError("--level goes with --env-id")
        plant = export.plant(**given, pushed=chosen.pushed)
        paths = export.export_plant(plant, chosen.format, chosen.out, fma=chosen.fma)
        tell(str(plant))
        if chosen.format == "fmu" and not can_compile():
            tell("no gcc for linux64 here: the FMU holds its C sources, and no binary")
        return paths
    if chosen.pushed:
        raise ValueError("--pushed goes with a plant: without --env-id and --policy")
    if chosen.level is not None:
        given["level"] = chosen.level
    if chosen.policy is None:
        return export.export_task(chosen.env_id, chosen.format, chosen.out, fma=chosen.fma, **given)
    if chosen.fma:
        raise ValueError("--fma goes with a plant or a task: a policy is of single precision")
    return _policy(chosen, given)


def _policy(chosen: argparse.Namespace, given: dict[str, Any]) -> list[Path]:
    names = None
    if chosen.policy == PRETRAINED:
        policy: Any = load_policy(chosen.env_id or USUAL_ID, given.pop("level", None))
        _refuse(given, f"--policy {PRETRAINED}")
    elif Path(chosen.policy).exists():
        policy = read(chosen.policy)
        _refuse(given, "a policy's folder")
    else:
        plant = Uncompiled(configuration_of(chosen.env_id or USUAL_ID, **given))
        policy, names = make(chosen.policy, plant), plant.observation_names
    return export.export_policy(policy, chosen.format, chosen.out, observation_names=names)


def _refuse(given: dict[str, Any], beside: str) -> None:
    if given:
        raise ValueError(f"--{next(iter(given)).replace('_', '-')} has no meaning with {beside}: it is what it is")


def _actuator(name: str, words: str, usual: Any) -> Any:
    """``angle_limit=0.1,rate_limit=0.7``: the usual actuator with other numbers."""
    fields = dict(pair.partition("=")[::2] for pair in words.split(","))
    known_keys(f"field of {name}", fields, vars(usual))
    try:
        return {**vars(usual), **{field: float(value) for field, value in fields.items()}}
    except ValueError:
        raise ValueError(f"{name} must be FIELD=NUMBER,... of {', '.join(vars(usual))}, got {words!r}") from None
