"""What a policy bears: the quantities that are changed, and its margins, which for LQR are those of its design."""

from __future__ import annotations

import json
import math
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents import robustness
from agents.messages import UserError
from bicycle_env import control, distributions
from bicycle_env.control.design.margins import margins, state_feedback_loop
from bicycle_env.control.policy import Policy

ENV = gym.make("BicycleStab-v0").unwrapped
LQR = control.make("lqr", ENV)


class Turned(Policy):
    """LQR with another sign."""

    name = "turned"

    def act(self, observation):
        return -LQR.act(observation)


class OneSided(Policy):
    """Steers one way more than the other."""

    name = "one-sided"

    def act(self, observation):
        return np.maximum(LQR.act(observation), np.float32(-0.1))


def test_the_margins_of_lqr_are_those_of_its_design():
    found = robustness.at_rest(ENV, LQR)
    model = ENV.linear_model()
    expected = margins(state_feedback_loop(model, LQR.gain))
    assert found["stable"]
    for axle, one in expected.items():
        assert found["margins"][axle]["gain_decrease"] == pytest.approx(one.gain_decrease, rel=0.02, abs=1e-3)
        assert found["margins"][axle]["gain_increase"] == pytest.approx(one.gain_increase, rel=0.02)
        assert found["margins"][axle]["disk"] == pytest.approx(one.disk, rel=0.02)
    poles = np.sort(np.abs(np.linalg.eigvals(model.A - model.B @ LQR.gain)))[::-1]
    assert np.hypot(*np.array(found["eigenvalues"]).T)[:6] == pytest.approx(poles, rel=1e-3, abs=1e-3)
    assert found["slowest_time_constant"] == pytest.approx(-model.timestep / math.log(poles[0]), rel=1e-2)


class Damped(Policy):
    """LQR, less a part of the last action that it gave."""

    name = "damped"
    part = -0.6

    def act(self, observation):
        names = ["front_steer_command", "rear_steer_command"]
        places = [list(ENV.observation_names).index(name) for name in names]
        last = observation[places] * ENV.observation_scale[places] / ENV.linear_model().input_scale
        return LQR.act(observation) + np.float32(self.part) * last


def after_a_while(part, delay):
    """How far the linear car is from straight running after 2000 steps, with LQR, whose actions come late."""
    model, last = ENV.linear_model(), np.zeros(2)
    state, under_way = np.full(len(model.A), 1e-3), [last] * delay
    for _ in range(2000):
        last = -LQR.gain @ state + part * last
        under_way.append(last)
        state = model.A @ state + model.B @ under_way.pop(0)
    return np.abs(state).max()


@pytest.mark.parametrize(("policy", "part"), [(LQR, 0.0), (Damped(), Damped.part)])
def test_the_delay_that_straight_running_bears_is_the_one_after_which_it_is_left(policy, part):
    delay = robustness.at_rest(ENV, policy)["delay"]
    assert after_a_while(part, delay) < 1e-6
    assert after_a_while(part, delay + 1) > 1.0


def test_who_is_unstable_or_not_odd_is_named():
    rest = robustness.at_rest(ENV, Turned())
    assert not rest["stable"]
    row = {"asymmetry": robustness.asymmetry(ENV, Turned()), "at_rest": rest}
    (line,) = robustness.sentences("turned", row)
    assert line.startswith("turned: UNSTABLE at straight running")
    row = {"asymmetry": robustness.asymmetry(ENV, OneSided()), "at_rest": robustness.at_rest(ENV, OneSided())}
    assert robustness.sentences("one-sided", row)[0].startswith("one-sided: not odd")
    assert robustness.asymmetry(ENV, LQR) == 0.0


def test_who_remembers_has_no_jacobian():
    names = list(ENV.observation_names)
    layers = [(np.zeros((2, 2 * len(names)), np.float32), np.zeros(2, np.float32))]
    network = control.Network(layers, "tanh", "clip", {"observation_names": names, "history": 2})
    assert robustness.at_rest(ENV, network) is None


def test_a_card_is_written_under_the_level_s_name(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(robustness, "points", lambda _: {"friction": (1.0,)})
    words = ["--env-id", "BicycleStab-v0", "--level", "medium", "--policy", "lqr", "zero", "--starts", "4"]
    monkeypatch.setattr("sys.argv", ["robustness", *words])
    robustness.main()
    content = json.loads(Path("runs/robustness-BicycleStab-v0-medium.json").read_text())
    assert content["command"] == "python -m agents.robustness " + " ".join(words)
    assert content["level"] == "medium"
    assert content["changes"]["friction"]["policies"]["zero"][0]["success_rate"]["value"] == 0.0
    assert Path("runs/robustness-BicycleStab-v0-medium.png").is_file()
    monkeypatch.setattr("sys.argv", ["robustness", *words, "--env-keywords", '{"level": "hard"}'])
    with pytest.raises(UserError, match="--level medium: --env-keywords says level hard"):
        robustness.main()


@pytest.mark.parametrize(
    ("quantity", "value", "check"),
    [
        ("mass", 1.1, lambda env: env.vehicle.mass / ENV.vehicle.mass == pytest.approx(1.1)),
        ("stiffness", 0.9, lambda env: env.vehicle.rear_cornering_stiffness < ENV.vehicle.rear_cornering_stiffness),
        ("speed", 0.95, lambda env: env.speed == pytest.approx(0.95 * ENV.speed)),
        ("friction", 0.7, lambda env: env.friction == pytest.approx(0.7 * ENV.friction)),
    ],
)
def test_one_quantity_is_another_and_the_speed_stays(quantity, value, check):
    env = gym.make("BicycleStab-v0", **robustness.changed(ENV, quantity, value)).unwrapped
    assert check(env)
    assert quantity == "speed" or env.speed == ENV.speed


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ((0.4, 1.0), {"low": 0.2, "high": 0.5}),
        ([0.4, 1.0], {"low": 0.2, "high": 0.5}),
        ({"name": "normal", "mean": 0.8, "deviation": 0.2, "low": 0.4, "high": 1.0}, {"mean": 0.4, "deviation": 0.1}),
        (distributions.Choice(values=(0.4, 1.0)), {"values": (0.2, 0.5)}),
    ],
)
def test_what_is_drawn_for_each_episode_is_another_too(given, wanted):
    """Else a hidden friction would stay what it was, whatever the nominal car's is."""
    own = {"randomise": {"friction": given, "mass": (0.9, 1.2, "relative")}}
    changed = robustness.changed(ENV, "friction", 0.5, own)
    drawn = changed["randomise"]["friction"]
    assert {name: getattr(drawn, name) for name in wanted} == wanted
    assert changed["randomise"]["mass"] == (0.9, 1.2, "relative")
    assert changed["friction"] == 0.5 * ENV.friction
    assert "randomise" not in robustness.changed(ENV, "mass", 1.1, own)  # it follows the nominal one
    assert "randomise" not in robustness.changed(ENV, "speed", 1.1, own)


@pytest.mark.exhaustive
def test_what_a_level_has_already_stays():
    plant = gym.make("BicycleLaneChange-v0", level="hard").unwrapped
    own = robustness.stated(plant, {"level": "hard", "speed_ratio": 1.1})
    assert own["speed_ratio"] == 1.1
    assert robustness.changed(plant, "action_delay", 2.0, own) == {"action_delay": 5}
    assert "noise" in robustness.points(own)
    noisy = gym.make("BicycleActiveSteer-v0", level="hard").unwrapped
    assert "noise" not in robustness.points(robustness.stated(noisy, {"level": "hard"}))
