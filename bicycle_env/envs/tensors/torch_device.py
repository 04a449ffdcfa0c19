"""From what a user gives to the torch environment, to torch's objects: the package, a device, a seed, numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from bicycle_env.installation import needs


def import_torch() -> Any:
    """The package; ImportError says how to install it."""
    try:
        import torch
    except ImportError as error:
        raise ImportError(needs("TorchVectorEnv", "torch", "agents"), name="torch") from error
    return torch


def shortened(seed: int) -> int:
    """A seed of any size in 64 bits, which is what torch takes; those below 2^63 as they are."""
    return seed if seed < 2**63 else int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


def device_and_generator(torch: Any, device: Any) -> tuple[Any, Any]:
    """A device and a generator on it, randomly seeded; ValueError where torch cannot use the device."""
    try:
        place = torch.empty(0, device=device).device  # "cuda" becomes "cuda:0"
        generator = torch.Generator(device=place)
    except (AssertionError, RuntimeError, TypeError) as error:
        raise ValueError(f"device must be one that torch can use here, got {device!r}: {error}") from error
    generator.seed()
    return place, generator


def as_numbers(torch: Any, name: str, value: Any) -> Any:
    """A keyword that is a tensor as an array; ValueError if it requires a gradient."""
    if not torch.is_tensor(value):
        return value
    if value.requires_grad:
        raise ValueError(
            f"{name} must not require a gradient, got {value!r}: the cars are made once, of plain numbers; give "
            f"{name}.detach(). Actions, and what reset(options=) takes, may require one"
        )
    return value.cpu().numpy()
