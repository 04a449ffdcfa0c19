"""Controllers by their parameters: what they declare, by name and from files, many at once, and what is shipped."""

import json

import gymnasium as gym
import numpy as np
import pytest

from bicycle_env import control
from bicycle_env.control.tunable import shipped_rows

IDS = ("BicycleStab-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0")
STAB, ACTIVE, EVADE = (gym.make(env_id).unwrapped for env_id in IDS)
PLANTS = dict.fromkeys(control.TUNABLE, STAB) | {"evade-path": EVADE, **dict.fromkeys(control.REAR_STEERINGS, ACTIVE)}


def usual(name):
    return control.TUNABLE[name].usual(PLANTS[name])


def observations(name, rows):
    return np.random.default_rng(0).uniform(-0.3, 0.3, (rows, len(PLANTS[name].observation_names))).astype(np.float32)


@pytest.mark.parametrize("name", control.TUNABLE)
def test_by_its_own_parameters_it_is_the_one_by_name(name):
    seen = observations(name, 3)
    expected = control.make(name, PLANTS[name]).act(seen)
    np.testing.assert_array_equal(control.make(name, PLANTS[name], parameters=usual(name)).act(seen), expected)


@pytest.mark.parametrize("name", control.TUNABLE)
def test_each_parameter_matters(name):
    controller, plant = control.TUNABLE[name], PLANTS[name]
    values, seen = control.values_of(controller, plant, usual(name)), observations(name, 40)
    if name == "evade-path":  # where both ways are seen, and no action is clipped
        gates, seen = plant.observation_names.index("obstacle_begin"), 0.02 * seen
        for rows, seconds in ((slice(20), (0.3, 0.6, 1.4)), (slice(20, 40), (-0.9, -0.4, 0.9))):
            seen[rows, gates : gates + 3] += np.array(seconds) * plant.speed / plant.observation_scale[gates]
        seen[:, plant.observation_names.index("side")] = 0.02
    else:
        seen *= 0.05

    def actions(values):
        policy = controller.of(plant, values)
        return np.array([policy.act(seen) for _ in range(12)])

    for k, one in enumerate(control.searched(controller, plant)):
        if name == "rear-switched" and not one.name.startswith("first_half"):
            continue
        others = values.copy()
        others[k] = 0.7 * values[k] + 0.03
        assert np.any(actions(others) != actions(values)), one.name


@pytest.mark.parametrize("name", control.TUNABLE)
def test_what_is_declared(name):
    controller, plant = control.TUNABLE[name], PLANTS[name]
    assert len({one.name for one in controller.parameters}) == len(controller.parameters)
    for one in controller.parameters:
        assert one.scale == "linear" or (one.scale == "log" and one.least > 0.0)
        assert one.least < one.greatest
        assert one.start is None or (one.least <= one.start <= one.greatest and one.spread > 0.0)
    assert np.all(np.isfinite(control.values_of(controller, plant, usual(name))))


@pytest.mark.parametrize("name", ["lqr", "preview", "rear-switched", "evade-path"])
def test_many_sets_at_once_act_as_each_alone(name):
    controller, plant = control.TUNABLE[name], PLANTS[name]
    values = control.values_of(controller, plant, usual(name))
    sets = values * np.linspace(0.9, 1.1, 3)[:, None]
    policy, seen = control.Candidates(controller, plant, sets, 2), 0.1 * np.tile(observations(name, 2), (3, 1))
    policy.reset()
    found = [policy.act(seen) for _ in range(12)]  # a driver is late
    assert policy.valid.all()
    for k, row in enumerate(sets):
        alone = controller.of(plant, row)
        for actions in found:
            np.testing.assert_allclose(alone.act(seen[2 * k : 2 * k + 2]), actions[2 * k : 2 * k + 2], atol=1e-6)
    assert np.any(found[-1][:2] != found[-1][2:4])
    policy.reset(np.ones(6, np.bool_))
    np.testing.assert_array_equal(policy.act(seen), found[0])


@pytest.mark.parametrize("name", ["lqr", "rear-linear"])
def test_values_that_give_no_controller_are_said(name, monkeypatch):
    controller, plant = control.TUNABLE[name], PLANTS[name]
    values = np.tile(control.values_of(controller, plant, usual(name)), (3, 1))
    values[0] *= 0.5
    right = controller.of.__func__

    def of(cls, plant, row):
        if row[0] == values[0, 0]:
            raise np.linalg.LinAlgError("no solution")
        return right(cls, plant, row)

    monkeypatch.setattr(controller, "of", classmethod(of))
    policy, seen = control.Candidates(controller, plant, values, 2), observations(name, 6)
    assert policy.valid.tolist() == [False, True, True]
    assert np.all(policy.act(seen)[:2] == 0.0)
    assert np.any(policy.act(seen)[2:] != 0.0)


def test_the_parameters_of_an_axle_that_is_not_steered_are_left_out():
    plant = gym.make("BicycleStab-v0", steer="rear").unwrapped
    names = [one.name for one in control.searched(control.LQR, plant)]
    assert names == ["heading", "sideslip", "yaw_rate", "rear_command"]
    given = usual("lqr")
    without = {name: value for name, value in given.items() if name != "front_command"}
    assert control.values_of(control.LQR, plant, given).tolist() == list(without.values())
    seen = observations("lqr", 4)
    found = control.make("lqr", plant, parameters=without)
    np.testing.assert_array_equal(found.act(seen), control.make("lqr", plant).act(seen))


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"headnig": 1.0}, "unknown parameter of 'lqr' 'headnig'; did you mean 'heading'"),
        ({"heading": 0.0}, "heading must be a finite number in"),
        ({"heading": "1"}, "heading must be a finite number in"),
        ({"heading": None}, "missing 'heading'"),
    ],
)
def test_bad_parameters_are_one_line(parameters, words, tmp_path):
    given = {name: value for name, value in {**usual("lqr"), **parameters}.items() if value is not None}
    with pytest.raises((ValueError, TypeError), match=words):
        control.make("lqr", STAB, parameters=given)
    path = tmp_path / "tuned.json"
    path.write_text(json.dumps({"controller": "lqr", "parameters": given}))
    with pytest.raises(ValueError, match=f"tuned.json: .*{words}") as raised:
        control.from_file(path, STAB)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"controller": "lqrr", "parameters": {}}, "controller must be one of .*did you mean 'lqr'"),
        ({"controller": "os:system", "parameters": {}}, "controller must be one of"),
        ({"controller": "zero"}, "controller must be one of"),
        ({}, "controller must be one of"),
        ({"controller": "lqr"}, "parameters must be a table"),
        ({"controller": "lqr", "parameters": [1]}, "parameters must be a table"),
    ],
)
def test_a_damaged_file_is_one_line_that_names_it(content, words, tmp_path):
    path = tmp_path / "tuned.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=f"tuned.json: .*{words}"):
        control.from_file(path, STAB)


def test_a_file_serves_the_controller_that_it_is_of(tmp_path):
    path = tmp_path / "tuned.json"
    path.write_text(json.dumps({"controller": "rear-linear", "parameters": usual("rear-linear"), "seconds": 3}))
    seen = observations("rear-linear", 4)
    expected = control.make("rear-linear", ACTIVE).act(seen)
    for policy in (control.from_file(path, ACTIVE), control.make("rear-linear", ACTIVE, parameters=path)):
        np.testing.assert_array_equal(policy.act(seen), expected)
    with pytest.raises(ValueError, match="controller must be 'rear-switched', got 'rear-linear'"):
        control.make("rear-switched", ACTIVE, parameters=path)


def test_a_file_alone_imports_nothing(tmp_path):
    path, own = tmp_path / "tuned.json", "bicycle_env.control.lqr:LQR"
    path.write_text(json.dumps({"controller": own, "parameters": usual("lqr")}))
    with pytest.raises(ValueError, match="controller must be one of"):
        control.from_file(path, STAB)
    assert np.array_equal(control.make(own, STAB, parameters=path).gain, control.make("lqr", STAB).gain)


def test_who_has_no_parameters():
    with pytest.raises(ValueError, match="controller with parameters must be one of"):
        control.make("zero", STAB, parameters={})
    with pytest.raises(TypeError, match="must be a TunablePolicy"):
        control.tunable("bicycle_env.control.policy:Zero")
    assert control.tunable("bicycle_env.control.lqr:LQR") is control.LQR


def test_every_shipped_row_is_in_range_and_says_what_made_it():
    rows = shipped_rows()
    assert len({(row["controller"], row["task"], steer) for row in rows for steer in row["steer"]}) == sum(
        len(row["steer"]) for row in rows
    )
    for row in rows:
        allowed = {one.name: (one.least, one.greatest) for one in control.TUNABLE[row["controller"]].parameters}
        assert all(allowed[name][0] <= value <= allowed[name][1] for name, value in row["parameters"].items())
        assert row["command"]
