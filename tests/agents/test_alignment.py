"""The study of the rewards: what it ranks, what it says, one line for a mistake, a tiny study."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from agents import alignment, statistics, worsened
from agents.messages import UserError
from bicycle_env.registration import ENVIRONMENTS

RESULTS = Path(__file__).parents[2] / "results"


def row(family, success, episode_return):
    return {"family": family, "success_rate": {"value": success}, "episode_return": {"value": episode_return}}


def test_the_correlation_is_that_of_the_ranks(monkeypatch):
    monkeypatch.setattr(statistics, "RESAMPLES", 100)
    rows = [row("late", 0.01 * k, np.exp(k)) for k in range(8)]
    assert alignment.correlation(rows) == {"value": pytest.approx(1.0), "interval": pytest.approx((1.0, 1.0))}
    rows[2], rows[3] = row("late", 0.02, np.exp(3)), row("late", 0.03, np.exp(2))
    found = alignment.correlation(rows)
    assert found["value"] == pytest.approx(1.0 - 6.0 * 2.0 / (8 * 63))  # 1 - 6 sum d^2 / (n (n^2 - 1))
    assert found["interval"][0] < found["value"] <= found["interval"][1]
    assert alignment.correlation([row("late", 0.5, 1.0)] * 5)["value"] == 0.0
    assert alignment.correlation([row("late", 0.1 * k, -k) for k in range(5)])["value"] == pytest.approx(-1.0)


def test_policies_are_chosen_evenly_and_of_all_families():
    success = np.tile(np.linspace(0.0, 1.0, 101), 2)
    families = ["weaker"] * 101 + ["late"] * 101
    chosen = worsened.evenly(success, families)
    assert len(set(chosen)) == worsened.POLICIES
    found = np.sort(success[chosen])
    assert found[0] == pytest.approx(0.05)
    assert found[-1] == pytest.approx(0.94)
    assert np.max(np.diff(found)) < 0.06
    assert sum(families[k] == "late" for k in chosen) == worsened.POLICIES // 2
    assert worsened.evenly(np.array([0.0, 1.0]), ["late", "late"]) == []


def test_more_degrees_stand_where_success_changes():
    found = {(0, 1.0): 1.0, (0, 4.0): 0.5, (0, 16.0): 0.45, (1, 1.0): 0.96, (1, 9.0): 1.0, (2, 2.0): 0.9, (2, 3.0): 0.1}
    assert worsened.between(found, {2}) == [(0, 2.0), (0, 8.0)]
    assert worsened.between(found, set()) == [(2, pytest.approx(6.0**0.5)), (0, 2.0), (0, 8.0)]


@pytest.mark.parametrize(
    ("count", "correlation", "lost", "words"),
    [
        (20, 0.9, 0.02, "yes"),
        (19, 0.9, 0.02, "no: 19 policies"),
        (20, 0.89, 0.021, "no: ranks, search"),
        (20, np.nan, -0.1, "no: ranks"),
    ],
)
def test_the_verdict_names_what_fails(count, correlation, lost, words):
    found = {"policies": [{}] * count, "correlation": {"value": correlation}, "search": {"lost": {"value": lost}}}
    assert alignment.verdict(found) == words


def test_every_registered_id_has_a_controller():
    assert list(alignment.CONTROLLERS) == [one.id for one in ENVIRONMENTS]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--starts", "0"], "--starts must be at least 1, got 0"),
        (["--env-id", "BicycleStab-v1"], "--env-id must be one of BicycleStab-v0, "),
        (["--env-keywords", '{"steer": "rear"}'], "--env-keywords needs --env-id"),
        (["--env-id", "BicycleEvade-v0", "--env-keywords", '{"steer": "sideways"}'], "'sideways'"),
        (["--older", "--env-id", "BicycleEvade-v0"], "--older needs --env-id and --json"),
    ],
)
def test_a_mistake_is_one_line(words, text, monkeypatch):
    monkeypatch.setattr("sys.argv", ["alignment", *words])
    with pytest.raises(UserError, match=text) as caught:
        alignment.main()
    assert "\n" not in str(caught.value)


def test_what_is_wrong_with_a_policy_is_what_drives():
    """Not moved, the tuned controller; late, its actions of before; weaker, less of them."""
    bench = worsened.Bench("BicycleStab-v0", {}, "lqr")
    tuned = worsened.Variant("", 0.0, bench.values, np.ones(len(bench.plant.observation_names)))
    variants = [tuned, tuned._replace(gain=0.0), tuned._replace(late=200), tuned._replace(gain=0.3), tuned]
    variants += [tuned._replace(factors=0.0 * tuned.factors), tuned._replace(noise=0.3)]
    success, returns = bench.drive(variants, list(range(40)), np.random.default_rng(0))
    assert success[0].mean() > 0.5
    assert np.array_equal(returns[0], returns[4])
    for k in (2, 5):  # actions of 0 until every car is lost
        assert np.array_equal(returns[1], returns[k])
    assert not success[1].any()
    assert success[6].mean() < success[0].mean()
    assert 0.0 < success[3].mean() < success[0].mean()
    made = [bench.variant(*ray, worsened.degrees(ray[0])[-1]) for ray in bench.rays(0)]
    assert {one.family for one in made} == set(worsened.FAMILIES)
    for one in made:
        changed = [not np.array_equal(new, old) for new, old in zip(one[2:], tuned[2:], strict=True)]
        assert sum(changed) == 1


@pytest.mark.exhaustive
def test_a_tiny_study(tmp_path, monkeypatch, capsys):
    for name, value in {"DEGREES": 2, "ROUNDS": 1, "SELECTING": 32}.items():
        monkeypatch.setattr(worsened, name, value)
    for name, value in {"SEARCHES": 2, "ITERATIONS": 1, "TUNING_STARTS": 4, "SELECTION_STARTS": 32}.items():
        monkeypatch.setattr(alignment, name, value)
    out = tmp_path / "alignment.json"
    words = ["--env-id", "BicycleActiveSteer-v0", "--env-keywords", '{"observed": "state"}', "--starts", "32"]
    monkeypatch.setattr("sys.argv", ["alignment", *words, "--json", str(out)])
    alignment.main()
    assert "BicycleActiveSteer-v0" in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert content["command"] == (
        "python -m agents.alignment --starts 32 --seed 1 --env-id BicycleActiveSteer-v0 "
        '--env-keywords \'{"observed": "state"}\''
    )
    assert {"date", "machine", "versions", "git", "seconds"} <= set(content)
    found = content["environments"]["BicycleActiveSteer-v0"]
    assert found["aligned"].startswith("no: ")
    assert len(found["search"]["return"]["success_rates"]) == 2
    low, high = found["search"]["lost"]["range"]
    assert low <= found["search"]["lost"]["value"] <= high
    assert out.with_suffix(".png").stat().st_size > 10_000


def test_rows_of_another_run_are_kept_if_they_are_of_the_same_starts(tmp_path, monkeypatch):
    path, old = tmp_path / "alignment.json", json.loads((RESULTS / "alignment.json").read_text())
    old["environments"] = {one: old["environments"][one] for one in ("BicycleStab-v0", "BicycleEvade-v0")}
    path.write_text(json.dumps({**old, "git": "f" * 40}))
    one = {**old["environments"]["BicycleEvade-v0"], "seconds": 1e4}
    monkeypatch.setattr(alignment, "study", lambda env_id, keywords, args: one)
    words = ["alignment", "--older", "--env-id", "BicycleEvade-v0", "--json", str(path)]
    monkeypatch.setattr("sys.argv", words)
    alignment.main()
    new = json.loads(path.read_text())
    assert list(new["environments"]) == list(old["environments"])
    for env_id, found in new["environments"].items():
        before = {"git": "f" * 40, **old["environments"][env_id]}
        assert found == (before if env_id != "BicycleEvade-v0" else one | {"git": found["git"]})
    assert new["seconds"] == pytest.approx(sum(one["seconds"] for one in new["environments"].values()), abs=0.1)
    monkeypatch.setattr("sys.argv", [*words, "--starts", "32"])
    with pytest.raises(UserError, match=f"--older: {path} is of starts 2000, not 32"):
        alignment.main()


def test_the_committed_figures_are_of_every_id_and_say_what_made_them():
    content = json.loads((RESULTS / "alignment.json").read_text())
    assert {"command", "date", "machine", "versions", "git", "seed", "starts"} <= set(content)
    assert content["starts"] >= 2000
    assert list(content["environments"]) == list(alignment.CONTROLLERS)
    for found in content["environments"].values():
        assert len(found["policies"]) >= alignment.LEAST_POLICIES
        assert found["correlation"]["value"] == alignment.spearman(alignment.pairs_of(found["policies"]))
        assert found["aligned"] == alignment.verdict(found)
