"""What an optimum saves: weights tuned for an environment, and steering found by search in the true simulator.

It stands on top of envs and control; nothing below imports it.
"""

from __future__ import annotations

from bicycle_env.optimum.gain_tuning import GainTuning, tune_gains
from bicycle_env.optimum.outcomes import Outcomes, drive, make_cars
from bicycle_env.optimum.steering_search import Rescue, search_steering
from bicycle_env.optimum.weight_tuning import Tuning, tune_weights

__all__ = [
    "GainTuning",
    "Outcomes",
    "Rescue",
    "Tuning",
    "drive",
    "make_cars",
    "search_steering",
    "tune_gains",
    "tune_weights",
]
