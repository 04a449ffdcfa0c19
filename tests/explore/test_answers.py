"""What the page asks Python: the answers are those of analysis and control; bad, late and superseded questions."""

import dataclasses
import json
import threading

import numpy as np
import pytest

from bicycle_env import analysis, control, vehicles
from bicycle_env.explore import answers
from bicycle_env.explore.answers import Answers, SupersededError, design


def asked(**question):
    return json.dumps({"vehicle": "oversteer", "speed": 43.0, **question}).encode()


def test_gains_of_a_changed_car():
    question = asked(ask="design", changes={"mass": 1700.0}, steer="rear")
    found = json.loads(Answers().answer(question))
    assert found == design(dataclasses.replace(vehicles["oversteer"], mass=1700.0), 43.0, "lqr", "rear")
    assert np.shape(found["weights"]) == (1, 8)


@pytest.mark.parametrize("policy", answers.DESIGNED)
def test_what_is_designed_knows_the_actuators_that_it_needs(policy):
    usual = json.loads(Answers().answer(asked(ask="design", policy=policy)))
    slow = {"angle_limit": 0.08, "time_constant": 0.2}
    found = json.loads(Answers().answer(asked(ask="design", policy=policy, front_actuator=slow)))
    assert found.get("rear") == usual.get("rear")
    assert ("weights" in found) == (policy not in control.REAR_LAWS)
    assert "weights" not in found or found["weights"] != usual["weights"]
    assert found.get("delay") == (10 if policy.startswith("preview") else None)


def test_steady_turns_and_edges_are_those_of_analysis():
    found = json.loads(Answers().answer(asked(ask="portrait", speed=30.0, friction=0.5)))
    turns = analysis.equilibria("oversteer", 30.0, (0.0, 0.0), friction=0.5, sideslip_limit=0.5)
    inside = [turn for turn in turns if abs(turn.yaw_rate) <= 1.2]
    assert [turn["kind"] for turn in found["equilibria"]] == [turn.kind for turn in inside]
    assert "saddle" in {turn["kind"] for turn in found["equilibria"]}
    for turn, wanted in zip(found["equilibria"], inside, strict=True):
        assert (turn["sideslip"], turn["yaw_rate"]) == pytest.approx((wanted.sideslip, wanted.yaw_rate))
    assert len(found["edges"]) == 4
    assert all(len(edge) < 200 for edge in found["edges"])


@pytest.mark.exhaustive
def test_the_recoverable_set_is_that_of_analysis():
    found = json.loads(Answers().answer(asked(ask="recoverable", friction=0.8)))
    limits = (answers.FRONT.angle_limit, answers.REAR.angle_limit)
    known = analysis.recoverable_set("oversteer", 43.0, friction=0.8, steer_limits=limits, grid=(121, 121))
    bits = np.array([[int(bit) for bit in f"{int(row, 16):0121b}"] for row in found["rows"]], bool)
    np.testing.assert_array_equal(bits, np.isfinite(known.least_time).T)
    assert 0.0 < bits.mean() < 1.0
    assert (found["sideslip"], found["yaw_rate"]) == (known.sideslip_limit, known.yaw_rate_limit)


def test_the_recoverable_set_is_that_of_the_actuators_angle_limits(monkeypatch):
    asked_for = {}

    def noted(*arguments, steer_limits, **words):
        asked_for["limits"] = steer_limits
        raise analysis.IntractableError("noted")

    monkeypatch.setattr(analysis, "recoverable_set", noted)
    limited = {"angle_limit": 0.02, "time_constant": 0.05}
    with pytest.raises(ValueError, match="noted"):
        Answers().answer(asked(ask="recoverable", rear_actuator=limited))
    assert asked_for["limits"] == (answers.FRONT.angle_limit, 0.02)


@pytest.mark.parametrize(
    ("question", "complaint"),
    [
        (b"not JSON", "not JSON"),
        (b"[" * 3000, "question"),
        (b" " * 5000, "must not be larger"),
        (asked(ask="everything"), "ask"),
        (asked(ask="design", vehicle="../../secret"), "vehicle"),
        (asked(ask="design", path="x"), "path"),
        (asked(ask="design", changes={"name": 1.0}), "name"),
        (asked(ask="design", changes={"mass": -1.0}), "mass"),
        (asked(ask="design", speed=1e9), "speed"),
        (asked(ask="recoverable", steer="none"), "steer"),
        (asked(ask="design", policy="secret"), "policy"),
        (asked(ask="design", front_actuator={"angle_limit": 0.1, "time_constant": 0.0}), "time_constant"),
    ],
)
def test_a_bad_question_is_one_line(question, complaint):
    with pytest.raises((ValueError, TypeError), match=complaint) as found:
        Answers().answer(question)
    assert "\n" not in str(found.value)


def test_an_answer_is_remembered_and_an_old_one_forgotten(monkeypatch):
    calls, made = [], Answers()
    monkeypatch.setattr(answers, "portrait", lambda *_: calls.append(1) or {})
    monkeypatch.setattr(answers, "MOST_KNOWN", 2)
    for speed in (20.0, 20.0, 21.0, 22.0, 22.0, 20.0):
        made.answer(asked(ask="portrait", speed=speed))
    assert len(calls) == 4


def test_a_newer_question_ends_the_older_ones_and_one_is_at_work_at_a_time(monkeypatch):
    begun, at_work, most, ended = threading.Event(), [], [], []

    def long(vehicle, speed, tire, friction, steer, progress, actuators):
        at_work.append(speed)
        most.append(len(at_work))
        try:
            begun.set()
            for _ in range(3_000_000 if speed < 40.0 else 1):  # a bound: without the guard it ends too, unasked
                progress(0.5)
            return {"speed": speed}
        finally:
            at_work.remove(speed)

    monkeypatch.setattr(answers, "recoverable", long)
    made = Answers()

    def wait_for(speed):
        try:
            made.answer(asked(ask="recoverable", speed=speed))
        except SupersededError:
            ended.append(speed)

    old = threading.Thread(target=wait_for, args=(20.0,))
    old.start()
    assert begun.wait(60.0)
    assert json.loads(made.answer(asked(ask="recoverable", speed=50.0))) == {"speed": 50.0}
    old.join(60.0)
    assert ended == [20.0]
    assert max(most) == 1


def test_nobody_waits_any_more(monkeypatch):
    monkeypatch.setattr(answers, "recoverable", lambda *given: given[-2](0.1))
    with pytest.raises(SupersededError):
        Answers().answer(asked(ask="recoverable"), lambda: True)


def test_what_the_caller_raises_ends_the_search():
    def refuse(share):
        raise SupersededError

    with pytest.raises(SupersededError):
        analysis.recoverable_set("oversteer", 43.0, tire="linear", grid=(31, 31), progress=refuse)
