"""What a user gives for many cars, one value for all or one per car: checked, as tensors (num_envs,)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bicycle_env.envs.many.rows import allowed_column
from bicycle_env.envs.tensors.tensor_kernels import Tensor
from bicycle_env.physics.validation import number
from bicycle_env.tasks.task import Allowed, checked_state


class TorchOptions:
    """Reads values; of one per car the least and the greatest are checked on the host, for all."""

    def __init__(
        self, torch: Any, num_envs: int, device: Any, dtype: Any, limits: tuple[float, float], own: tuple[str, ...]
    ) -> None:
        self._torch, self._num_envs, self._device, self._dtype = torch, num_envs, device, dtype
        front, rear = (max(limit, float(torch.tensor(limit, dtype=dtype))) for limit in limits)
        self._limits, self._own = (front, rear), own  # a float32 state may be the limit rounded up

    def state(self, given: Any, label: str) -> dict[str, Tensor]:
        """Values and errors of ``checked_state``, a tensor each."""
        columns: dict[str, Tensor] = {}
        if isinstance(given, Mapping):
            for name, value in given.items():
                column = self._column(f"{label}[{name!r}]", value)
                if column is not None:
                    columns[name] = column
        for end in ("min", "max"):
            ends = {name: float(getattr(column.detach(), end)()) for name, column in columns.items()}
            some = {**given, **ends} if columns else given
            values = checked_state(some, *self._limits, label, self._own)
        return {name: columns[name] if name in columns else self.filled(value) for name, value in values.items()}

    def numbers(self, name: str, value: Any, low: float, high: float = math.inf) -> Tensor:
        """Finite numbers in [low, high]."""
        column = self._column(name, value)
        if column is None:
            return self.filled(number(name, value, low, high))
        for end in (column.detach().min(), column.detach().max()):
            number(name, float(end), low, high)
        return column

    def allowed(self, name: str, value: Any, allowed: Allowed) -> Tensor:
        """Numbers in a range, or those that words stand for."""
        if isinstance(allowed, Mapping):
            return self.filled(allowed_column(name, value, allowed, self._num_envs))
        return self.numbers(name, value, *allowed)

    def mask(self, value: Any) -> Tensor:
        """Booleans, one per car."""
        column = self._tensor(value) if isinstance(value, (np.ndarray, self._torch.Tensor)) else None
        if column is None or column.dtype != self._torch.bool:
            raise TypeError(f"options['reset_mask'] must be a tensor or array of bool, got {value!r}")
        if column.shape != (self._num_envs,):
            raise ValueError(f"options['reset_mask'] must have shape ({self._num_envs},), got {value!r}")
        return column.clone()  # gradients remember it

    def filled(self, value: Any) -> Tensor:
        """One value, num_envs times; a tensor (num_envs,) as it is."""
        return self._torch.as_tensor(value, dtype=self._dtype, device=self._device).expand(self._num_envs)

    def _column(self, name: str, value: Any) -> Tensor | None:
        """A tensor of one number per car, or None where one value is given for all."""
        if self._torch.is_tensor(value) and value.ndim == 0 and value.requires_grad:
            value = value.expand(self._num_envs)  # the gradient is kept
        if not isinstance(value, (list, tuple)) and getattr(value, "ndim", 0) == 0:
            return None
        wanted = f"{name} must be one number or num_envs = {self._num_envs} of them"
        column = self._tensor(value)
        if column is None or column.dtype == self._torch.bool or column.is_complex():
            raise TypeError(f"{wanted}, got {value!r}")
        if column.shape != (self._num_envs,):
            raise ValueError(f"{wanted}, got shape {tuple(column.shape)}")
        return column.to(self._dtype)

    def _tensor(self, value: Any) -> Tensor | None:
        try:
            array = value if self._torch.is_tensor(value) else np.array(value)  # torch makes float32 of a list
            return self._torch.as_tensor(array, device=self._device)
        except (TypeError, ValueError):
            return None
