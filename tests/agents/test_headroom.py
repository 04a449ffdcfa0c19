"""The study of the headroom: its figures, its files, what is kept of a run that was stopped, one line for a mistake."""

from __future__ import annotations

import concurrent.futures
import json
import math
from pathlib import Path

import numpy as np
import pytest

from agents import headroom, headroom_figures, headroom_picture, headroom_policies, headroom_setting
from agents.episodes import start_seeds
from agents.headroom_setting import BEST, BLIND, BOUND, LEARNED, UNCONTROLLED, Extent
from agents.messages import UserError
from bicycle_env import Actuator, control, optimum
from bicycle_env.tasks.evade import Evade
from bicycle_env.tasks.options import altered
from bicycle_env.tasks.stabilise import Stabilise

RESULTS = Path(__file__).parents[2] / "results"
TINY = Extent(12, 6, 4, 4, 8, 2, 2, 2, 8, (11, 11, 9, 7))


class Everywhere:
    """A recoverable set that takes seconds less than the true one."""

    def contains(self, *columns):
        return np.ones(len(columns[0]), bool)


def tell(*_):
    pass


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["BicycleStab-v0 medium", "BicycleEvade-v0 medium"])
def test_a_small_study(name, monkeypatch):
    monkeypatch.setattr(headroom_setting, "recoverable", lambda *_: Everywhere())
    setting = headroom.SETTINGS[name]
    part = headroom_setting.study(setting, TINY, 1, 0, tell)
    rows, names = part["drivers"], headroom_setting.CONTROLLERS[setting.env_id]
    wanted = {UNCONTROLLED, BEST, *(f"{each}, tuned" for each in names)}
    hidden = setting.env_id != "BicycleStab-v0"
    wanted |= {BLIND, f"{names[-1]}, tuned, knows the friction"} if hidden else {BOUND}
    assert wanted <= set(rows)
    assert (BLIND in rows) is hidden is bool(part["hidden"])
    rates = {driver: row["success_rate_of_searched"] for driver, row in rows.items() if driver not in (BOUND, BLIND)}
    assert rates[BEST] >= max(rates.values())
    assert (LEARNED in rows) is (setting.level in control.published()[setting.env_id])
    assert part["reference"]["driver"] in ((BLIND, LEARNED) if hidden else (BEST,))
    assert part["room"]["value"] == pytest.approx(part["reference"]["success_rate"] - part["classical"]["success_rate"])
    assert part["best_return"] >= rows[BEST]["episode_return"]["value"] - 1e-9
    for one in part["sequences"]:
        assert one["start"] in start_seeds(TINY.searched, 1)
        assert optimum.replay(one["env_id"], one["keywords"], one["start"], np.array(one["actions"])).success
        peak = headroom_figures.of_sequences(one["env_id"], one["keywords"], {one["start"]: np.array(one["actions"])})
        assert 0.0 < peak["peak_sideslip"] < 0.8
    json.dumps(part)


@pytest.mark.exhaustive
def test_the_command_writes_its_files_and_goes_on(tmp_path, monkeypatch, capsys):
    """Threads stand for the processes, so that they have the small extent, too."""
    monkeypatch.setattr(headroom, "QUICK", TINY)
    pools = concurrent.futures
    monkeypatch.setattr(pools, "ProcessPoolExecutor", lambda count, context: pools.ThreadPoolExecutor(count))
    out = tmp_path / "headroom.json"
    words = ["headroom", "--quick", "--processes", "1", "--only", "LaneChange-v0 easy", "--json", str(out)]
    monkeypatch.setattr("sys.argv", words)
    headroom.main()
    first = json.loads(out.read_text())
    assert set(first["settings"]) == {"BicycleLaneChange-v0 easy", "BicycleDoubleLaneChange-v0 easy"}
    assert first["command"] == "python -m agents.headroom --seed 1 --search-seed 0 --quick --only 'LaneChange-v0 easy'"
    assert min(part["processor_seconds"] for part in first["settings"].values()) > 0.0
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert "room:" in capsys.readouterr().out
    monkeypatch.setattr(headroom, "worker", None)  # nothing is left to do
    headroom.main()
    assert json.loads(out.read_text())["settings"] == first["settings"]


def test_a_part_of_other_code_is_not_taken(tmp_path):
    origin = {"git": "a", "versions": {}, "quick": False, "seed": 1, "search_seed": 0}
    path = headroom.part_file(tmp_path, "BicycleStab-v0, friction 0.4")
    assert path.name == "BicycleStab-v0--friction-0-4.json"
    assert headroom.kept(tmp_path, "BicycleStab-v0, friction 0.4", origin) is None
    path.write_text(json.dumps({**origin, "part": {"level": None}}))
    assert headroom.kept(tmp_path, "BicycleStab-v0, friction 0.4", origin) == {"level": None}
    for change in ({"git": "b"}, {"quick": True}, {"seed": 2}, {"search_seed": 1}, {"versions": {"numpy": "1"}}):
        assert headroom.kept(tmp_path, "BicycleStab-v0, friction 0.4", origin | change) is None
        taken = headroom.kept(tmp_path, "BicycleStab-v0, friction 0.4", origin | change, older=True)
        assert (taken is not None) is (set(change) <= {"git", "versions"})
    path.write_text("{")
    assert headroom.kept(tmp_path, "BicycleStab-v0, friction 0.4", origin) is None


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        (Stabilise(), None),
        (Evade(relative_friction=(0.4, 1.0)), (0.4, 1.0, {"relative_friction": (0.5, 0.6)})),
        (Evade(relative_friction=(1.0, 1.0)), None),
        (
            altered(Stabilise(), randomise={"friction": (0.3, 0.9)}),
            (0.3, 0.9, {"randomise": {"friction": (0.5, 0.6)}}),
        ),
        (altered(Stabilise(), randomise={"mass": (0.9, 1.1, "relative")}), None),
    ],
)
def test_which_friction_is_hidden(task, expected):
    found = headroom_setting.hidden_friction(task)
    assert (found and (*found[:2], found[2](0.5, 0.6))) == expected


def test_every_id_and_level_is_studied_and_none_twice():
    levels = [(setting.env_id, setting.level) for setting in headroom.SETTINGS.values() if setting.level]
    assert len(levels) == len(set(levels)) == 3 * len(headroom_setting.CONTROLLERS)
    assert sorted(headroom.ORDER) == sorted(headroom.SETTINGS)


def test_keywords_become_plain():
    given = {"steer": "rear", "front_actuator": Actuator(0.1, math.inf, 0.005), "rear_actuator": Actuator(0.1, 2.0)}
    assert headroom_figures.plain(given) == {
        "steer": "rear",
        "front_actuator": {"angle_limit": 0.1, "time_constant": 0.005},
        "rear_actuator": {"angle_limit": 0.1, "rate_limit": 2.0, "time_constant": 0.05},
    }


def test_a_picture_of_made_up_rates(tmp_path):
    def row(rate):
        return {"success_rate_of_searched": rate}

    def side(driver, rate):
        return {"driver": driver, "success_rate": rate}

    rows = {UNCONTROLLED: row(0.0), "lqr, tuned": row(0.5), BEST: row(0.7)}
    part = {"drivers": rows, "classical": side("lqr, tuned", 0.5), "reference": side(BEST, 0.7), "room": {"value": 0.2}}
    hidden = {**part, "drivers": {**rows, BLIND: row(0.6), BOUND: row(0.8)}, "reference": side(BLIND, 0.6)}
    headroom_picture.draw({"one": part, "two": hidden}, tmp_path / "room.png")
    assert (tmp_path / "room.png").stat().st_size > 10_000


def of_few_starts(name, starts=24, **changes):
    """A part of the committed study as of fewer starts."""
    part = json.loads((RESULTS / "headroom.json").read_text())["settings"][name]
    law = part["classical"]["driver"]
    rows = {name: {**row, "starts": starts} for name, row in part["drivers"].items() if name != LEARNED}
    assert law in rows
    return {**part, "drivers": rows, **changes}


def test_a_policy_that_came_after_the_study_has_its_row():
    part = of_few_starts("BicycleStab-v0 medium")
    found = headroom_policies.with_policy(part, 1)
    row = found["drivers"][LEARNED]
    policy = control.load_policy("BicycleStab-v0", "medium")
    seeds = start_seeds(24, 1)
    outcomes = optimum.drive(optimum.Cars("BicycleStab-v0", {"level": "medium"}).of(24), optimum.by(policy), seeds)
    assert row["success_rate"]["value"] == np.mean(outcomes.success)
    assert row["starts"] == 24
    order = list(found["drivers"])
    assert order.index("lqr, tuned") < order.index(LEARNED) < order.index(BEST)
    assert {**found["drivers"], LEARNED: 0} == {**part["drivers"], LEARNED: 0}
    assert (found["reference"], found["room"]) == (part["reference"], part["room"])


def test_what_the_policy_saves_counts_as_found():
    part = of_few_starts("BicycleStab-v0 medium")
    part["drivers"][BEST]["success_rate"] = {"value": 0.1, "interval": [0.0, 0.2]}
    found = headroom_policies.with_policy(part, 1)["drivers"]
    assert found[BEST]["success_rate"]["value"] == found[LEARNED]["success_rate_of_searched"] > 0.1


@pytest.mark.exhaustive
@pytest.mark.parametrize(("room", "reference"), [(0.0, LEARNED), (0.9, BLIND)])
def test_where_something_is_hidden_the_policy_may_be_the_reference(room, reference):
    above = {"driver": BLIND, "success_rate": 0.9, "episode_return": 0.0, "starts": 24}
    part = of_few_starts("BicycleActiveSteer-v0 medium", 64, reference=above, room={"value": room})
    found = headroom_policies.with_policy(part, 1)
    assert found["reference"]["driver"] == reference
    rows = found["drivers"]
    if reference == LEARNED:
        assert found["reference"]["success_rate"] == rows[LEARNED]["success_rate"]["value"]
        assert found["room"]["value"] == found["reference"]["success_rate"] - found["classical"]["success_rate"] > 0.0


def test_lqr_as_shipped_saves_what_the_table_of_controllers_says():
    """The vector environment and a batch's products make no difference that a table could show."""
    rows = json.loads((RESULTS / "headroom.json").read_text())["settings"]["BicycleStab-v0 medium"]["drivers"]
    controllers = json.loads((RESULTS / "controllers_stab.json").read_text())["policies"]
    for ours, name in (("lqr, as shipped", "lqr"), (UNCONTROLLED, "zero")):
        assert rows[ours]["success_rate_of_searched"] == controllers[name]["success_rate"]["value"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--processes", "0"], "--processes must be at least 1, got 0"),
        (["--seed", "-1"], "--seed must be at least 0, got -1"),
        (["--search-seed", "-1"], "--search-seed must be at least 0, got -1"),
        (["--only", "ice"], "--only must be a part of one of: BicycleStab-v0 easy, BicycleStab-v0 medium"),
    ],
)
def test_a_mistake_is_said_before_any_work(words, text, monkeypatch):
    monkeypatch.setattr("sys.argv", ["headroom", *words])
    with pytest.raises(UserError, match=text):
        headroom.main()
