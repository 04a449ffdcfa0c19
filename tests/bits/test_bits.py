"""An environment's trajectory has the same bits on every processor, alone or among others, in blocks of any length.

The source says where a multiply-add is rounded once (`xp.multiply_add`), and the compiler may fuse nothing by itself.
So the hashes of hashes.json hold on this processor, on one without AVX-512, and on one without multiply-adds.
"""

import json
import os
import subprocess
import sys

import llvmlite.binding as llvm
import numpy as np
import pytest
import rollouts
from combinations import only_all
from rollouts import ROLLOUTS, name_of, record

FROZEN = json.loads(rollouts.FILE.read_text(encoding="utf-8"))
FEATURES = dict(llvm.get_host_cpu_features())
LATER = ("avx512", "avx10", "amx", "avxvnni", "avxifma", "avxneconvert", "vaes", "vpclmulqdq", "gfni")
"""Features that came with AVX-512 or after it."""

HASWELL = {
    "NUMBA_CPU_NAME": "haswell",  # the name alone changes nothing
    "NUMBA_CPU_FEATURES": ",".join(
        ("+" if on and not name.startswith(LATER) else "-") + name for name, on in FEATURES.items()
    ),
}
GENERIC = {"NUMBA_CPU_NAME": "generic"}
ALL_IDS = list(dict.fromkeys(rollout.id for rollout in ROLLOUTS))
on_x86_with_fma = pytest.mark.skipif(not FEATURES.get("fma") or not FEATURES.get("avx2"), reason="not this processor's")

PAIRWISE = range(8)
FORM_AMONG_OTHERS = dict(enumerate(("8", "64", "64", "8", "8", "64", "8", "64")))
"""Of the pairwise rollouts: the blocks of the combinations of tests/contracts, which are compiled there, too."""


def test_every_rollout_is_frozen():
    assert list(FROZEN) == [name_of(rollout) for rollout in ROLLOUTS]
    assert len(set(FROZEN.values())) == len(ROLLOUTS) == 29


def test_the_rollouts_hold_every_option():
    for column, values in {0: 5, 1: 4, 2: 2, 3: 2, 4: 2, 5: 2}.items():
        assert len({rollout[column] for rollout in ROLLOUTS}) == values


@pytest.mark.parametrize("number", FORM_AMONG_OTHERS)
def test_one_car_is_one_of_many_and_the_bits_are_the_frozen_ones(number):
    rollout = ROLLOUTS[number]
    alone, together = record(rollout, "single"), record(rollout, FORM_AMONG_OTHERS[number])
    different = np.argwhere(alone.rewards != together.rewards)
    assert len(different) == 0, f"first at step and car {different[0]}"
    assert alone.hash == together.hash == FROZEN[name_of(rollout)]
    assert "time-out" in alone.ends
    assert {"spun", "left_lane", "left_road"} & alone.ends


@pytest.mark.parametrize("number", [18])
def test_single_precision_has_the_frozen_bits(number):
    assert record(ROLLOUTS[number], "8").hash == FROZEN[name_of(ROLLOUTS[number])]


def on_processor(variables, numbers, forms):
    """For each rollout and form, driven in another process: whether its hash is the frozen one."""
    run = subprocess.run(
        [sys.executable, rollouts.__file__, "--only", *map(str, numbers), "--forms", *forms],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert len(found) == len(numbers)
    return {name: {form: value == FROZEN[name] for form, value in hashes.items()} for name, hashes in found.items()}


def all_of(answers):
    return all(same for forms in answers.values() for same in forms.values())


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", range(len(ROLLOUTS)), ids=map(name_of, ROLLOUTS))
def test_its_forms_have_the_frozen_bits(number):
    """All forms of the pairwise rollouts, two of each other one in turn: every form is a compilation."""
    rollout = ROLLOUTS[number]
    forms = rollout.forms if number in PAIRWISE else [(rollout.forms * 2)[number % 3 + k] for k in range(2)]
    found = {form: record(rollout, form).hash for form in forms}
    assert set(found.values()) == {FROZEN[name_of(rollout)]}, found


def by_id(numbers):
    """Rollouts of one environment each: what their laws share is compiled once in a process."""
    return [tuple(number for number in numbers if ROLLOUTS[number].id == env_id) for env_id in ALL_IDS]


@on_x86_with_fma
@pytest.mark.parametrize(
    ("numbers", "forms"),
    [((4,), ("8",)), *(only_all(numbers, ("single", "64")) for numbers in by_id(range(len(ROLLOUTS))))],
)
def test_the_bits_are_those_of_a_processor_without_avx512(numbers, forms):
    answers = on_processor(HASWELL, numbers, forms)
    assert all_of(answers), answers


@on_x86_with_fma
@pytest.mark.parametrize(
    ("numbers", "forms"),
    [((4,), ("single",)), *(only_all(numbers, ("single", "8")) for numbers in by_id((*PAIRWISE, 18)) if numbers)],
)
def test_the_bits_are_those_of_a_processor_without_multiply_adds(numbers, forms):
    answers = on_processor(GENERIC, numbers, forms)
    assert all_of(answers), answers
