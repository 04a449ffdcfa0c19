"""The plant as a file that CasADi loads: a ``Function`` x' = f(x, u) for acados, do-mpc and CasADi's own tools."""

from __future__ import annotations

import tempfile
from pathlib import Path

from bicycle_env.control.design.symbolic import continuous
from bicycle_env.export.plant import Command, Plant
from bicycle_env.export.routines import UNITS

NAME = "bicycle_plant"


def files(plant: Plant) -> dict[str, str | bytes]:
    """By name: the function, and a script that loads it.

    Raises:
        ValueError: a plant that is pushed: the function has no such input.
        ModuleNotFoundError: CasADi is not installed.
    """
    if plant.pushed:
        raise ValueError("pushed must be False with the format casadi: x' = f(x, u) has no side force")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{NAME}.casadi"
        continuous(plant.model, plant.car).save(str(path))
        content = path.read_bytes()
    return {f"{NAME}.casadi": content, f"load_{NAME}.py": _loader(plant)}


def _loader(plant: Plant) -> str:
    names, car = plant.model.State._fields, plant.car
    state = "\n".join(f'    "{name}",  # {UNITS[name]}' for name in names)
    command = "\n".join(f'    "{name}",  # {UNITS[name]}' for name in Command._fields)
    return f'''\
"""{plant}.

Written by `bicycle-env export`. The actuators have their lags; their limits are for the optimiser to keep.
"""

from pathlib import Path

import casadi

STATE = (
{state}
)
COMMAND = (
{command}
)
ANGLE_LIMITS = ({car.front_angle_limit!r}, {car.rear_angle_limit!r})  # rad, of the commands
RATE_LIMITS = (float("{car.front_rate_limit!r}"), float("{car.rear_rate_limit!r}"))  # rad/s, of the steer angles

plant = casadi.Function.load(str(Path(__file__).with_name("{NAME}.casadi")))

if __name__ == "__main__":
    # acados:  model.x, model.u = casadi.SX.sym("x", len(STATE)), casadi.SX.sym("u", 2)
    #          model.f_expl_expr = plant(model.x, model.u)
    # do-mpc:  rates = plant(casadi.vertcat(*x), casadi.vertcat(*u)), then set_rhs for each name of STATE
    print(plant)
    at_rest = [0.0] * len(STATE)
    print(dict(zip(STATE, plant(at_rest, ANGLE_LIMITS).full().ravel().tolist())))
'''
