"""The environments' kernels without the compiler: the same source as plain Python, where neither bits nor speed matter.

What is made of one, its laws included, is what numba compiles: a mistake in it is the same mistake here.
"""

import ctypes

from bicycle_env.backends import compiled
from bicycle_env.envs.many import block_kernels, blocks, car_functions
from bicycle_env.envs.many.blocks import Kind
from bicycle_env.envs.single import single_track_env
from bicycle_env.physics.elementary import PYTHON


class Interpreted(Kind):
    """Equal to no kind that is compiled: what is kept by kind is kept apart."""

    __slots__ = ()
    xp = PYTHON

    def __eq__(self, other):
        return type(other) is Interpreted and tuple.__eq__(self, other)

    def __hash__(self):
        return hash((Interpreted, *self))


def next_double(address):
    """As backends/compiled_random.py has it, of a ``bitgen_t``."""
    members = (ctypes.c_void_p * 4).from_address(int(address))
    return ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(members[3])(members[0])


def first_bit(bits):
    """The place of the lowest bit that is set."""
    whole = int(bits)
    return (whole & -whole).bit_length() - 1


def entry_point(function, _signature, **_):
    """Numbers of one car are looked up as floats, with which Python is several times as fast as with numpy's."""

    def call(numbers, *rest):
        return function(numbers if blocks_of_cars else memoryview(numbers), *rest)

    blocks_of_cars = function.__module__ == block_kernels.__name__ and function.__name__ == "step"
    return call


def interpret(monkeypatch):
    """Environments that are made from now on are not compiled."""
    for module in (single_track_env, blocks):
        monkeypatch.setattr(module, "Kind", Interpreted)
    monkeypatch.setattr(compiled, "entry_point", entry_point)
    monkeypatch.setattr(car_functions, "next_double", next_double)
    monkeypatch.setattr(block_kernels, "fetch", lambda address: None)
    monkeypatch.setattr(block_kernels, "first_bit", first_bit)
