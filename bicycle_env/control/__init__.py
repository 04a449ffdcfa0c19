"""Controllers and policies: one interface, an observation in and an action out."""

from __future__ import annotations

from bicycle_env.control.active_steer import REAR_STEERINGS
from bicycle_env.control.driver import DRIVERS, Scripted
from bicycle_env.control.evade_path import EvadePath, PathRound
from bicycle_env.control.four_wheel_steer import REAR_LAWS, DriverAndLaw
from bicycle_env.control.lqg import LQG
from bicycle_env.control.lqr import LQR, ContinuousLQR, ScheduledLQR, Weights, read_weights, tuned_weights
from bicycle_env.control.mpc import MPC
from bicycle_env.control.network import Network, read
from bicycle_env.control.pole_placement import PolePlacement
from bicycle_env.control.policy import Function, Plant, Policy, Zero
from bicycle_env.control.pretrained import PRETRAINED, load_policy, published
from bicycle_env.control.registry import (
    NAMES,
    POLICIES,
    TUNABLE,
    alone_among_many,
    descriptions,
    from_file,
    load,
    make,
    on_base,
    tunable,
)
from bicycle_env.control.residual import Residual
from bicycle_env.control.tunable import Candidates, Parameter, TunableLaw, TunablePolicy, searched, values_of

__all__ = [
    "DRIVERS",
    "LQG",
    "LQR",
    "MPC",
    "NAMES",
    "POLICIES",
    "PRETRAINED",
    "REAR_LAWS",
    "REAR_STEERINGS",
    "TUNABLE",
    "Candidates",
    "ContinuousLQR",
    "DriverAndLaw",
    "EvadePath",
    "Function",
    "Network",
    "Parameter",
    "PathRound",
    "Plant",
    "PolePlacement",
    "Policy",
    "Residual",
    "ScheduledLQR",
    "Scripted",
    "TunableLaw",
    "TunablePolicy",
    "Weights",
    "Zero",
    "alone_among_many",
    "descriptions",
    "from_file",
    "load",
    "load_policy",
    "make",
    "on_base",
    "published",
    "read",
    "read_weights",
    "searched",
    "tunable",
    "tuned_weights",
    "values_of",
]
