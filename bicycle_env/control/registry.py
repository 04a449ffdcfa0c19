"""Every controller by its name: what ``make`` builds and a command line lists."""

from __future__ import annotations

import importlib
import inspect
from typing import Any

from bicycle_env.control.driver import DRIVERS
from bicycle_env.control.four_wheel_steer import COMBINATIONS, REAR_LAWS, driver_and_law
from bicycle_env.control.lqg import LQG
from bicycle_env.control.lqr import LQR, ContinuousLQR, ScheduledLQR
from bicycle_env.control.mpc import MPC
from bicycle_env.control.pole_placement import PolePlacement
from bicycle_env.control.policy import Plant, Policy, Zero
from bicycle_env.physics.validation import choice

CLASSES: tuple[type[Policy], ...] = (
    Zero,
    LQR,
    ContinuousLQR,
    ScheduledLQR,
    PolePlacement,
    LQG,
    MPC,
    *DRIVERS.values(),
)
POLICIES: dict[str, Any] = {policy.name: policy for policy in CLASSES}
"""Name -> class of the controllers that are made from an environment alone."""

NAMES = (*POLICIES, *COMBINATIONS)
"""All that ``make`` takes: ``POLICIES`` and every driver with every rear-steer law."""


def make(name: str, env: Any) -> Policy:
    """A controller by name, designed for an environment.

    Args:
        name: one of ``POLICIES``, or DRIVER+LAW: a driver at the front wheels and a law at the rear ones, for example
            "preview+sano"; or "module:Class", a :class:`Policy` of one's own, which is made from the environment.
        env: the environment, wrapped or not.

    Raises:
        ValueError, TypeError: an unknown name (the message proposes the nearest); a controller that cannot drive this
            environment, for example a driver where only the rear wheels are steered.
    """
    plant: Plant = getattr(env, "unwrapped", env)
    if not hasattr(plant, "linear_model"):
        raise TypeError(f"env must be an environment of this package, got {env!r}")
    if isinstance(name, str) and name in REAR_LAWS:
        drivers = " or ".join(repr(f"{driver}+{name}") for driver in DRIVERS)
        raise ValueError(f"policy {name!r} steers the rear wheels only, and needs a driver at the front: {drivers}.")
    if isinstance(name, str) and ":" in name:
        return _of_ones_own(name, plant)
    choice("policy", name, NAMES)
    policy: Policy = POLICIES[name](plant) if name in POLICIES else driver_and_law(name, plant)
    return policy


def _of_ones_own(name: str, plant: Plant) -> Policy:
    module_name, _, class_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ValueError(f"policy {name!r}: the module {module_name!r} cannot be imported ({error})") from None
    classes = [key for key, value in vars(module).items() if isinstance(value, type) and issubclass(value, Policy)]
    made = vars(module)[choice(f"policy: class in {module_name}", class_name, classes)](plant)
    policy: Policy = made
    return policy


def descriptions() -> dict[str, str]:
    """One line about every controller, the first of its docstring; a rear-steer law stands as "DRIVER+LAW"."""
    rows = {name: _summary(policy) for name, policy in POLICIES.items()}
    return rows | {f"DRIVER+{name}": _summary(law) for name, law in REAR_LAWS.items()}


def _summary(documented: Any) -> str:
    return (inspect.getdoc(documented) or "").partition("\n")[0].replace("``", "")
