"""What is written out of the manoeuvres and of the rear wheels' laws is what the controllers do."""

from types import SimpleNamespace

import numpy as np
import pytest

from bicycle_env import control
from bicycle_env.explore import steering
from bicycle_env.explore.answers import configuration
from bicycle_env.explore.steering import MANOEUVRES, numbers_of
from bicycle_env.export.command import Uncompiled
from bicycle_env.physics.elementary import PYTHON


@pytest.fixture(scope="module")
def plant():
    return Uncompiled(configuration(vehicle="oversteer", speed=43.0))


@pytest.fixture(scope="module")
def laws(plant):
    """What is written out, by name, in plain Python."""
    library = steering.library(control.REAR_LAWS["sano"](plant))
    return {routine.name: routine.law(PYTHON) for routine in library.routines}


@pytest.mark.parametrize("name", control.REAR_LAWS)
def test_a_rear_law(name, plant, laws):
    law, draws = control.REAR_LAWS[name](plant), np.random.default_rng(5)
    written, given = laws[name.replace("-", "_")], SimpleNamespace(**numbers_of(law))
    place = plant.observation_names.index("yaw_rate")
    scale, memory, seen = 1.0 / float(plant.observation_scale[place]), 0.0, set()
    for _ in range(40):
        front = np.float32(draws.uniform(-1.0, 1.0))
        observation = draws.uniform(-1.0, 1.0, len(plant.observation_names)).astype(np.float32)
        wanted = float(law.act(front, observation))
        action, memory = written(float(front), float(observation[place]), scale, memory, given, plant.car)
        assert min(max(action, -1.0), 1.0) == pytest.approx(wanted, rel=1e-6, abs=1e-7)
        seen.add(abs(wanted) < 1.0)
    assert True in seen


@pytest.mark.parametrize("driver", MANOEUVRES, ids=lambda driver: driver.name)
def test_a_manoeuvre(driver, plant, laws):
    policy = control.Scripted(plant, driver)
    policy.reset()
    observation, given = np.zeros(8, np.float32), SimpleNamespace(**driver.numbers())
    rows = [policy.act(observation) for _ in range(150)]
    wanted = [laws[driver.name](0.02 * k, given, plant.car) for k in range(150)]
    np.testing.assert_allclose(np.array(rows), np.column_stack([wanted, np.zeros(150)]), rtol=1e-6, atol=1e-9)
    assert max(wanted) > 0.1
