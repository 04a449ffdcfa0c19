"""A network that imitates a controller drives as well."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from agents import imitation, ppo
from agents.messages import UserError
from bicycle_env import control, optimum

ARGS = ppo.Args(cars=16, quiet=True)


@pytest.mark.exhaustive
def test_a_network_learns_what_a_controller_does(monkeypatch):
    monkeypatch.setattr(imitation, "GRADIENT_STEPS", 150)
    torch.manual_seed(0)
    cars = optimum.Cars("BicycleStab-v0", {})
    learner = ppo.Learner(ARGS, ppo.Cars(ARGS, {}))
    lqr, seeds = control.make("lqr", cars.plant), list(range(64 * imitation.ROUNDS))
    left = imitation.imitate(learner.policy, lqr, cars.of(64), seeds, 1, 1)
    assert left < 0.02
    network = control.Network(
        learner.layers(), "tanh", "clip", {"observation_names": list(cars.plant.observation_names)}
    )
    mirror = {**network.description, "mirror": cars.plant.observation_mirror.astype(int).tolist()}
    image = control.Network(learner.layers(), "tanh", "clip", mirror)
    starts = list(range(1000, 1064))
    theirs = optimum.drive(cars.of(64), optimum.by(lqr), starts).success.mean()
    assert optimum.drive(cars.of(64), optimum.by(image), starts).success.mean() >= theirs - 0.15


@pytest.mark.parametrize("name", ["lqrr", "rear-switched"])
def test_whom_it_cannot_imitate_is_one_line(name):
    cars = optimum.Cars("BicycleStab-v0", {})
    policy = ppo.Learner(ARGS, ppo.Cars(ARGS, {})).policy
    with pytest.raises(UserError, match="--imitate: "):
        imitation.begin(policy, ppo.Args(imitate=name), {}, cars)


def test_whose_parameters_are_the_same_for_all_cars_cannot_plan():
    cars = optimum.Cars("BicycleStab-v0", {})
    policy = ppo.Learner(ARGS, ppo.Cars(ARGS, {})).policy
    with pytest.raises(UserError, match="--plan: lqr has no parameters that may differ from car to car"):
        imitation.begin(policy, ppo.Args(imitate="lqr", plan=1), {}, cars)


def test_what_is_copied_is_what_was_seen_at_a_decision():
    cars = optimum.Cars("BicycleStab-v0", {})

    class Counting(control.Policy):
        name, asked = "counting", 0

        def act(self, observation):
            self.asked += 1
            return np.zeros((len(observation), 2), np.float32)

    teacher = Counting()
    pairs = imitation._driven(torch.nn.Linear(16, 2), teacher, cars.of(4), [1, 2, 3, 4], 0, 3, 2)
    assert len(pairs) == -(-teacher.asked // 3)  # the teacher acts in every step, the network every third
    seen = [pair[0].numpy() for pair in pairs]
    np.testing.assert_array_equal(seen[0][:, :8], seen[0][:, 8:])
    rows = len(seen[1])
    if rows == 4:
        np.testing.assert_array_equal(seen[1][:, 8:], seen[0][:, :8])
