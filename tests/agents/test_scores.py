"""Scores: what they are measured with, where there are none, and what people read."""

from __future__ import annotations

import json

import gymnasium as gym
import pytest

from agents import scores
from bicycle_env.files import FileError


def side(driver, success_rate):
    return {"driver": driver, "success_rate": success_rate, "episode_return": 100.0, "starts": 200}


def written(folder, classical=0.5, reference=0.7, name="BicycleStab-v0 medium"):
    part = {
        "classical": side("lqr, tuned", classical),
        "reference": side("best found", reference),
        "room": {"value": reference - classical, "interval": [0.1, 0.3]},
        "best_return": 120.0,
    }
    path = folder / "headroom.json"
    path.write_text(json.dumps({"settings": {name: part}}))
    return path


def row(success_rate, episode_return):
    return {"success_rate": {"value": success_rate}, "episode_return": {"value": episode_return}}


def test_a_curve_comes_to_the_reference_within_two_points(tmp_path):
    found = scores.known(gym.make("BicycleStab-v0"), written(tmp_path))
    curve = [[1000, 5.0, 0.6], [2000, 10.0, 0.679], [3000, 15.0, 0.681], [4000, 20.0, 0.5], [5000, 25.0, 0.7]]
    assert found.seconds_to_reference(curve) == 15.0
    assert found.seconds_to_reference(curve[:2]) is None


def test_a_score_is_a_share_of_the_room(tmp_path):
    found = scores.known(gym.make("BicycleStab-v0"), written(tmp_path))
    assert found.score(0.5) == 0.0
    assert found.score(0.7) == pytest.approx(1.0)
    assert found.score(0.45) == pytest.approx(-0.25)
    assert found.regret(90.0) == 30.0
    assert scores.scored(found, {"mine": row(0.6, 110.0)}) == {"mine": {"score": pytest.approx(0.5), "regret": 10.0}}
    assert scores.sentences(found, {"mine": row(0.6, 110.0)}) == [
        "score: mine 0.50 (0: lqr, tuned, saves 50.0 % of 2000 starts; 1: best found, 20.0 points more on those that "
        "were searched)",
        "regret in return: mine 10.00 (best known 120.00; results/headroom.json)",
    ]


def test_the_zero_is_measured_on_all_starts_and_the_room_on_those_that_were_searched(tmp_path):
    path = written(tmp_path)
    content = json.loads(path.read_text())
    content["settings"]["BicycleStab-v0 medium"]["drivers"] = {"lqr, tuned": row(0.55, 100.0)}
    path.write_text(json.dumps(content))
    found = scores.known(gym.make("BicycleStab-v0"), path)
    assert found.score(0.55) == 0.0
    assert found.score(0.65) == pytest.approx(0.5)


def test_where_the_optimum_is_reached_there_is_no_score(tmp_path):
    found = scores.known(gym.make("BicycleStab-v0", level="medium"), written(tmp_path, 0.69, 0.70))
    assert found.score(0.7) is None
    assert scores.sentences(found, {"mine": row(0.6, 110.0)})[0].startswith(
        "no score: as far as a search knows it, the optimum is reached"
    )


@pytest.mark.parametrize("keywords", [{"friction": 0.5}, {"level": "hard"}, {"max_episode_steps": 100}])
def test_another_setting_has_no_score(keywords, tmp_path):
    env = gym.make("BicycleStab-v0", **keywords)
    env.reset(seed=0)  # from then on the time limit is known
    assert scores.known(env, written(tmp_path)) is None


def test_without_results_there_is_no_score(tmp_path):
    assert scores.known(gym.make("BicycleStab-v0"), tmp_path / "none.json") is None


def test_a_damaged_file_is_named(tmp_path):
    path = written(tmp_path)
    path.write_text(path.read_text().replace('"room"', '"rooms"'))
    with pytest.raises(FileError, match=r"headroom\.json"):
        scores.known(gym.make("BicycleStab-v0"), path)
