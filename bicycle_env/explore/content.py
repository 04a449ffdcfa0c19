"""What the page is made of: its files, the traced laws of each tire, a trained network, and figures of each preset."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bicycle_env import analysis
from bicycle_env.control.pretrained import load_policy
from bicycle_env.control.registry import make
from bicycle_env.export import javascript, policy, task
from bicycle_env.export.command import Uncompiled
from bicycle_env.export.routines import Argument, Library, Routine
from bicycle_env.physics import tires
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters, car_on_road
from bicycle_env.physics.presets import resolve_vehicle, vehicles
from bicycle_env.physics.records import record_of
from bicycle_env.plots.style import speed_in_words
from bicycle_env.report.words import stability_in_words

FOLDER = Path(__file__).parent / "page"
ENV_ID = "BicycleStab-v0"
"""Whose episodes are driven on the page."""
RATIOS = tuple(round(0.05 * k, 2) for k in range(6, 37))
"""Multiples of the critical speed that the page offers."""
SPEEDS = tuple(2.5 * k for k in range(2, 27))
"""m/s, for a car without a critical speed."""
BODY = (
    *("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "front_cornering_stiffness", "rear_cornering_stiffness"),
    *("front_axle_load", "rear_axle_load", "front_extent", "rear_extent", "body_width"),
)
"""What ``car_on_road`` reads of a vehicle."""


def page(names: Sequence[str] = tuple(vehicles)) -> dict[str, bytes]:
    """All files of the page, by name; `names`: of the presets on it."""
    found = {path.name: path.read_bytes() for path in sorted(FOLDER.iterdir()) if path.is_file()}
    for tire in tires.LAWS:
        found[f"task_{tire}.mjs"] = javascript.module(traced(tire)).encode()
    found["policy.mjs"] = policy.javascript_module(load_policy(ENV_ID), "policy").encode()
    found["data.mjs"] = f"export const data = {json.dumps(data(names), allow_nan=False)};\n".encode()
    return found


def traced(tire: str) -> Library:
    """The environment on a tire, and ``on_road``: a preset's numbers at a speed on a road."""
    body = Argument("vehicle", record_of("Body", BODY))
    on_road = Routine(
        "on_road",
        "The car at a speed [m/s], with the usual actuators, on a road of this friction.",
        (body, Argument("speed"), Argument("friction")),
        (Argument("placed", CarParameters, "car"),),
        lambda _: lambda vehicle, speed, friction: car_on_road(vehicle, speed, friction, FRONT, REAR),
    )
    library = task.library(task.configuration_of(ENV_ID, tire=tire), ENV_ID, f"task_{tire}")
    return dataclasses.replace(library, routines=(*library.routines, on_road))


def data(names: Sequence[str]) -> dict[str, Any]:
    """What is no traced law: for each preset at each speed its eigenvalues, their meaning in words, and LQR's gains."""
    usual = task.configuration_of(ENV_ID, **load_policy(ENV_ID).description["env_keywords"])
    there = speed_in_words(usual.vehicle, usual.speed)
    return {
        "env_id": ENV_ID,
        "tires": list(tires.LAWS),
        "half_width": usual.task.road_half_width,
        "trained": f"The policy was trained on the car {usual.vehicle.name} at {there}, tire {usual.tire.name}, "
        f"friction {usual.friction:g}; on anything else it drives what it has never seen.",
        "presets": {name: _preset(name) for name in names},
    }


def _preset(name: str) -> dict[str, Any]:
    vehicle = resolve_vehicle(name)
    critical = vehicle.critical_speed
    given = [{"speed": speed} for speed in SPEEDS] if math.isinf(critical) else [{"speed_ratio": r} for r in RATIOS]
    return {
        "source": vehicle.source,
        "body": {field: getattr(vehicle, field) for field in BODY},
        "critical_speed": None if math.isinf(critical) else critical,
        "points": [_point(name, **words) for words in given],
    }


def _point(name: str, **words: float) -> dict[str, Any]:
    """`words`: the speed, or its ratio to the critical one, as the environments take them."""
    configuration = task.configuration_of(ENV_ID, vehicle=name, **words)
    vehicle, speed = configuration.vehicle, configuration.speed
    lqr: Any = make("lqr", Uncompiled(configuration))
    eigenvalues = np.sort_complex(analysis.eigenvalues(vehicle, speed))
    return {
        **words,
        "metres_per_second": speed,
        "heading": speed_in_words(vehicle, speed),
        "sentence": stability_in_words(vehicle, speed),
        "eigenvalues": [[value.real, value.imag] for value in eigenvalues.tolist()],
        "lqr": lqr.matrix.T.tolist(),
    }
