"""Build the C kernel of single_track.c, one library per tire, number type and block length."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from bicycle_env.envs.many import blocks
from bicycle_env.envs.registered_fleet import registered_fleet
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.tasks.episode import Rules
from bicycle_env.tasks.stabilise import Stabilise
from bicycle_env.tasks.task import Task

SOURCE = Path(__file__).parent / "single_track.c"
STRICT = ("-O3", "-march=native", "-ffp-contract=off")
FAST = ("-O3", "-march=native", "-ffast-math")


def flags(tire: str) -> tuple[str, ...]:
    """The linear tire in strict arithmetic; the others with -ffast-math, which lets gcc call libmvec."""
    return STRICT if tire == "linear" else FAST


def build_line(tire: str, dtype: str, rows: int, target: str) -> list[str]:
    """The command."""
    real = {"float64": "double", "float32": "float"}[dtype]
    names = [f"-DTIRE_{tire.upper()}", f"-DREAL={real}", f"-DROWS={rows}", *(["-DSINGLE"] if real == "float" else [])]
    names += [f"-D{name}={value!r}" for name, value in constants(Stabilise()).items()]
    places = ["-I", str(Path(target).parent), str(SOURCE), "-o", target]
    return ["gcc", *flags(tire), "-shared", "-fPIC", *names, *places, "-lmvec", "-lm"]


def constants(task: Task) -> dict[str, float]:
    """What the laws of a task hold as constants, by their names in C."""
    laws = {"": task.rewards["default"], "_LIMIT": task.limits, "_TOLERANCE": task.tolerances}
    found = {f"{name}{kind}".upper(): value for kind, law in laws.items() for name, value in vars(law).items()}
    return {**found, "ROAD_HALF_WIDTH": task.road_half_width}


def layout_header(rows: int) -> str:
    """layout.h: where each number stands in a block and among those that all rows share."""
    fleet = registered_fleet(gym.spec("BicycleStab-v0"), rows, {})
    entries = len(fleet.observation_scale)
    kind = blocks.Kind(fleet.configuration.task, fleet.configuration.model, entries, rows, False, "float64")
    columns, shared = blocks.layout(kind), blocks.shared_layout(kind)
    names = [f"COLUMN_{name} = {k}" for k, name in enumerate((*CarState._fields, *blocks.KEPT, "end"), columns.state)]
    names += [f"NUMBER_{name} = {k}" for k, name in enumerate(CarParameters._fields, shared.car)]
    names += [f"NUMBER_{name} = {k}" for k, name in enumerate(Rules._fields, shared.rules)]
    names += [f"NUMBER_STEP_LIMIT = {shared.step_limit}", f"NUMBER_STEPS_TO_SETTLE = {shared.steps_to_settle}"]
    names += [f"NUMBER_PER_SCALE = {shared.scale}"]
    names += [f"NUMBER_BOUND = {shared.bound}", f"COLUMNS = {columns.width}", f"NUMBERS = {shared.whole}"]
    return f"enum {{ {', '.join([*names, f'ENTRIES = {entries}']).upper()} }};\n"


def kernel(tire: str, dtype: str = "float64", rows: int = 64) -> Callable[..., int]:
    """``step(numbers, actions, generators, observation, values, flags, end, restarts, first, last)`` in C."""
    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "single_track.so")
        (Path(folder) / "layout.h").write_text(layout_header(rows), encoding="utf-8")
        subprocess.run(build_line(tire, dtype, rows, target), check=True)
        step = ctypes.CDLL(target).step
    step.restype = ctypes.c_long
    step.argtypes = [ctypes.c_void_p] * 7 + [ctypes.c_long] * 5

    def call(*arguments: Any) -> int:
        arrays: tuple[np.ndarray, ...] = arguments[:7]
        cars, axles = arrays[1].shape
        return int(step(*(array.ctypes.data for array in arrays), cars, axles, *arguments[7:]))

    return call
