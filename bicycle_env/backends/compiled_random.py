"""Random numbers of many generators inside compiled code: the same bits as ``generator.random()``."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

_pointer_in = ctypes.pythonapi.PyCapsule_GetPointer
_pointer_in.restype = ctypes.c_void_p
_pointer_in.argtypes = (ctypes.py_object, ctypes.c_char_p)


def addresses(generators: Sequence[np.random.Generator]) -> NDArray[np.uint64]:
    """Where each generator's ``bitgen_t`` lies (numpy/random/bitgen.h); keep the generators alive while it is used."""
    return np.array(
        [_pointer_in(generator.bit_generator.capsule, b"BitGenerator") for generator in generators], dtype=np.uint64
    )


@intrinsic  # type: ignore[untyped-decorator]
def next_double(_typing: Any, _address: Any) -> Any:
    """The next uniform number in [0, 1) of the generator at an address.

    ``bitgen_t`` begins with five pointers: the state, next_uint64, next_uint32, next_double, next_raw.
    """

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        byte_pointer = ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.DoubleType(), [byte_pointer])
        members = builder.inttoptr(arguments[0], byte_pointer.as_pointer())
        state = builder.load(members)
        draw = builder.load(builder.gep(members, [context.get_constant(types.intp, 3)]))
        return builder.call(builder.bitcast(draw, function.as_pointer()), [state])

    return types.float64(types.uint64), generate


@intrinsic  # type: ignore[untyped-decorator]
def fetch(_typing: Any, _address: Any) -> Any:
    """Ask the memory for the generator at an address, which will draw soon. Changes nothing, whatever the address.

    numpy keeps a ``bitgen_t`` and the numbers of its state side by side, within two or three cache lines.
    """

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        byte_pointer, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte_pointer, number, number, number])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [byte_pointer], kind)
        first = builder.inttoptr(arguments[0], byte_pointer)
        how = [ir.Constant(number, value) for value in (1, 3, 1)]  # to write, to keep close, data
        for offset in (0, 64, 127):
            builder.call(prefetch, [builder.gep(first, [context.get_constant(types.intp, offset)]), *how])
        return context.get_dummy_value()

    return types.none(types.uint64), generate
