"""A user's own car from a JSON or TOML file: the fields of ``Vehicle`` by their names."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

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
    path = Path(path)
    if not is_car_file(str(path)):
        raise ValueError(f"vehicle: a car's file must end in .json or .toml, got {str(path)!r}")
    with path.open("rb") as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise ValueError(f"{path}: a car's file is not larger than {LARGEST_FILE} bytes")
    try:
        text = content.decode("utf-8-sig")
        fields = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not {path.suffix.lower()[1:].upper()}: {error}") from None
    if not isinstance(fields, dict):
        raise ValueError(f"{path}: must be a table of fields such as mass = 1500, got a {type(fields).__name__}")
    return fields


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object in which no key stands twice."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(key for key in keys if keys.count(key) > 1)!r} stands twice")
    return table
