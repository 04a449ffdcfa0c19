"""What the page asks Python: controllers for any car, and the phase plane's steady turns, edges and recoverable set."""

from __future__ import annotations

import dataclasses
import json
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bicycle_env import analysis
from bicycle_env.control.driver import Preview
from bicycle_env.control.four_wheel_steer import REAR_LAWS
from bicycle_env.control.registry import make
from bicycle_env.explore.linear import BODY
from bicycle_env.explore.steering import numbers_of
from bicycle_env.export import task
from bicycle_env.export.command import Uncompiled
from bicycle_env.files import number_in, one_of, parse_json, table
from bicycle_env.physics import tires
from bicycle_env.physics.actuators import FRONT, REAR, Actuator
from bicycle_env.physics.presets import resolve_vehicle, vehicles
from bicycle_env.physics.validation import RANGES
from bicycle_env.physics.vehicle import UnitWarning, Vehicle

ENV_ID = "BicycleStab-v0"
"""Whose episodes are driven on the page."""
STEER_MODES = ("both", "front", "rear")
GUST = {"name": "gust", "start": 1.0, "duration": 0.5, "arm": 0.3}
"""Of which the page chooses force and side."""
SIDESLIP, YAW_RATE = 0.5, 1.2
"""rad, rad/s: the half-widths of the phase plane."""
NODES = 121
"""Of the recoverable set, in each direction."""
DIGITS = 4
"""Of what is drawn only."""
MOST_KNOWN = 64
LARGEST = 4096
"""Bytes of a question."""
DESIGNED = ("lqr", *REAR_LAWS, Preview.name, *(f"{Preview.name}+{law}" for law in REAR_LAWS))
"""What is designed for a car and a speed: LQR, the laws of the rear wheels, the driver who looks ahead with them."""
ACTUATOR = table({field: number_in(*RANGES[field]) for field in ("angle_limit", "time_constant")})
QUESTION = table(
    {"ask": one_of(("design", "portrait", "recoverable")), "vehicle": one_of(vehicles), "speed": number_in(0.1, 200.0)},
    {
        "changes": table({}, {field: number_in(*RANGES["mass"]) for field in BODY[:6]}),
        "tire": one_of(tires.LAWS),
        "friction": number_in(0.05, 2.0),
        "steer": one_of(STEER_MODES),
        "policy": one_of(DESIGNED),
        "front_actuator": ACTUATOR,
        "rear_actuator": ACTUATOR,
    },
)


class SupersededError(Exception):
    """A newer question came, or nobody waits for the answer any more."""


class Answers:
    """Answers questions in JSON; what takes long, one at a time, the newest first. Remembers the last few."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, bytes] = OrderedDict()
        self._guard, self._at_work = threading.Lock(), threading.Lock()
        self._newest = 0

    def answer(self, question: bytes, gone: Callable[[], bool] = lambda: False) -> bytes:
        """The answer in JSON; `gone`: whether nobody waits for it any more.

        Raises:
            ValueError, TypeError: a question that is not understood, or that has no answer, in one line.
            SupersededError: a newer question came before the answer was found.
        """
        asked = parse_json(question, "question", QUESTION, LARGEST)
        key = json.dumps(asked, sort_keys=True)
        with self._guard:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnitWarning)  # a slider's end is no mistake of units
            vehicle = dataclasses.replace(resolve_vehicle(asked["vehicle"]), **asked.get("changes", {}))
        arguments = (vehicle, asked["speed"])
        road = (asked.get("tire", "fiala"), asked.get("friction", 1.0))
        steer = asked.get("steer", "both")
        actuators = tuple(
            dataclasses.replace(usual, **asked.get(f"{axle}_actuator", {}))
            for axle, usual in (("front", FRONT), ("rear", REAR))
        )
        if asked["ask"] == "design":
            found: Any = design(*arguments, asked.get("policy", "lqr"), steer, actuators)
        else:
            with self._guard:
                self._newest += 1
                mine = self._newest

            def check(_: float = 0.0) -> None:
                if self._newest != mine or gone():
                    raise SupersededError

            with self._at_work:
                check()
                try:
                    found = (
                        portrait(*arguments, *road)
                        if asked["ask"] == "portrait"
                        else recoverable(*arguments, *road, steer, check, actuators)
                    )
                except analysis.IntractableError as error:
                    raise ValueError(str(error)) from None
        content = json.dumps(found, allow_nan=False).encode()
        with self._guard:
            self._known[key] = content
            while len(self._known) > MOST_KNOWN:
                self._known.popitem(last=False)
        return content


def configuration(**keywords: Any) -> Any:
    """Of the page's environment with these keywords."""
    return task.configuration_of(ENV_ID, **keywords)


def design(
    vehicle: Vehicle, speed: float, policy: str, steer: str = "both", actuators: Sequence[Actuator] = (FRONT, REAR)
) -> dict[str, Any]:
    """One of DESIGNED in numbers.

    ``weights`` (axles, entries): what an observation is multiplied by to be the action; ``delay``: so many control
    steps later; ``rear``: the numbers of a law of the rear wheels.
    """
    front, rear = actuators
    given = {"vehicle": vehicle, "speed": speed, "steer": steer, "front_actuator": front, "rear_actuator": rear}
    plant = Uncompiled(configuration(**given))
    if policy in REAR_LAWS:
        return {"rear": numbers_of(REAR_LAWS[policy](plant))}
    made: Any = make(policy, plant)
    if policy == "lqr":
        return {"weights": made.matrix.T.tolist()}
    driver, law = (made, None) if policy == Preview.name else (made.driver, made.law)
    weights = driver.weights / front.angle_limit
    found = {"weights": [weights.tolist()], "delay": driver.delay_steps}
    return found if law is None else {**found, "rear": numbers_of(law)}


def portrait(vehicle: Vehicle, speed: float, tire: str, friction: float) -> dict[str, Any]:
    """Steady turns with straight wheels, and the edges between states with different fates; sideslip [rad], rad/s."""
    found = analysis.phase_portrait(
        vehicle,
        speed,
        tire=tire,
        friction=friction,
        sideslip_limit=SIDESLIP,
        yaw_rate_limit=YAW_RATE,
        grid=(2, 2),
        trajectories=0,
    )
    edges = [half.orbit for half in found.manifolds if half.stability == "stable"]
    return {
        "equilibria": [
            {"sideslip": turn.sideslip, "yaw_rate": turn.yaw_rate, "kind": turn.kind} for turn in found.equilibria
        ],
        "edges": [_thinned(np.column_stack([orbit.lateral_velocity / speed, orbit.yaw_rate])) for orbit in edges],
    }


def _thinned(points: Any) -> list[list[float]]:
    """About every fiftieth of the box a point; the ends stay."""
    way = np.cumsum(np.max(np.abs(np.diff(points, axis=0, prepend=points[:1])) / (SIDESLIP, YAW_RATE), axis=1))
    steps = np.floor(way / 0.02)
    kept = np.append(np.flatnonzero(np.diff(steps, prepend=-1.0)), len(points) - 1)
    rounded: list[list[float]] = np.round(points[np.unique(kept)], DIGITS).tolist()
    return rounded


def recoverable(
    vehicle: Vehicle,
    speed: float,
    tire: str,
    friction: float,
    steer: str,
    progress: Callable[[float], None],
    actuators: Sequence[Actuator] = (FRONT, REAR),
) -> dict[str, Any]:
    """From which states some steering brings the car back: rows of yaw rates, each a row of bits in hexadecimal."""
    found = analysis.recoverable_set(
        vehicle,
        speed,
        tire=tire,
        friction=friction,
        steer=steer,
        steer_limits=(actuators[0].angle_limit, actuators[1].angle_limit),
        grid=(NODES, NODES),
        progress=progress,
    )
    bits = np.isfinite(found.least_time).T.astype(int)
    rows = [f"{int(''.join(map(str, row)), 2):x}" for row in bits.tolist()]
    return {"sideslip": found.sideslip_limit, "yaw_rate": found.yaw_rate_limit, "nodes": NODES, "rows": rows}
