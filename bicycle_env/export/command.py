"""What ``bicycle-env export`` does with its words."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bicycle_env import export
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.validation import choice, known_keys


def run(chosen: argparse.Namespace, tell: Callable[[str], None]) -> list[Path]:
    """Export what the words ask for; the paths of what was written.

    Raises:
        ValueError, TypeError: a bad value, in one line.
        OSError, ModuleNotFoundError: a folder that cannot be written to; something that is not installed.
    """
    choice("--format", chosen.format, export.FORMATS)
    if chosen.fma and chosen.format != "c":
        raise ValueError("--fma goes with --format c: the other formats' multiply-add rounds twice")
    plant = export.plant(
        chosen.vehicle,
        chosen.tire,
        speed=chosen.speed,
        speed_ratio=chosen.speed_ratio,
        friction=chosen.friction,
        geometry=chosen.geometry,
        relaxation_length=chosen.relaxation_length,
        front_actuator=_actuator("--front-actuator", chosen.front_actuator, FRONT),
        rear_actuator=_actuator("--rear-actuator", chosen.rear_actuator, REAR),
        physics_timestep=chosen.physics_timestep,
        pushed=chosen.pushed,
    )
    tell(str(plant))
    return export.export_plant(plant, chosen.format, chosen.out, fma=chosen.fma)


def _actuator(name: str, words: str | None, usual: Any) -> Any:
    """``angle_limit=0.1,rate_limit=0.7``: the usual actuator with other numbers."""
    if words is None:
        return usual
    fields = dict(pair.partition("=")[::2] for pair in words.split(","))
    known_keys(f"field of {name}", fields, usual.__dataclass_fields__)
    try:
        return {**vars(usual), **{field: float(value) for field, value in fields.items()}}
    except ValueError:
        raise ValueError(f"{name} must be FIELD=NUMBER,... of {', '.join(vars(usual))}, got {words!r}") from None
