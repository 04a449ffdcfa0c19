"""A user's own car from a JSON or TOML file: the fields of ``Vehicle`` by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bicycle_env.files import read_table

EXTENSIONS = (".json", ".toml")
LARGEST_FILE = 100_000  # bytes


def is_car_file(name: str) -> bool:
    """Whether a string names a car's file, and not a preset."""
    return Path(name).suffix.lower() in EXTENSIONS


def read_fields(path: str | Path) -> dict[str, Any]:
    """The table in a file that ends in .json or .toml.

    Raises:
        ValueError: another ending; the file is too large, or holds no such table; one line that names the file.
        OSError: the file cannot be read.
    """
    if not is_car_file(str(path)):
        raise ValueError(f"vehicle: a car's file must end in .json or .toml, got {str(path)!r}")
    fields: dict[str, Any] = read_table(path, _fields, LARGEST_FILE)
    return fields


def _fields(_: str, content: Any) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise TypeError(f"must be a table of fields such as mass = 1500, got a {type(content).__name__}")
    return content
