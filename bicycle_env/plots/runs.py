"""What a user may hand to a figure as a run, brought to one form: arrays by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.physics.car import CarState, car_on_road
from bicycle_env.physics.elementary import NUMPY
from bicycle_env.physics.validation import checked_speed
from bicycle_env.tasks.episode import World
from bicycle_env.tasks.marks import checked

Columns = dict[str, NDArray[np.float64]]
NEEDED = ("time", *(name for name in CarState._fields if name != "heading"))
"""Names that a run must have."""


def columns(run: Any, name: str, speed: float | None) -> Columns:
    """A run as arrays of one length by name, with ``sideslip`` = V / U among them.

    Args:
        run: a mapping of names to arrays, or a sequence of named tuples of the state.
        name: how errors call the run.
        speed: m/s; needed where the run holds no sideslip.

    Raises:
        ValueError, TypeError: the run is neither, is empty, lacks a name, or has values that are no finite numbers.
    """
    found = _columns(run, name)
    missing = [needed for needed in NEEDED if needed not in found]
    if missing:
        raise ValueError(f"{name} lacks {', '.join(map(repr, missing))}; it has {', '.join(map(repr, found))}")
    shapes = {found[needed].shape for needed in NEEDED}
    if len(shapes) > 1 or found["time"].ndim != 1 or found["time"].size == 0:
        raise ValueError(f"{name} must hold arrays of one length >= 1, got the shapes {sorted(shapes)}")
    for needed in NEEDED:
        if not np.all(np.isfinite(found[needed])):
            raise ValueError(f"{name}[{needed!r}] must be finite")
    if "sideslip" not in found and "speed" in found:
        found["sideslip"] = found["lateral_velocity"] / found["speed"]
    if "sideslip" not in found:
        if speed is None:
            raise ValueError(f"{name} holds no 'sideslip': give env=, or speed= in m/s")
        found["sideslip"] = found["lateral_velocity"] / checked_speed(speed)
    return found


def _columns(run: Any, name: str) -> Columns:
    if isinstance(run, Mapping):
        named = run
    elif isinstance(run, Sequence) and len(run) > 0 and all(hasattr(state, "_asdict") for state in run):
        named = dict(zip(run[0]._fields, zip(*run, strict=True), strict=True))
    else:
        raise TypeError(
            f"{name} must be a mapping of names to arrays, as simulate returns it, or a list of env.unwrapped.state, "
            f"got {type(run).__name__}{' without entries' if isinstance(run, Sequence) and len(run) == 0 else ''}"
        )
    try:
        return {str(key): np.asarray(values, dtype=np.float64) for key, values in named.items()}
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must hold arrays of numbers: {error}") from None


PLACES = 1000


class Road:
    """The corridor and the path to follow of an environment's task, for the route that a run was on."""

    def __init__(self, env: Any, run: Columns, length: float) -> None:
        self._task = env.task
        car = car_on_road(env.vehicle, env.speed, env.friction, env.front_actuator, env.rear_actuator)
        self._world = World(car, env.rules, env.task.settings(env.speed))
        self.route = tuple(float(run[name][0]) for name in env.task.TaskState._fields)
        """What the task drew at the start of the run."""
        self.places = np.linspace(0.0, max(length, 1.0), PLACES)
        """Along the road, m."""
        self.path = self._along("lateral_position")
        """Lateral positions of the path to follow there, m."""
        centre, half = self._along("road_centre"), self._along("road_half_width")
        self.marks = checked(env.task.marks(env.task.TaskState(*self.route), self._world))
        self.edges = (centre - half, centre + half)
        """Lateral positions of the right and the left edge, m."""
        self.has_path = bool(np.any(self.path != self.path[0]))
        """Whether the path to follow is more than the middle of the lane."""

    def _along(self, name: str) -> NDArray[np.float64]:
        state = CarState(**{**dict.fromkeys(CarState._fields, 0.0 * self.places), "longitudinal_position": self.places})
        reference = self._task.reference(NUMPY)(state, self._task.TaskState(*self.route), self._world)
        return np.broadcast_to(np.asarray(getattr(reference, name), dtype=np.float64), self.places.shape)
