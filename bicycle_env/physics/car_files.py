"""A user's own car from a file: the fields of ``Vehicle`` by their names, or CommonRoad's parameters."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, cast

from bicycle_env.files import read_table, read_yaml
from bicycle_env.physics import commonroad

COMMONROAD = (".yaml", ".yml")
EXTENSIONS = (".json", ".toml", *COMMONROAD)
ENDINGS = ".json or .toml, or with CommonRoad's parameters in .yaml"
LARGEST_FILE = 100_000  # bytes


def is_car_file(name: str) -> bool:
    """Whether a string names a car's file, and not a preset."""
    return Path(name).suffix.lower() in EXTENSIONS


def read_fields(path: str | Path, gravity: float) -> dict[str, Any]:
    """The fields of a car in a file; `gravity`, m/s^2, gives the loads that CommonRoad's stiffnesses are a share of.

    Raises:
        ValueError: another ending; the file is too large, or holds no such table; one line that names the file.
        OSError: the file cannot be read.
    """
    if not is_car_file(str(path)):
        raise ValueError(f"vehicle: a car's file must end in {ENDINGS}, got {str(path)!r}")
    if Path(path).suffix.lower() in COMMONROAD:
        check = functools.partial(commonroad.fields, gravity)
        return cast("dict[str, Any]", read_yaml(path, check, LARGEST_FILE))
    return cast("dict[str, Any]", read_table(path, _fields, LARGEST_FILE))


def _fields(_: str, content: Any) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise TypeError(f"must be a table of fields such as mass = 1500, got a {type(content).__name__}")
    return content
