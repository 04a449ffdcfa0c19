"""The report on one car: numbers, and a page with pictures. ``bicycle-env report`` on the command line."""

from bicycle_env.envs.configuration import DEFAULT_SPEED, DEFAULT_SPEED_RATIO
from bicycle_env.report.quantities import as_json, groups
from bicycle_env.report.study import GRID, SPEEDS, Study, compute, study
from bicycle_env.report.text import as_text, vehicles_as_json, vehicles_as_text
from bicycle_env.report.writing import write

__all__ = [
    "DEFAULT_SPEED",
    "DEFAULT_SPEED_RATIO",
    "GRID",
    "SPEEDS",
    "Study",
    "as_json",
    "as_text",
    "compute",
    "groups",
    "study",
    "vehicles_as_json",
    "vehicles_as_text",
    "write",
]
