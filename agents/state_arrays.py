"""A training's state as plain arrays by name: networks, Adam, cars and generators, written and put back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents import generators
from bicycle_env.envs.many.vector_env import VectorSnapshot

State = dict[str, NDArray[Any]]
MOMENTS = ("step", "exp_avg", "exp_avg_sq", "max_exp_avg_sq")  # what Adam keeps for each parameter
ANY = -1
"""A length that is free."""


class Arrays:
    """Those of a file, each to be taken once; ValueError for one that is missing or not what was asked for."""

    def __init__(self, state: Mapping[str, NDArray[Any]]) -> None:
        self._left = dict(state)

    def __contains__(self, name: str) -> bool:
        return name in self._left

    def take(self, name: str, dtype: Any, *shape: int) -> NDArray[Any]:
        """The array of this name, type and shape; ``ANY`` is any length."""
        if name not in self._left:
            raise ValueError(f"{name!r} is missing")
        array = self._left.pop(name)
        fits = array.ndim == len(shape) and all(
            want in (ANY, have) for want, have in zip(shape, array.shape, strict=False)
        )
        if array.dtype != np.dtype(dtype) or not fits:
            raise ValueError(f"{name!r} must be {np.dtype(dtype)} of shape {shape}, is {array.dtype} of {array.shape}")
        return array

    def end(self) -> None:
        """ValueError if an array was not taken."""
        if self._left:
            raise ValueError(f"{', '.join(map(repr, list(self._left)[:3]))}: nothing has this name here")


def of_tensors(tensors: Mapping[str, torch.Tensor]) -> State:
    """Copies, by the same names."""
    return {name: tensor.detach().numpy().copy() for name, tensor in tensors.items()}


def put_tensors(tensors: Mapping[str, torch.Tensor], arrays: Arrays) -> None:
    """Into tensors of the same names, in place."""
    with torch.no_grad():
        for name, tensor in tensors.items():
            tensor.copy_(torch.from_numpy(arrays.take(name, tensor.detach().numpy().dtype, *tensor.shape)))


def of_adam(name: str, optimizer: torch.optim.Optimizer) -> State:
    """Learning rates and moments of each parameter."""
    state = {f"{name}.lr": np.array([group["lr"] for group in optimizer.param_groups], np.float64)}
    for index, parameter in enumerate(_parameters(optimizer)):
        for moment, value in optimizer.state.get(parameter, {}).items():
            state[f"{name}.{index}.{moment}"] = value.detach().numpy().copy()
    return state


def put_adam(name: str, optimizer: torch.optim.Optimizer, arrays: Arrays) -> None:
    """Into a fresh optimizer of equal parameters; ValueError for moments that cannot be."""
    rates = arrays.take(f"{name}.lr", np.float64, len(optimizer.param_groups)).tolist()
    for group, rate in zip(optimizer.param_groups, rates, strict=True):
        group["lr"] = rate
    for index, parameter in enumerate(_parameters(optimizer)):
        kept = [moment for moment in MOMENTS if f"{name}.{index}.{moment}" in arrays]
        if kept and not {"step", "exp_avg", "exp_avg_sq"} <= set(kept):
            raise ValueError(f"'{name}.{index}' must have all of Adam's moments, has {', '.join(kept)}")
        for moment in kept:
            shape = () if moment == "step" else tuple(parameter.shape)
            value = arrays.take(f"{name}.{index}.{moment}", np.float32, *shape)
            if moment != "exp_avg" and np.any(value < 0):
                raise ValueError(f"'{name}.{index}.{moment}' must not be negative")
            optimizer.state[parameter][moment] = torch.from_numpy(value.copy())


def of_cars(snapshot: VectorSnapshot) -> State:
    """All rows of a native vector environment, their generators included."""
    return {"env.rows": snapshot.rows, "env.generators": generators.rows(snapshot.generators)}


def put_cars(env: Any, dtype: str, cars: int, arrays: Arrays) -> NDArray[np.float32]:
    """Into an equal environment; gives what they observe there."""
    rows = arrays.take("env.rows", dtype, ANY, ANY, ANY)  # its shape is checked by restore
    states = generators.from_rows(arrays.take("env.generators", np.uint64, cars, 6))
    found: NDArray[np.float32] = env.restore(VectorSnapshot(rows, states))
    return found


def of_process() -> State:
    """Of the generators that the whole process shares."""
    return {f"process.{name}": array for name, array in generators.of_process().items()}


def put_process(arrays: Arrays) -> None:
    """Put back what `of_process` gave; ValueError for what no generator can be in."""
    now = generators.of_process()
    taken: Iterator[tuple[str, NDArray[Any]]] = (
        (name, arrays.take(f"process.{name}", array.dtype, *((ANY,) if name == "python_gauss" else array.shape)))
        for name, array in now.items()
    )
    generators.set_process(dict(taken))


def _parameters(optimizer: torch.optim.Optimizer) -> list[torch.Tensor]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]
