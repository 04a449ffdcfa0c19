"""torch, as the tensor kernels take it, and from what a user gives to torch's objects: a device, a seed, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any

import numpy as np

from bicycle_env.envs.tensors.tensor_kernels import Library, Tensor
from bicycle_env.installation import needs

INDUCTOR = {"realize_opcount_threshold": 4, "max_fusion_size": 100_000}
"""Options of torch.compile for long chains of elementwise operations. By default it copies an intermediate of up to 30
operations to each of its uses, and these chains grow: the Fiala tire's substep takes over ten minutes to compile. So
short ones are shared, and what shares them still becomes one loop: half a minute."""


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


def torch_library(torch: Any, num_envs: int, device: Any, dtype: Any, compiled: bool) -> Library:
    """torch for the tensor kernels."""

    def tensor(value: Any) -> Tensor:
        return torch.tensor(value, dtype=dtype, device=device)

    def compile_law(law: Any) -> Any:
        return _compiled(torch, law) if compiled else law

    def cast(value: Tensor, kind: Any) -> Tensor:
        return value.to(kind)

    def columns(value: Tensor, axis: int) -> Sequence[Tensor]:
        found: Sequence[Tensor] = value.unbind(axis)
        return found

    return Library(torch, dtype, tensor, cast, columns, (num_envs,), _repeated, compile_law)


def _repeated(count: int, body: Callable[[Any], Any], carry: Any) -> Any:
    for _ in range(count):
        carry = body(carry)
    return carry


def _compiled(torch: Any, law: Any) -> Any:
    # torch keeps a few compiled versions per code object and then refuses: each environment has a code object.
    own = FunctionType(law.__code__.replace(), law.__globals__, law.__name__, law.__defaults__, law.__closure__)
    return torch.compile(own, fullgraph=True, dynamic=False, options=INDUCTOR)
