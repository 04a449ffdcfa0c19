"""Every controller by its name: what ``make`` builds and a command line lists."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bicycle_env.control.active_steer import REAR_STEERINGS
from bicycle_env.control.driver import DRIVERS
from bicycle_env.control.evade_path import EvadePath
from bicycle_env.control.four_wheel_steer import COMBINATIONS, REAR_LAWS, DriverAndLaw, driver_and_law
from bicycle_env.control.lqg import LQG
from bicycle_env.control.lqr import LQR, ContinuousLQR, ScheduledLQR, read_weights
from bicycle_env.control.mpc import MPC
from bicycle_env.control.network import BASE, Network, read
from bicycle_env.control.pole_placement import PolePlacement
from bicycle_env.control.policy import Function, Plant, Policy, Zero
from bicycle_env.control.pretrained import PRETRAINED, pretrained
from bicycle_env.control.residual import Residual
from bicycle_env.control.tunable import TunablePolicy, values_of
from bicycle_env.files import anything, mapping, naming, read_json, table, text
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
    *REAR_STEERINGS.values(),
    EvadePath,
)
POLICIES: dict[str, Any] = {policy.name: policy for policy in CLASSES}
"""Name -> class of the controllers that are made from an environment alone."""

TUNABLE: dict[str, type[TunablePolicy]] = {
    policy.name: policy for policy in CLASSES if issubclass(policy, TunablePolicy)
}
"""Those of ``POLICIES`` that declare parameters."""

NAMES = (*POLICIES, *COMBINATIONS)
"""All that ``make`` takes: ``POLICIES`` and every driver with every rear-steer law."""


def tunable(name: str) -> type[TunablePolicy]:
    """The class of a controller whose parameters can be tuned; one of one's own is "module:Class".

    Raises:
        ValueError, TypeError: an unknown name (the message proposes the nearest); a class that declares no parameters.
    """
    if isinstance(name, str) and ":" in name:
        found = _ones_own(name)
        if not (isinstance(found, type) and issubclass(found, TunablePolicy)):
            raise TypeError(f"controller {name!r} must be a TunablePolicy to have parameters")
        return found
    return TUNABLE[choice("controller with parameters", name, TUNABLE)]


class OtherCar:
    """An environment as a controller sees it that is designed for another car or speed than the one driven.

    What is observed and commanded is the driven car's; vehicle, speed and linear model are the other's.
    """

    def __init__(self, driven: Any, other: Any) -> None:
        self.driven, self._other = driven, other

    def __getattr__(self, name: str) -> Any:
        of_the_other = ("vehicle", "speed", "linear_model", "stability")
        return getattr(self._other if name in of_the_other else self.driven, name)


def designed_for(plant: Any, vehicle: Any = None, speed: float | None = None) -> Any:
    """The environment with another car or speed to design for; ValueError or TypeError for one that cannot be."""
    if hasattr(plant, "num_envs"):
        raise ValueError("vehicle and speed to design for need a single environment, got one of many cars")
    if getattr(plant, "spec", None) is None:
        raise ValueError("vehicle and speed to design for need an environment that gym.make has made")
    left = ("render_mode", "telemetry", "speed_ratio")
    given = {name: value for name, value in plant.spec.kwargs.items() if name not in left}
    given["vehicle"] = plant.vehicle if vehicle is None else vehicle
    given["speed"] = plant.speed if speed is None else speed
    return OtherCar(plant, type(plant)(**given))


def make(
    name: str,
    env: Any,
    *,
    parameters: Mapping[str, float] | str | Path | None = None,
    vehicle: Any = None,
    speed: float | None = None,
) -> Policy:
    """A controller by name, designed for an environment.

    Args:
        name: one of ``POLICIES``, or DRIVER+LAW: a driver at the front wheels and a law at the rear ones, for example
            "preview+sano"; "pretrained", the trained policy that comes with the package for the environment's id and
            level; "module:Class", a :class:`Policy` of one's own, which is made from the environment, or
            "module:function", which takes one car's observation and gives its action.
        env: the environment, wrapped or not.
        parameters: of a controller of ``TUNABLE``, by their names, or a file that ``agents.tune`` wrote; those that the
            class's ``parameters`` list. By default the controller's own.
        vehicle, speed: another car [as ``gym.make`` takes it] and speed [m/s] to design for than those that are driven:
            how robust is it?

    Raises:
        ValueError, TypeError: an unknown name (the message proposes the nearest); a controller that cannot drive this
            environment, for example a driver where only the rear wheels are steered; a parameter out of range.
        FileError, OSError: a file that cannot be read, or is of another controller.
    """
    plant: Plant = getattr(env, "unwrapped", env)
    if not hasattr(plant, "linear_model"):
        raise TypeError(f"env must be an environment of this package, got {env!r}")
    if vehicle is not None or speed is not None:
        plant = designed_for(plant, vehicle, speed)
    if isinstance(parameters, str | Path):
        return _from_file(parameters, plant, name)
    if parameters is not None:
        controller = tunable(name)
        return controller.of(plant, values_of(controller, plant, parameters))
    if name == PRETRAINED:
        return pretrained(plant)
    if isinstance(name, str) and name in REAR_LAWS:
        drivers = " or ".join(repr(f"{driver}+{name}") for driver in DRIVERS)
        raise ValueError(f"policy {name!r} steers the rear wheels only, and needs a driver at the front: {drivers}.")
    if isinstance(name, str) and ":" in name:
        own = _ones_own(name)
        return own(plant) if isinstance(own, type) else Function(name, own)
    choice("policy", name, NAMES)
    policy: Policy = POLICIES[name](plant) if name in POLICIES else driver_and_law(name, plant)
    return policy


def alone_among_many(policy: Policy) -> bool:
    """Whether each car of many is driven as if it were alone, to the bit: a controller of the package, or a network.

    Of a class of one's own nobody knows it. ``MPC`` gains nothing by many cars, and with sensors that are noisy the
    noise of a car depends on the others.
    """
    parts = parts_of(policy)
    known = {Network, *CLASSES, *REAR_LAWS.values()} - {MPC}
    noisy = any(isinstance(part, LQG) and part.sensor_noise is not None for part in parts)
    return all(type(part) in known for part in parts) and not noisy


def parts_of(policy: Any) -> tuple[Any, ...]:
    """Those that act together, or itself."""
    if type(policy) is DriverAndLaw:
        return policy.driver, policy.law
    return (policy.network, policy.base) if type(policy) is Residual else (policy,)


def load(folder: str | Path, env: Any = None) -> Network | Residual:
    """Read a trained policy from its folder; nothing in it is executed.

    Args:
        folder: with ``policy.json`` and ``policy.safetensors``.
        env: the environment that it will drive: it must fit; needed only where the network was trained on top of a
            controller, which is designed for it.

    Raises:
        FileNotFoundError: a file is missing.
        FileError: a ValueError of one line, which names the file: no folder (an archive of Stable-Baselines3, say), too
            large, damaged, of another format or version, its parts do not fit together, it needs `env`, or `env`
            shows or steers something else than it was trained with.
    """
    network = read(folder)
    if env is not None:
        with naming(folder):
            network.check_fit(getattr(env, "unwrapped", env))
    return on_base(network, env, folder)


def on_base(network: Network, env: Any, folder: str | Path) -> Network | Residual:
    """A network that was read from a folder, with the controller that it was trained on top of, if it was."""
    told = network.description.get(BASE)
    if told is None:
        return network
    with naming(folder):
        controller = TUNABLE[choice("controller as base", told["controller"], TUNABLE)]
        if env is None:
            words = f"was trained on top of {controller.name!r}, which is designed for an environment"
            raise ValueError(f"{words}: load(folder, env)")
        plant: Plant = getattr(env, "unwrapped", env)
        return Residual(network, controller.of(plant, values_of(controller, plant, told["parameters"])))


def from_file(path: str | Path, env: Any) -> Policy:
    """The controller in a file that ``agents.tune`` wrote, LQR's weights of older ones included; nothing is executed.

    Raises:
        FileError: a damaged file, an unknown controller, a parameter that is unknown, missing or out of range.
        ValueError, TypeError: a controller that cannot drive this environment.
        OSError: the file cannot be read.
    """
    return _from_file(path, getattr(env, "unwrapped", env))


def _from_file(path: str | Path, plant: Plant, name: str | None = None) -> Policy:
    content = read_json(path, table({}, {"controller": text(), "parameters": mapping(anything)}, others=True))
    found = content.get("controller", LQR.name if "weights" in content else None)
    with naming(path):
        if name not in (None, found):
            raise ValueError(f"controller must be {name!r}, got {found!r}")
        # A file alone imports nothing: a class of one's own must be named by who calls.
        controller = TUNABLE[choice("controller", found, TUNABLE)] if name is None else tunable(name)
        if "weights" not in content:
            values = values_of(controller, plant, mapping(anything)("parameters", content.get("parameters")))
    if "weights" in content:
        return LQR(plant, read_weights(path))
    return controller.of(plant, values)


def _ones_own(name: str) -> Any:
    """A class of policies, or a function, in a module of the user's."""
    module_name, _, own_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ValueError(f"policy {name!r}: the module {module_name!r} cannot be imported ({error})") from None
    found = {key: value for key, value in vars(module).items() if _drives(value, module_name)}
    return found[choice(f"policy: class or function in {module_name}", own_name, found)]


def _drives(value: Any, module_name: str) -> bool:
    if isinstance(value, type):
        return issubclass(value, Policy)
    return inspect.isfunction(value) and value.__module__ == module_name


def descriptions() -> dict[str, str]:
    """One line about every controller, the first of its docstring; a rear-steer law stands as "DRIVER+LAW"."""
    rows = {name: _summary(policy) for name, policy in POLICIES.items()}
    return rows | {f"DRIVER+{name}": _summary(law) for name, law in REAR_LAWS.items()}


def _summary(documented: Any) -> str:
    return (inspect.getdoc(documented) or "").partition("\n")[0].replace("``", "")
