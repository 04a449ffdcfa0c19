"""A user's own car: read from JSON and TOML, and every mistake in such a file is named with its field."""

from __future__ import annotations

import dataclasses
import json
import os
import re

import pytest

from bicycle_env import Vehicle, vehicles
from bicycle_env.cli import main
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
        ("cars/mine.xml", "got 'cars/mine.xml' (a car's file ends in .json or .toml, or"),
    ],
)
def test_neither_a_preset_nor_a_file(name, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        resolve_vehicle(name)


def test_another_ending(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.json or \.toml"):
        Vehicle.read(tmp_path / "car.xml")


def test_a_file_that_is_not_there():
    with pytest.raises(FileNotFoundError):
        resolve_vehicle("nowhere.toml")


TOML = toml({name: value for name, value in FIELDS.items() if name not in ("source", "name")})
JSON = json.dumps(FIELDS)
DAMAGED = {
    "utf-16.toml": TOML.encode("utf-16"),
    "utf-16.json": JSON.encode("utf-16"),
    "utf-32.json": JSON.encode("utf-32"),
    "latin-1.toml": (TOML + '\nsource = "caf\xe9"').encode("latin-1"),
    "shift-jis.json": JSON.replace("oversteer", "\u8eca").encode("shift-jis"),
    "surrogate.json": json.dumps({**FIELDS, "source": "\ud800"}).encode(),
    "nul.toml": TOML.encode() + b"\n\0",
    "nul.json": JSON.encode() + b"\0",
    "nul-in-name.json": json.dumps({**FIELDS, "name": "a\0b"}).encode(),
    "escape-in-name.json": json.dumps({**FIELDS, "name": "\x1b]0;owned\x07"}).encode(),
    "escape-as-key.json": json.dumps({**FIELDS, "\x1b[2J\n": 1.0}).encode(),
    "long-key.json": json.dumps({**FIELDS, "k" * 50_000: 1.0}).encode(),
    "long-name.json": json.dumps({**FIELDS, "name": "n" * 5000}).encode(),
    "deep.json": b'{"mass": ' + b"[" * 40_000 + b"]" * 40_000 + b"}",
    "deep.toml": b"mass = " + b"[" * 40_000 + b"]" * 40_000,
    "dotted.toml": b".".join([b"a"] * 20_000) + b" = 1",
    "huge.json": JSON.replace("1500.0", "1e999").encode(),
    "huge-whole.json": JSON.replace("1500.0", "9" * 4000).encode(),
    "huge-whole.toml": TOML.replace("1500.0", "9" * 4000).encode(),
    "hexadecimal.toml": TOML.replace("1500.0", "0x" + "f" * 50_000).encode(),
    "tiny.json": JSON.replace("1500.0", "5e-324").encode(),
    "nan.toml": TOML.replace("1500.0", "nan").encode(),
    "minus-infinity.json": JSON.replace("1500.0", "-Infinity").encode(),
    "date.toml": TOML.replace("1500.0", "1979-05-27").encode(),
    "list.toml": TOML.replace("1500.0", "[1500.0]").encode(),
    "table.toml": TOML.encode() + b"\n[source]\nby = 1",
    "twice.toml": TOML.encode() + b"\nmass = 1.0",
    "twice.json": JSON.replace("{", '{"mass": 1.0, ', 1).encode(),
    "two.json": (JSON + JSON).encode(),
    "comment.json": b"// a car\n" + JSON.encode(),
    "cut.json": JSON[:-20].encode(),
    "cut.toml": TOML[:-4].encode() + b"e",
    "empty.json": b"",
    "empty.toml": b"",
    "null.json": b"null",
    "word.json": b'"oversteer"',
    "zip.json": b"PK\x03\x04" + bytes(range(256)),
    "pickle.json": b"\x80\x04\x95\x00\x00",
    "large.toml": b"#" * 200_000,
}


def refused(path, capsys):
    """What the function says, after the command has said the same in one line of printable text."""
    with pytest.raises((ValueError, OSError)) as caught:
        resolve_vehicle(str(path))
    assert main(["report", "--vehicle", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("bicycle-env: error: ")
    assert printed.err.endswith("\n")
    assert printed.err[:-1].isprintable()
    assert len(printed.err) < 1100
    return str(caught.value)


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_gives_one_line(tmp_path, capsys, name):
    (tmp_path / name).write_bytes(DAMAGED[name])
    said = refused(tmp_path / name, capsys)
    assert said.startswith(str(tmp_path / name))
    assert said.isprintable()


def test_what_is_no_regular_file_gives_one_line(tmp_path, capsys):
    (tmp_path / "folder.toml").mkdir()
    os.mkfifo(tmp_path / "fifo.json")
    (tmp_path / "device.json").symlink_to("/dev/zero")
    (tmp_path / "nowhere.json").symlink_to(tmp_path / "missing")
    (tmp_path / "loop.json").symlink_to(tmp_path / "loop.json")
    with (tmp_path / "sparse.json").open("wb") as file:
        file.truncate(3_000_000_000)
    for name, text in (
        ("folder.toml", "is a folder"),
        ("fifo.json", "is a FIFO"),
        ("device.json", "is a device"),
        ("nowhere.json", "No such file"),
        ("loop.json", "symbolic links"),
        ("sparse.json", "must not be larger than 100000 bytes, has 3000000000"),
        ("file/car.json", "No such file"),
        ("n" * 300 + ".json", "name too long"),
    ):
        assert text in refused(tmp_path / name, capsys)


@pytest.mark.parametrize("name", ["a\0b.json", "\x1b[2J\n.toml", "\ud800.json"])
def test_a_name_that_no_file_has(name, capsys):
    refused(name, capsys)
