"""Seeds as jobs: what stands on the command line, who is left alone, and a job that is put back goes on."""

from __future__ import annotations

import json
import sys

import pytest

from agents import jobs
from agents.messages import UserError

submitit = pytest.importorskip("submitit")


@pytest.fixture
def cluster(monkeypatch, tmp_path):
    """Jobs run at once; gives the words of what they started. Seed 2 fails."""
    started = []

    class Job:
        def __init__(self, code):
            self.code = code

        def done(self):
            return True

        def result(self):
            return self.code

    class Executor:
        def __init__(self, folder, cluster):
            self.parameters = {"folder": folder, "cluster": cluster}

        def update_parameters(self, **parameters):
            self.parameters |= parameters

        def submit(self, training):
            started.append(training.words)
            training.folder.mkdir(parents=True, exist_ok=True)
            (training.folder / "run.json").write_text(json.dumps({"finished": "2" not in training.words}))
            return Job(int("2" in training.words))

    monkeypatch.setattr(submitit, "AutoExecutor", Executor)
    monkeypatch.chdir(tmp_path)
    return started


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["jobs", *words])
    return jobs.main()


def test_each_seed_is_a_job_and_who_has_finished_is_left_alone(cluster, monkeypatch, capsys):
    words = ("--seeds", "3", "--out", "there", "agents.ppo", "--env-id", "BicycleEvade-v0")
    assert run(monkeypatch, *words) == 1
    assert "seed 2 has failed: there/log holds what it said" in capsys.readouterr().out
    assert [line[1:] for line in cluster] == [
        ["-m", "agents.ppo", "--env-id", "BicycleEvade-v0", "--seed", f"{seed}", "--out", f"there/{seed}", "--quiet"]
        for seed in range(3)
    ]
    cluster.clear()
    assert run(monkeypatch, *words) == 1
    assert [line[line.index("--seed") + 1] for line in cluster] == ["2"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--seeds", "2"], "a trainer must follow the options, one of agents.ppo, agents.policy_search"),
        (["agents.ppo", "--seed", "1"], "--seed is not for the trainer: a job says it itself"),
        (["agents.ppo", "--out=x"], "--out=x is not for the trainer"),
        (["--seeds", "0", "agents.ppo"], "--seeds must be at least 1, got 0"),
    ],
)
def test_a_mistake_is_one_line(words, text, cluster, monkeypatch):
    with pytest.raises(UserError, match=text):
        run(monkeypatch, *words)
    assert not cluster


@pytest.mark.exhaustive
def test_local_jobs_train_and_one_that_was_stopped_goes_on(monkeypatch, tmp_path):
    words = ("--seeds", "2", "--out", str(tmp_path / "out"), "agents.policy_search")
    tiny = ("--total-timesteps", "40000", "--pairs", "4", "--starts", "4", "--width", "4")
    assert run(monkeypatch, *words, *tiny) == 0
    for seed in range(2):
        record = json.loads((tmp_path / "out" / str(seed) / "run.json").read_text())
        assert record["seed"] == seed
        assert record["finished"]
    record = tmp_path / "out" / "1" / "run.json"
    training = jobs.Training("agents.policy_search", list(tiny), 1, tmp_path / "out" / "1")
    assert training() == 2, "what has finished does not go on"
    assert jobs.finished(record.parent)
