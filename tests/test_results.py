"""The committed results are what results/schema.json says: every file of the folder is described there."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import jsonschema
import pytest

RESULTS = Path(__file__).parents[1] / "results"
SCHEMA = json.loads((RESULTS / "schema.json").read_text())
CONTENTS = {path.name: json.loads(path.read_text()) for path in RESULTS.glob("*.json") if path.name != "schema.json"}
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_the_schema_is_one():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("name", [*CONTENTS])
def test_a_file_is_as_described(name):
    VALIDATOR.validate({name: CONTENTS[name]})


def test_every_description_is_of_a_file():
    assert set(SCHEMA["properties"]) == set(CONTENTS)


def without(content, *places):
    changed = copy.deepcopy(content)
    inner = changed
    for place in places[:-1]:
        inner = inner[place]
    del inner[places[-1]]
    return changed


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("headroom.json", ("settings", "BicycleEvade-v0 hard", "reference")),
        ("headroom.json", ("settings", "BicycleEvade-v0 hard", "drivers", "best found", "success_rate", "interval")),
        ("headroom.json", ("git",)),
        ("controllers_stab.json", ("policies", "lqr", "success_rate")),
        ("BicycleStab-v0-ppo.json", ("over_seeds", "episode_return")),
    ],
)
def test_what_is_missing_is_seen(name, places):
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate({name: without(CONTENTS[name], *places)})
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate({"other.json": CONTENTS[name]})


def test_a_time_below_zero_is_seen():
    content = copy.deepcopy(CONTENTS["headroom.json"])
    content["settings"]["BicycleEvade-v0 hard"]["processor_seconds"] = -1.0
    with pytest.raises(jsonschema.ValidationError, match="minimum"):
        VALIDATOR.validate({"headroom.json": content})
