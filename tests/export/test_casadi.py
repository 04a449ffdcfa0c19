"""The plant as a casadi.Function x' = f(x, u), from its file."""

import runpy

import numpy as np
import pytest

from bicycle_env import export
from bicycle_env.export.plant import Command
from bicycle_env.physics.elementary import PYTHON

casadi = pytest.importorskip("casadi")


@pytest.mark.parametrize("keywords", [{"tire": "fiala"}, {"tire": "magic_formula", "relaxation_length": 0.5}])
def test_the_file_is_the_law(keywords, tmp_path):
    plant = export.plant(**keywords)
    export.export_plant(plant, "casadi", tmp_path)
    function = casadi.Function.load(str(tmp_path / "bicycle_plant.casadi"))
    rates = plant.model.actuated_rates(PYTHON)
    car = plant.car._replace(front_rate_limit=np.inf, rear_rate_limit=np.inf)
    draws = np.random.default_rng(1)
    for _ in range(5):
        state = draws.uniform(-0.2, 0.2, len(plant.model.State._fields))
        command = draws.uniform(-0.2, 0.2, 2)
        wanted = rates(plant.model.State(*state.tolist()), Command(*command.tolist()), car)
        np.testing.assert_allclose(function(state, command).full().ravel(), wanted, rtol=1e-10, atol=1e-12)


def test_the_example_runs(tmp_path, capsys):
    export.export_plant(export.plant(), "casadi", tmp_path)
    names = runpy.run_path(str(tmp_path / "load_bicycle_plant.py"), run_name="__main__")
    assert names["STATE"][3] == "lateral_velocity"
    assert "'front_steer': 2.09" in capsys.readouterr().out


def test_a_pushed_plant_is_refused(tmp_path):
    with pytest.raises(ValueError, match="pushed must be False"):
        export.export_plant(export.plant(pushed=True), "casadi", tmp_path)
