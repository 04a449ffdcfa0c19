"""A user's own car from a JSON or TOML file: the fields of ``Vehicle`` by their names."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from pathlib import Path
from typing import Any

from bicycle_env.physics.presets import resolve_vehicle, vehicles
from bicycle_env.physics.validation import known_keys
from bicycle_env.physics.vehicle import Vehicle

EXTENSIONS = (".json", ".toml")
LARGEST_FILE = 100_000  # bytes


def find_vehicle(name_or_file: str) -> tuple[str, Vehicle]:
    """The name and the car of a preset, or of a file that ends in .json or .toml (its name is the file's stem).

    Raises:
        ValueError, TypeError: no such preset; a file that is no table of the fields of ``Vehicle``; the field is named.
        OSError: the file cannot be read.
    """
    if Path(name_or_file).suffix.lower() in EXTENSIONS:
        return Path(name_or_file).stem, read_vehicle(name_or_file)
    if name_or_file not in vehicles and ("/" in name_or_file or Path(name_or_file).is_file()):
        raise ValueError(f"vehicle: a car's file must end in .json or .toml, got {name_or_file!r}")
    try:
        return name_or_file, resolve_vehicle(name_or_file)
    except ValueError as error:
        raise ValueError(f"{str(error).rstrip('.')} (a car's file ends in .json or .toml)") from None


def read_vehicle(path: str | Path) -> Vehicle:
    """A car from a file; raises as :func:`find_vehicle`."""
    path = Path(path)
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
    try:
        return _vehicle(fields)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None


def _vehicle(fields: dict[str, Any]) -> Vehicle:
    known = dataclasses.fields(Vehicle)
    known_keys("field", fields, [field.name for field in known])
    missing = [field.name for field in known if field.default is dataclasses.MISSING and field.name not in fields]
    if missing:
        raise ValueError(f"missing {'field' if len(missing) == 1 else 'fields'} {', '.join(map(repr, missing))}")
    return Vehicle(**fields)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object in which no key stands twice."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(key for key in keys if keys.count(key) > 1)!r} stands twice")
    return table
