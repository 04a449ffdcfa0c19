"""What the page is made of: its files, the traced laws of each tire, a trained network, and figures of each preset."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bicycle_env import leaderboard
from bicycle_env.control.four_wheel_steer import REAR_LAWS, Sano
from bicycle_env.control.pretrained import load_policy
from bicycle_env.explore import linear, steering
from bicycle_env.explore.answers import (
    DESIGNED,
    ENV_ID,
    GUST,
    STEER_MODES,
    configuration,
    design,
    portrait,
    recoverable,
)
from bicycle_env.explore.field import FIELD_HALF_WIDTH, AnyWidth
from bicycle_env.export import javascript, policy, task
from bicycle_env.export.command import Uncompiled
from bicycle_env.export.routines import Argument, Library, Routine
from bicycle_env.physics import tires
from bicycle_env.physics.actuators import FRONT, REAR
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.lateral import Axles
from bicycle_env.physics.presets import resolve_vehicle, vehicles
from bicycle_env.plots.style import SPEED, SPEED_RATIO
from bicycle_env.report.words import KINDS, METRES, STABILITY, both_units

FOLDER = Path(__file__).parent / "page"
RATIOS = tuple(round(0.05 * k, 2) for k in range(6, 37))
"""Multiples of the critical speed that the page offers."""
SPEEDS = tuple(2.5 * k for k in range(2, 27))
"""m/s, for a car without a critical speed."""
USUAL_RATIO, USUAL_SPEED = 1.2, 30.0


def page(names: Sequence[str] = tuple(vehicles), served: bool = False) -> dict[str, bytes]:
    """All files of the page, by name.

    Args:
        names: of the presets on it.
        served: whether :class:`Server` is there to be asked; if not, what it would say of each preset as the page
            first shows it is among the files.
    """
    found = {path.name: path.read_bytes() for path in sorted(FOLDER.iterdir()) if path.is_file()}
    found["linear.mjs"] = javascript.module(linear.library()).encode()
    sano = Sano(Uncompiled(configuration()))
    found["steering.mjs"] = javascript.module(steering.library(sano)).encode()
    for tire in tires.LAWS:
        for relaxed in (False, True):
            made = traced(tire, relaxed)
            found[f"{made.name}.mjs"] = javascript.module(made).encode()
    found["policy.mjs"] = policy.javascript_module(load_policy(ENV_ID), "policy").encode()
    found["data.mjs"] = f"export const data = {json.dumps(data(names, served), allow_nan=False)};\n".encode()
    return found


def traced(tire: str, relaxed: bool = False) -> Library:
    """The environment on a tire, with a gust, and the forces of its axles; `relaxed`: tires take a way to answer."""
    made = configuration(
        task=AnyWidth(),
        tire=tire,
        relaxation_length=0.5 if relaxed else None,
        disturbances=({**GUST, "force": 0.0, "side": "left"},),
    )
    axles = Routine(
        "axles",
        "Slip angles and lateral forces of both axles in a state, and the accelerations that they cause.",
        (Argument("state", made.model.State), Argument("car", CarParameters)),
        (Argument("acting", Axles, "axle_forces"),),
        lambda xp: made.model.axles(xp, False),
    )
    library = task.library(made, ENV_ID, f"task_{tire}{'_relaxed' if relaxed else ''}")
    return dataclasses.replace(library, routines=(*library.routines, axles))


def data(names: Sequence[str], served: bool) -> dict[str, Any]:
    """What is no traced law: the presets, what is designed for each of their speeds, and the words for all of it."""
    network = load_policy(ENV_ID)
    usual = configuration(**network.description["env_keywords"])
    there = both_units(usual.vehicle, usual.speed)
    return {
        "env_id": ENV_ID,
        "served": served,
        "tires": list(tires.LAWS),
        "half_width": {"lane": usual.task.road_half_width, "field": FIELD_HALF_WIDTH},
        "tolerances": dataclasses.asdict(usual.task.tolerances),
        "actuators": {"front": dataclasses.asdict(FRONT), "rear": dataclasses.asdict(REAR)},
        "observation_names": [entry.name for entry in usual.observation_entries],
        "gust": GUST,
        "words": {"kinds": KINDS, "stability": STABILITY, "speed": METRES + SPEED, "ratio": SPEED_RATIO},
        "trained": f"The policy was trained on the car {usual.vehicle.name} at {there}, tire {usual.tire.name}, "
        f"friction {usual.friction:g}; on anything else it drives what it has never seen.",
        "compared": _compared(network.description["env_keywords"]["level"]),
        "presets": {name: _preset(name, served) for name in names},
    }


def _compared(level: str) -> str:
    """How often the trained policy, LQR as the page has it, and search bring the car back, from the leaderboard."""
    rows = {row["name"]: row for row in leaderboard.read()["levels"][f"{ENV_ID} {level}"]["rows"]}
    trained, classical, best = (rows[name] for name in ("pretrained", "lqr, as shipped", "best found"))
    (low, high), (least, most) = (row["success_rate"]["interval"] for row in (trained, classical))
    alike = "and LQR do equally well, as far as these starts tell"
    words = "does better than LQR" if low > most else "does worse than LQR" if high < least else alike

    def share(row: dict[str, Any]) -> str:
        found, (from_, to) = row["success_rate"]["value"], row["success_rate"]["interval"]
        return f"{100 * found:.1f} % (95 % interval {100 * from_:.1f} to {100 * to:.1f})"

    return (
        f"Counted over {trained['starts']} random starts in a lane ({ENV_ID}, level {level}), the learned policy "
        f"{words}: in the end the car runs straight after {share(trained)} of them, with LQR after "
        f"{share(classical)}. With the best steering that a search has found for each of {best['starts']} starts it is "
        f"{share(best)}. From: bicycle-env leaderboard."
    )


def _preset(name: str, served: bool) -> dict[str, Any]:
    vehicle = resolve_vehicle(name)
    critical = vehicle.critical_speed
    given = [{"speed": speed} for speed in SPEEDS] if math.isinf(critical) else [{"speed_ratio": r} for r in RATIOS]
    usual = USUAL_SPEED if math.isinf(critical) else USUAL_RATIO * critical
    return {
        "source": vehicle.source,
        "body": {field: getattr(vehicle, field) for field in linear.BODY},
        "critical_speed": None if math.isinf(critical) else critical,
        "points": [_point(name, served, **words) for words in given],
        "exported": None
        if served
        else {
            "metres_per_second": usual,
            "portrait": portrait(vehicle, usual, "fiala", 1.0),
            "recoverable": recoverable(vehicle, usual, "fiala", 1.0, "both", lambda _: None),
        },
    }


def _point(name: str, served: bool, **words: float) -> dict[str, Any]:
    """`words`: the speed, or its ratio to the critical one, as the environments take them."""
    speed = configuration(vehicle=name, **words).speed
    vehicle = resolve_vehicle(name)
    # What a server is there to be asked is left out, but for what most visitors want to see follow the slider at once.
    modes, others = (STEER_MODES[:1], REAR_LAWS) if served else (STEER_MODES, DESIGNED[1:])
    designs = {f"lqr {steer}": design(vehicle, speed, "lqr", steer) for steer in modes}
    designs |= {policy: design(vehicle, speed, policy) for policy in others}
    return {**words, "metres_per_second": speed, "designs": designs}
