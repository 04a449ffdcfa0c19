"""Steering actuators: angle limit, rate limit, first-order lag."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

from bicycle_env.physics.validation import explain_keywords, from_fields, in_range, in_range_or_infinite


@explain_keywords
@dataclasses.dataclass(frozen=True)
class Actuator:
    """One steered axle: the command, clipped to the angle limit, is followed with a lag and at a limited rate.

    ``steer' = clip((command - steer) / time_constant, -rate_limit, rate_limit)``. Values must be in
    the ranges given (ValueError, TypeError otherwise); ``rate_limit=math.inf`` switches that limit off, a small time
    constant makes the lag small.
    """

    angle_limit: float
    """Largest road-wheel angle, rad; an action of 1 commands it. In [1e-6, 1.57]."""
    rate_limit: float = math.inf
    """Largest road-wheel rate, rad/s; infinite, or in [1e-6, 1e6]."""
    time_constant: float = 0.05
    """Lag of the road wheel behind its command, s; in [1e-4, 100]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle_limit", in_range("angle_limit", self.angle_limit))
        object.__setattr__(self, "rate_limit", in_range_or_infinite("rate_limit", self.rate_limit))
        object.__setattr__(self, "time_constant", in_range("time_constant", self.time_constant))


FRONT = Actuator(angle_limit=math.radians(6.0), rate_limit=math.radians(40.0), time_constant=0.05)
"""Steer by wire at speed. 6 deg: simulations of fast cars need no more than 4-6 deg (Astrom and Murray, Feedback
Systems, book issue 27). 40 deg/s: a steering wheel at 600 deg/s through a ratio of 15; drivers in emergencies average
520 deg/s (Rice 1976). 0.05 s: first-order steering model of TUMFTM/Open-Car-Dynamics (0.05-0.06 s, 29-57 deg/s)."""

REAR = Actuator(angle_limit=math.radians(3.0), rate_limit=math.radians(9.0), time_constant=0.05)
"""Active rear axle. 3 deg: BMW X7 and ZF AKC. 9 deg/s: ZF AKC in the Porsche 911 Turbo S, 40 mm/s where 13.5 mm is
3 deg. No source gives the lag: the front one's is assumed."""


def resolve(name: str, actuator: Actuator | Mapping[str, Any]) -> Actuator:
    """An actuator from its fields by their names, or from itself; `name` is the keyword's, for the errors.

    Raises:
        ValueError: an unknown field, with the nearest known one; a missing field; a bad value.
        TypeError: neither an Actuator nor a mapping; a value of the wrong type.
    """
    if isinstance(actuator, Actuator):
        return actuator
    if isinstance(actuator, Mapping):
        return from_fields(name, Actuator, actuator)
    raise TypeError(
        f"{name} must be an Actuator(angle_limit, rate_limit, time_constant) or a dict of its fields, got {actuator!r}"
    )


def steer_rate(xp: Any) -> Callable[[Any, Any, Any, Any], Any]:
    """The actuator's law ``(steer, command, rate_limit, time_constant) -> rad/s``; the command is within its limit."""

    def steer_rate(steer: Any, command: Any, rate_limit: Any, time_constant: Any) -> Any:
        rate = (command - steer) * (1.0 / time_constant)
        return xp.maximum(xp.minimum(rate, rate_limit), -rate_limit)

    return steer_rate
