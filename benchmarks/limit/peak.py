"""The limit of a core for this step: its multiply-adds, its memory, and how many operations a step is."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np

import bicycle_env  # noqa: F401  (registers the environments)
from bicycle_env.physics.car import CarParameters, CarState
from bicycle_env.physics.elementary import namespace
from bicycle_env.tasks.control_step import transition
from bicycle_env.tasks.episode import EpisodeState, Rules, World

SOURCE = Path(__file__).parent / "peak.c"


class Peak(NamedTuple):
    """Of one core."""

    multiply_adds: float
    """Of doubles, per second."""
    bytes_per_second: float
    """Read and written, from memory that no cache holds."""


def measure(rounds: int = 5) -> Peak:
    """The best of some rounds. Needs gcc and a processor with AVX2."""
    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "peak.so")
        subprocess.run(
            ["gcc", "-O3", "-march=native", "-funroll-loops", "-shared", "-fPIC", str(SOURCE), "-o", target], check=True
        )
        library = ctypes.CDLL(target)
    library.multiply_adds.restype = ctypes.c_double
    library.multiply_adds.argtypes = [ctypes.c_long]
    library.scale.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
    values = np.ones(2**25)
    best = [0.0, 0.0]
    for _ in range(rounds):
        start = time.perf_counter()
        library.multiply_adds(5_000_000)
        best[0] = max(best[0], 48 * 5_000_000 / (time.perf_counter() - start))
        start = time.perf_counter()
        library.scale(values.ctypes.data, len(values))
        best[1] = max(best[1], 2 * values.nbytes / (time.perf_counter() - start))
    return Peak(*best)


class Counted:
    """A number that counts what is done with it."""

    done: ClassVar[Counter[str]] = Counter()

    def __init__(self, value: float) -> None:
        self.value = float(value)

    def _counted(self, name: str, result: float) -> Counted:
        Counted.done[name] += 1
        return Counted(result)

    def __add__(self, other: Any) -> Counted:
        return self._counted("add", self.value + float(other))

    __radd__ = __add__

    def __sub__(self, other: Any) -> Counted:
        return self._counted("add", self.value - float(other))

    def __rsub__(self, other: Any) -> Counted:
        return self._counted("add", float(other) - self.value)

    def __mul__(self, other: Any) -> Counted:
        return self._counted("multiply", self.value * float(other))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Counted:
        return self._counted("divide", self.value / float(other))

    def __rtruediv__(self, other: Any) -> Counted:
        return self._counted("divide", float(other) / self.value)

    def __neg__(self) -> Counted:
        return Counted(-self.value)

    def __abs__(self) -> Counted:
        return Counted(abs(self.value))

    def __float__(self) -> float:
        return self.value

    def __lt__(self, other: Any) -> bool:
        return self.value < float(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > float(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= float(other)

    def __eq__(self, other: object) -> bool:
        return self.value == float(other)  # type: ignore[arg-type]

    __hash__ = None  # type: ignore[assignment]


def operations(tire: str) -> dict[str, int]:
    """Additions, multiplications and divisions of one control step of BicycleStab-v0.

    Numbers that are the same for all cars are plain floats: what is done with them alone is done once, not per car.
    """
    xp: Any = namespace("counted", lambda condition, then, otherwise: then if condition else otherwise, _floor)
    env: Any = gym.make("BicycleStab-v0", tire=tire).unwrapped
    made = env.configuration
    step = transition(xp, made.task, made.model, made.reward)
    world = World(CarParameters(*map(float, made.car)), Rules(*map(float, made.rules)), made.settings)
    state = CarState(*(Counted(value) for value in (0.0, 0.1, 0.05, 1.0, 0.2, 0.01, 0.01)))
    zero = [Counted(0.0) for _ in range(4)]
    Counted.done.clear()
    step(state, EpisodeState(*zero, made.task.TaskState()), (Counted(0.1), Counted(0.1)), world, made.substeps)
    return dict(Counted.done)


def _floor(x: Any) -> Counted:
    return Counted(np.floor(float(x)))


if __name__ == "__main__":
    peak = measure()
    print(f"{peak.multiply_adds / 1e9:.1f} thousand million multiply-adds/s, {peak.bytes_per_second / 1e9:.1f} GB/s")
    for name in ("linear", "tanh", "fiala", "magic_formula"):
        counted = operations(name)
        print(name, counted, f"{peak.multiply_adds * 2 / sum(counted.values()) / 1e6:.1f} million steps/s at most")
