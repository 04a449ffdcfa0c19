"""Two independent paths to the same limit: continuation finds a fold where the handling curve's critical speed is U."""

import numpy as np
import pytest

from bicycle_env import analysis, vehicles


@pytest.mark.parametrize("tire", ["tanh", "fiala", "magic_formula"])
@pytest.mark.parametrize("speed", [20.0, 30.0])
def test_a_steady_turn_is_lost_at_the_critical_speed_of_that_turn(tire, speed):
    """An oversteering car well below the critical speed of straight running: the first fold to the left."""
    (through_zero, *_) = analysis.equilibrium_branches(
        "oversteer", speed, tire=tire, geometry="small_angle", steer_limit=0.1, sideslip_limit=0.3
    )
    folds = [each for each in through_zero.bifurcations if each.kind == "fold"]
    fold = min((each for each in folds if each.front_steer > 0.0), key=lambda each: each.front_steer)

    curve = analysis.handling_diagram("oversteer", tire=tire, points=2001).curves[0]
    known = np.isfinite(curve.critical_speed)
    ay, critical = curve.lateral_acceleration[known], curve.critical_speed[known]
    assert critical[0] == pytest.approx(vehicles["oversteer"].critical_speed, rel=1e-9)
    assert np.all(np.diff(critical) < 0.0)
    at_limit = np.interp(-speed, -critical, ay)
    assert fold.equilibrium.lateral_acceleration == pytest.approx(at_limit, rel=1e-5)
    # The steer angle there: the curve above the speed's line L / R = L ay / U^2.
    steer = vehicles["oversteer"].wheelbase * at_limit / speed**2 + np.interp(
        at_limit, ay, curve.slip_difference[known]
    )
    assert fold.front_steer == pytest.approx(steer, rel=1e-5)
