"""A user's own car: read from JSON and TOML, and every mistake in such a file is named with its field."""

from __future__ import annotations

import dataclasses
import json
import re

import pytest

from bicycle_env import Vehicle, vehicles
from bicycle_env.physics.presets import resolve_vehicle

CAR = vehicles["oversteer"]
FIELDS = dataclasses.asdict(CAR)


def toml(fields):
    return "\n".join(f"{name} = {json.dumps(value)}" for name, value in fields.items())


@pytest.mark.parametrize("name", vehicles)
@pytest.mark.parametrize(("extension", "write"), [("json", json.dumps), ("toml", toml), ("JSON", json.dumps)])
def test_a_written_car_comes_back(tmp_path, name, extension, write):
    path = tmp_path / f"mine.{extension}"
    path.write_text(write(dataclasses.asdict(vehicles[name])), encoding="utf-8")
    assert Vehicle.read(path) == vehicles[name]
    assert resolve_vehicle(str(path)) == vehicles[name]
    assert resolve_vehicle(str(path)).name == name


@pytest.mark.parametrize(("stem", "name"), [("mine", "mine"), ("m\x1bi\nne", "m?i?ne"), ("m" * 150, "m" * 100)])
def test_without_a_name_a_car_is_called_like_its_file(tmp_path, stem, name):
    path = tmp_path / f"{stem}.json"
    path.write_text(json.dumps({k: v for k, v in FIELDS.items() if k != "name"}), encoding="utf-8")
    assert Vehicle.read(path).name == name


def test_whole_numbers_optional_fields_and_a_byte_order_mark(tmp_path):
    path = tmp_path / "car.json"
    needed = {**{name: FIELDS[name] for name in list(FIELDS)[:6]}, "mass": 1500}
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(needed).encode())
    assert Vehicle.read(path) == dataclasses.replace(CAR, source="")


BAD = [
    ("json", json.dumps({**FIELDS, "mas": 1.0}), "unknown field of vehicle 'mas'; did you mean 'mass'?"),
    ("toml", toml({**FIELDS, "wheel_base": 1.0}), "unknown field of vehicle 'wheel_base'"),
    ("json", json.dumps({k: v for k, v in FIELDS.items() if k != "mass"}), "missing field 'mass'"),
    ("toml", "mass = 1.0", "missing fields 'yaw_inertia', 'cg_to_front'"),
    ("json", json.dumps({**FIELDS, "mass": -1}), "mass must be a finite number in [0.01, 1e+06], got -1.0"),
    (
        "json",
        json.dumps({**FIELDS, "cg_to_rear": "1.3"}),
        "cg_to_rear must be a finite number in [0.001, 100], got '1.3'",
    ),
    ("json", json.dumps({**FIELDS, "mass": float("nan")}), "mass must be a finite number"),
    ("toml", toml(FIELDS).replace("mass = 1500.0", "mass = inf"), "mass must be a finite number"),
    ("json", json.dumps({**FIELDS, "mass": None}), "mass must be a finite number"),
    ("json", json.dumps({**FIELDS, "mass": True}), "mass must be a finite number"),
    ("json", json.dumps({**FIELDS, "source": 3}), "source must be a string"),
    ("json", '{"mass": 1.0, "mass": 2.0}', "'mass' stands twice"),
    ("json", "[1, 2]", "must be a table of fields such as mass = 1500, got a list"),
    ("json", "{", "not JSON: "),
    ("json", "[" * 50_000, "not JSON"),
    ("json", "1" * 5000, "not JSON"),
    ("toml", "mass 3", "not TOML: "),
    ("toml", "mass = 1\nmass = 2", "not TOML: "),
    ("json", " " * 200_000, "must not be larger than"),
]


@pytest.mark.parametrize(("extension", "content", "text"), BAD, ids=range(len(BAD)))
def test_a_mistake_is_named(tmp_path, extension, content, text):
    path = tmp_path / f"car.{extension}"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(text)) as caught:
        resolve_vehicle(str(path))
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text(tmp_path):
    (tmp_path / "car.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not TOML"):
        resolve_vehicle(str(tmp_path / "car.toml"))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("overster", "did you mean 'oversteer'"),
        ("", "vehicle must be one of"),
        ("cars/mine.yaml", "got 'cars/mine.yaml' (a car's file ends in .json or .toml)"),
    ],
)
def test_neither_a_preset_nor_a_file(name, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        resolve_vehicle(name)


def test_another_ending(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.json or \.toml"):
        Vehicle.read(tmp_path / "car.yaml")


def test_a_file_that_is_not_there():
    with pytest.raises(FileNotFoundError):
        resolve_vehicle("nowhere.toml")
