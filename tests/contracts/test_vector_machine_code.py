"""The compiled step takes several cars at a time: no loop over the cars falls back to one by one.

What speed this brings is measured by benchmarks/vector_env.py. Here the compiler's last intermediate code is read: of
the arithmetic that stands in a loop, none may be scalar but a few multiplications (scaling actions and observations)
and what the compiled `start` and `look` have, too: cars start anew one by one.
"""

import re
from collections import Counter

import gymnasium as gym
import llvmlite.binding as llvm
import numba
import pytest
from combinations import only_all
from vector_cases import COMBINATIONS, make_many

pytestmark = pytest.mark.skipif(
    not llvm.get_host_cpu_features().get("avx2") or numba.config.CPU_NAME == "generic",
    reason="how other processors vectorise is not known here",
)
FUSED = "llvm.fma"
ARITHMETIC = ("fadd", "fsub", "fmul", "fdiv", FUSED)
FLAGS = r"(?:(?:fast|nnan|ninf|nsz|arcp|contract|afn|reassoc) )*"
NUMBERS = r"(<\d+ x \w+>|\w+)"
BLOCK = re.compile(r'("[^"]+"|[\w.$-]+):')
WAY = re.compile(r'label %("[^"]+"|[\w.$-]+)')
OPERATION = re.compile(
    rf"= (?:(fadd|fsub|fmul|fdiv) {FLAGS}{NUMBERS} |(?:tail )?call {FLAGS}{NUMBERS} @{re.escape(FUSED)}\.)"
)


def optimised(compiled):
    """The module of a compiled function; also one that came from the cache on disk."""
    (overload,) = compiled.overloads.values()
    return llvm.parse_bitcode(overload.library._get_module_for_linking().as_bitcode())


def in_loops(module):
    """Arithmetic in blocks of code that can run again: Counter of (instruction, type)."""
    found = Counter()
    for function in module.functions:
        name, after, arithmetic = "", {"": set()}, {"": []}  # the first block may have no name
        for line in str(function).splitlines():  # printed as a whole: one by one takes the square of their number
            if begins := BLOCK.match(line):
                name = begins[1]
                after[name], arithmetic[name] = set(), []
            after[name].update(WAY.findall(line))
            if done := OPERATION.search(line):
                arithmetic[name].append((done[1] or FUSED, done[2] or done[3]))
        for name, operations in arithmetic.items():
            if operations and name in reached_from(after, name):
                found.update(operations)
    return found


def reached_from(after, name):
    """The blocks that may run after one."""
    reached, waiting = set(), [*after[name]]
    while waiting:
        block = waiting.pop()
        if block not in reached:
            reached.add(block)
            waiting += after[block]
    return reached


def in_loops_of_starts(kernels):
    return in_loops(optimised(kernels.start)) + in_loops(optimised(kernels.look))


def split(found, number):
    """How many instructions of a type of number: (scalar other than multiplications, scalar, packed)."""
    scalar = {opcode: found[opcode, number] for opcode in ARITHMETIC}
    packed = sum(count for (_, kind), count in found.items() if re.fullmatch(rf"<\d+ x {number}>", kind))
    return sum(scalar.values()) - scalar["fmul"], sum(scalar.values()), packed


@pytest.mark.parametrize("combination", [COMBINATIONS[k] for k in (0, 2, 4, 5)], ids=lambda c: "-".join(map(str, c)))
def test_all_loops_take_several_cars_at_a_time(combination):
    kernels = make_many(combination)._kernels
    found = in_loops(optimised(kernels.step))
    other, scalar, packed = split(found, "double")
    other_of_starts, scalar_of_starts, _ = split(in_loops_of_starts(kernels), "double")
    assert packed > 200
    assert other <= other_of_starts, found
    assert scalar - scalar_of_starts < packed / 4, found


@pytest.mark.parametrize(
    "combination", [COMBINATIONS[4], only_all(COMBINATIONS[5])], ids=lambda c: "-".join(map(str, c))
)
def test_single_precision_computes_in_single_precision(combination):
    kernels = make_many(combination, dtype="float32")._kernels
    found = in_loops(optimised(kernels.step))
    _, drawn, packed = split(in_loops_of_starts(kernels), "double")
    assert split(found, "double")[1] <= drawn  # the uniform numbers of a start
    assert split(found, "double")[2] == packed == 0, found
    _, scalar, packed = split(found, "float")
    assert packed > 200
    assert scalar < packed / 4, found


def test_multiply_adds_are_seen_scalar_and_packed():
    scalar = in_loops(optimised(gym.make("BicycleStab-v0").unwrapped._kernels.step))
    packed = in_loops(optimised(make_many(COMBINATIONS[0])._kernels.step))
    assert scalar[FUSED, "double"] > 30
    assert sum(count for (name, kind), count in packed.items() if name == FUSED and kind.startswith("<")) > 50


def test_the_single_environment_is_seen_as_scalar():
    """What this page looks for is there where it must be."""
    other, _, packed = split(in_loops(optimised(gym.make("BicycleStab-v0").unwrapped._kernels.step)), "double")
    assert other > 50
    assert packed < other
