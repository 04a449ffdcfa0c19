"""The study of planning ahead: its rows, its files, what is kept of a run that was stopped, one line for a mistake."""

import json

import numpy as np
import pytest

from agents import headroom, mpc_headroom
from agents.episodes import start_seeds
from agents.headroom_setting import FULL
from agents.messages import UserError
from bicycle_env import optimum


def test_its_starts_are_the_first_of_the_headroom_study():
    assert start_seeds(mpc_headroom.FULL.reported, 1) == start_seeds(FULL.reported, 1)[: mpc_headroom.FULL.reported]


def test_every_row_is_of_a_hard_level_and_the_driver_is_known_where_there_is_one():
    assert set(mpc_headroom.ROWS) == {f"{env_id} hard" for env_id in optimum.PREDICTIVE} <= set(headroom.SETTINGS)
    told = {name: list(rows) for name, (_, rows) in mpc_headroom.ROWS.items()}
    assert told.pop("BicycleActiveSteer-v0 hard") == list(mpc_headroom.TOLD)
    assert all(rows == ["nothing", "friction"] for rows in told.values())
    assert mpc_headroom.FULL.sets <= 20


class Bar:
    """Of the progress, what a row asks for."""

    task_ids = ()

    def add_task(self, *_, **__):
        return 0

    def remove_task(self, _):
        pass


class Weighed:
    """In place of MPC: what it is worth depends on one weight."""

    searched = optimum.ActiveSteerMPC.parameters


@pytest.mark.exhaustive
def test_the_weights_are_the_best_of_the_sets(monkeypatch):
    """The usual ones first; later sets stand closer, about the best so far."""
    args = mpc_headroom.Args()
    setting = mpc_headroom.Setting("BicycleActiveSteer-v0 hard", args, mpc_headroom.FULL, Bar())
    setting._mpc = Weighed()
    tried = []

    def driven(told, values, seeds, job):
        assert seeds == start_seeds(16, 0, "tune")
        tried.append(values)
        worth = -abs(np.log10(values[0]) - 0.3)
        return optimum.Outcomes(*(np.full(16, value) for value in (True, True, worth, 300)))

    monkeypatch.setattr(setting, "driven", driven)
    values, rate = setting.chosen("nothing", 0)
    assert rate == 1.0
    assert len(tried) == 20
    np.testing.assert_array_equal(tried[0], [one.start for one in Weighed.searched])
    distance = [abs(np.log10(one[0]) - 0.3) for one in tried]
    np.testing.assert_array_equal(values, tried[int(np.argmin(distance))])
    assert np.mean(distance[10:]) < np.mean(distance[:10])


@pytest.mark.exhaustive
def test_the_command_writes_its_file_and_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(mpc_headroom, "QUICK", mpc_headroom.Extent(4, 2, 2))
    out = tmp_path / "mpc.json"
    words = ["mpc_headroom", "--quick", "--only", "DoubleLaneChange", "--json", str(out)]
    monkeypatch.setattr("sys.argv", words)
    mpc_headroom.main()
    first = json.loads(out.read_text())
    (part,) = first["settings"].values()
    assert list(part["mpc"]) == ["nothing", "friction"]
    assert part["horizon"] >= 1.4
    for row in part["mpc"].values():
        assert row["starts"] == len(row["saved"]) == 4
        assert row["plans"] > row["failures"]
        difference = np.mean(row["saved"]) - np.mean(part["classical"]["saved"])
        assert row["better_than_classical"]["value"] == pytest.approx(difference)
    assert "MPC, told friction" in capsys.readouterr().out
    monkeypatch.setattr(mpc_headroom.Setting, "row", None)  # nothing is left to do
    mpc_headroom.main()
    assert json.loads(out.read_text())["settings"] == first["settings"]


def test_an_unknown_setting_is_one_line(monkeypatch):
    monkeypatch.setattr("sys.argv", ["mpc_headroom", "--only", "Stab"])
    with pytest.raises(UserError, match="--only must be a part of one of: BicycleActiveSteer-v0 hard"):
        mpc_headroom.main()
