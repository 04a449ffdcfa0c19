"""Tasks as pure functions: start, reference, observation, reward, end of episode.

What a task of one's own is written with can be imported from here; docs/your_own.md says what each is for.
"""

from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.records import replaced
from bicycle_env.physics.validation import check_fields, choice, number, positive, whole
from bicycle_env.tasks.altered import AlteredTask
from bicycle_env.tasks.disturbances import Disturbance
from bicycle_env.tasks.drivers import Driver
from bicycle_env.tasks.ends import Limits, Tolerances, end_outside
from bicycle_env.tasks.episode import EpisodeState, Reference, Rules, World
from bicycle_env.tasks.lane_change import LaneChange
from bicycle_env.tasks.marks import Mark
from bicycle_env.tasks.metrics import SHARED, Metric
from bicycle_env.tasks.path import (
    DIRECTIONS,
    SIDES,
    check_preview,
    chosen_side,
    observed_on_path,
    path_ahead,
    path_entries,
    quintic_rise,
    times_ahead,
)
from bicycle_env.tasks.rewards import Bounded, Quadratic, Reward
from bicycle_env.tasks.stabilise import Nothing, Stabilise
from bicycle_env.tasks.task import Entry, History, Task, fixed_entries, observed_car

__all__ = [
    "DIRECTIONS",
    "SHARED",
    "SIDES",
    "AlteredTask",
    "Bounded",
    "CarParameters",
    "CarState",
    "Disturbance",
    "Driver",
    "Entry",
    "EpisodeState",
    "History",
    "LaneChange",
    "Limits",
    "Mark",
    "Metric",
    "Nothing",
    "Quadratic",
    "Reference",
    "Reward",
    "Rules",
    "Stabilise",
    "Task",
    "Tolerances",
    "World",
    "check_fields",
    "check_preview",
    "choice",
    "chosen_side",
    "end_outside",
    "fixed_entries",
    "number",
    "observed_car",
    "observed_on_path",
    "path_ahead",
    "path_entries",
    "positive",
    "quintic_rise",
    "replaced",
    "times_ahead",
    "whole",
]
