"""What an optimum saves: controllers tuned for an environment, and steering found by search in the true simulator.

It stands on top of envs and control; nothing below imports it.
"""

from __future__ import annotations

from bicycle_env.optimum.outcomes import Cars, Outcome, Outcomes, by, drive, make_cars, replay
from bicycle_env.optimum.parameter_search import OwnParameters, draws_of, search_parameters
from bicycle_env.optimum.steering_search import Rescue, search_steering
from bicycle_env.optimum.tuning import Budget, Candidate, Space, Tuning, budget, tune

__all__ = [
    "Budget",
    "Candidate",
    "Cars",
    "Outcome",
    "Outcomes",
    "OwnParameters",
    "Rescue",
    "Space",
    "Tuning",
    "budget",
    "by",
    "draws_of",
    "drive",
    "make_cars",
    "replay",
    "search_parameters",
    "search_steering",
    "tune",
]
