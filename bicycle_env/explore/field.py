"""The page's task: that of its environment, in a lane or on an open field."""

from __future__ import annotations

import dataclasses
from typing import Any

from bicycle_env.physics.car import CarState
from bicycle_env.physics.records import record_of
from bicycle_env.tasks.episode import Reference, World
from bicycle_env.tasks.stabilise import Nothing, Stabilise, StartBox

FIELD_HALF_WIDTH = 1000.0
"""m."""


@dataclasses.dataclass(frozen=True)
class AnyWidth(Stabilise):
    """``Stabilise``, but for the half-width of its lane [m]: a number of the settings, by default the same."""

    Settings = record_of("FieldBox", (*StartBox._fields, "road_half_width"))

    def settings(self, speed: float) -> Any:
        return self.Settings(*super().settings(speed), float(self.road_half_width))

    def reference(self, xp: Any) -> Any:
        narrow = super().reference(xp)

        def reference(state: CarState, task_state: Nothing, world: World) -> Reference:
            found: Reference = narrow(state, task_state, world)
            return found._replace(road_half_width=world.settings.road_half_width)

        return reference
