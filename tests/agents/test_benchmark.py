"""The benchmark: what is in its plan, what it runs, and the figures of a cell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benchmark_cells import cell as made_up

from agents import benchmark, scores, stopping
from agents.messages import UserError

ONE = made_up("BicycleEvade-v0", "hard", "native-ppo", [0.5])
RESULTS = Path(__file__).parents[2] / "results"


@pytest.mark.parametrize("plan", benchmark.PLANS.values(), ids=list(benchmark.PLANS))
def test_every_cell_stands_once_and_has_a_classical_controller(plan):
    names = [cell.name for cell in plan]
    assert len(names) == len(set(names))
    for cell in plan:
        assert cell.learner in benchmark.LEARNERS
        assert benchmark.known_classical(cell)["parameters"]


def test_only_and_seeds():
    found = benchmark.chosen(benchmark.Args(only=("Stab-v0", "medium", "native"), seeds=3))
    assert [(cell.name, cell.seeds) for cell in found] == [("BicycleStab-v0 medium native-ppo", 3)]
    assert {cell.seeds for cell in benchmark.chosen(benchmark.Args(quick=True))} == {benchmark.QUICK_SEEDS}
    with pytest.raises(UserError, match="--only Stabb: no cell has all of these words; the cells are\nBicycleStab"):
        benchmark.chosen(benchmark.Args(only=("Stabb",)))


def test_a_training_that_was_begun_goes_on(tmp_path):
    cell = benchmark.Cell("BicycleStab-v0", "hard", "native-ppo", 1, "one observation", ("--history", "1"))
    job = benchmark.Job(cell, 4, tmp_path)
    words = job.command(quick=False)
    assert words[1:3] == ["-m", "agents.ppo"]
    assert words[words.index("--env-keywords") + 1] == '{"level": "hard"}'
    assert words[-2:] == ["--history", "1"]
    (tmp_path / "run.json").touch()
    assert job.command(quick=False)[-1] == "--resume"
    assert not job.done
    quick = job.command(quick=True)
    assert int(quick[quick.index("--total-timesteps") + 1]) < 1_000_000


def test_who_stops_it_is_told_how_it_goes_on(tmp_path, monkeypatch):
    class Training:
        def __init__(self, *_, **__):
            pass

        def poll(self):
            raise stopping.Stopped(2)

        def terminate(self):
            ended.append(self)

    ended = []
    monkeypatch.setattr(benchmark.subprocess, "Popen", Training)
    jobs = [benchmark.Job(benchmark.PLANS["table"][0], seed, tmp_path / str(seed)) for seed in range(3)]
    with pytest.raises(stopping.Stopped, match="the same command goes on") as caught:
        benchmark.train_all(jobs, benchmark.Args(jobs=2))
    assert caught.value.code == 130
    assert len(ended) == 2


def test_the_interval_of_a_difference_counts_seeds_and_starts():
    random = np.random.default_rng(1)
    starts = (random.random(400) < 0.5).astype(float)
    apart = starts[None] + np.linspace(-0.2, 0.2, 10)[:, None]
    alike = np.tile(starts, (10, 1))
    wide, narrow = (np.ptp(benchmark.stratified(one, 300)) for one in (apart, alike))
    assert wide > 1.2 * narrow > 0.0


def test_over_seeds_stand_score_and_regret_where_there_is_one():
    seeds = [{**one, "score": rate, "regret": 3.0 * rate} for rate in (0.1, 0.2, 0.6) for one in ONE["trainings"]]
    found = benchmark.all_over_seeds(seeds)
    assert [*found] == ["success_rate", "on_road_rate", "episode_return", "score", "regret"]
    assert found["regret"]["value"] == pytest.approx(3.0 * found["score"]["value"])
    assert found["score"]["range"] == [0.1, 0.6]
    without = benchmark.all_over_seeds([{**one, "score": None} for one in seeds])
    assert "score" not in without
    assert "regret" in without


def test_the_printed_table_has_a_row_for_each_cell():
    table = benchmark.shown({"one": ONE})
    found = {str(column.header).replace("\n", " "): [*column.cells] for column in table.columns}
    assert found["id and level"] == ["BicycleEvade-v0 hard"]
    assert found["on road [%]"] == ["50.0"]
    known = scores.known_of("BicycleEvade-v0", "hard")
    assert found["score"] == [f"{known.score(0.5):.2f}"]


@pytest.mark.parametrize("name", ["benchmark.json", "ablations.json", "remedies.json", "exploration.json"])
def test_the_committed_cells_are_of_the_plan(name):
    path = RESULTS / name
    if not path.is_file():
        pytest.skip("not made yet")
    content = json.loads(path.read_text())
    plan = "table" if name == "benchmark.json" else name.removesuffix(".json")
    planned = {cell.name for cell in benchmark.PLANS[plan]}
    for key, cell in content["cells"].items():
        assert key in planned
        rates = [one["success_rate"]["value"] for one in cell["trainings"]]
        assert cell["over_seeds"]["success_rate"]["range"] == [min(rates), max(rates)]
        assert [one["seed"] for one in cell["trainings"]] == list(range(len(rates)))
