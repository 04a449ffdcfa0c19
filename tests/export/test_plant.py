"""The exported plant: C and JavaScript give what the laws give in plain Python, to the bit, and with --fma the env."""

import itertools
import re

import gymnasium as gym
import numpy as np
import pytest
from building import FLAGS, build, c_test, js_test, needs_gcc, needs_node, run
from combinations import only_all

from bicycle_env import export, tires
from bicycle_env.export.plant import library, routines
from bicycle_env.export.routines import UNITS
from bicycle_env.physics.car import CarParameters
from bicycle_env.physics.lateral import GEOMETRIES, Axles
from bicycle_env.physics.relaxed_single_track import RelaxedSingleTrack
from bicycle_env.physics.single_track import SingleTrack

NAME = "bicycle_plant"
PLANTS = {
    **{name: {"tire": name} for name in tires.LAWS},
    "small": {"tire": "fiala", "geometry": "small_angle"},
    "all": {
        "vehicle": "civic",
        "tire": {"name": "magic_formula", "shape": 2.2, "curvature": 1.0},
        "speed": 25.0,
        "friction": 0.4,
        "relaxation_length": 0.5,
        "front_actuator": {"angle_limit": 0.5, "rate_limit": float("inf"), "time_constant": 0.1},
        "pushed": True,
    },
}
C_AT_ONCE = (("tanh", False), ("small", False), ("all", True))
"""Also in C below: linear with the header's own command, fiala as the environment; magic_formula is in "all"."""


@needs_gcc
@pytest.mark.parametrize(
    ("name", "fma"),
    [
        (name, fma) if (name, fma) in C_AT_ONCE else only_all(name, fma)
        for name, fma in itertools.product(PLANTS, (False, True))
    ],
)
def test_c_gives_the_laws_bits(name, fma, tmp_path):
    export.export_plant(export.plant(**PLANTS[name]), "c", tmp_path, fma=fma)
    count = 24 * (5 if name == "all" else 4)
    assert c_test(tmp_path, NAME) == (0, f"0 of {count} test vectors of {NAME} differ\n")


@needs_node
@pytest.mark.parametrize("name", PLANTS)
def test_javascript_gives_the_laws_bits(name, tmp_path):
    export.export_plant(export.plant(**PLANTS[name]), "js", tmp_path)
    count = 24 * (5 if name == "all" else 4)
    assert js_test(tmp_path, NAME) == (0, f"0 of {count} test vectors of {NAME} differ\n")


def test_the_vectors_tell_one_rounding_from_two():
    made = library(export.plant(tire="linear"))
    twice, once = made.vectors(fma=False), made.vectors(fma=True)
    different = [name for name in twice if twice[name] != once[name]]
    assert {"control_step", "axles"} <= set(different)
    (_, after), (_, other) = twice["control_step"][3], once["control_step"][3]
    assert after == pytest.approx(other, rel=1e-9)


LOOP = """
#include "bicycle_plant.h"
#include <stdio.h>
int main(void)
{
    bicycle_plant_state state = {0};
    bicycle_plant_command command;
    while (scanf("%la %la %la %la %la %la %la %la %la", &state.longitudinal_position, &state.lateral_position,
                 &state.heading, &state.lateral_velocity, &state.yaw_rate, &state.front_steer, &state.rear_steer,
                 &command.front_steer_command, &command.rear_steer_command) == 9) {
        bicycle_plant_control_step(&state, &state, &command, &bicycle_plant_exported_car, 0.004, 5);
        printf("%a %a %a %a %a %a %a\\n", state.longitudinal_position, state.lateral_position, state.heading,
               state.lateral_velocity, state.yaw_rate, state.front_steer, state.rear_steer);
    }
    return 0;
}
"""


@needs_gcc
def test_fused_c_is_the_environment(tmp_path):
    """BicycleStab-v0 steered at random until it spins: its own bits."""
    env = gym.make("BicycleStab-v0").unwrapped
    env.reset(options={"state": {"yaw_rate": 0.1}})
    states, commands, over = [env.state[:7]], [], False
    draws = np.random.default_rng(3)
    while not over:
        _, _, over, _, _ = env.step(draws.uniform(-1.0, 1.0, 2).astype(np.float32))
        states.append(env.state[:7])
        commands.append((env.state.front_steer_command, env.state.rear_steer_command))
    assert env.substeps == 5
    assert env.control_timestep / env.substeps == 0.004
    assert len(states) > 40
    export.export_plant(export.plant(), "c", tmp_path, fma=True)
    (tmp_path / "loop.c").write_text(LOOP)
    build(tmp_path, "bicycle_plant.c", "loop.c")
    rows = [
        " ".join(float(x).hex() for x in (*state, *command))
        for state, command in zip(states[:-1], commands, strict=True)
    ]
    (tmp_path / "in").write_text("\n".join(rows))
    code, said = run("sh", "-c", "./program < in", folder=tmp_path)
    assert code == 0
    found = [tuple(map(float.fromhex, line.split())) for line in said.splitlines()]
    assert found == states[1:]


@needs_gcc
def test_the_header_says_how_to_check_it(tmp_path):
    export.export_plant(export.plant(tire="linear"), "c", tmp_path)
    (command,) = re.findall(r"Check it: (.*)", (tmp_path / f"{NAME}.h").read_text())
    assert set(FLAGS) <= set(command.split())
    assert run("sh", "-c", command, folder=tmp_path) == (0, f"0 of 96 test vectors of {NAME} differ\n")


@needs_gcc
def test_a_wrong_number_is_seen(tmp_path):
    export.export_plant(export.plant(tire="linear"), "c", tmp_path)
    source = (tmp_path / f"{NAME}.c").read_text()
    assert "0.5 * timestep" in source
    (tmp_path / f"{NAME}.c").write_text(source.replace("0.5 * timestep", "0.5000000000000001 * timestep"))
    code, said = c_test(tmp_path, NAME)
    assert code == 1
    assert "control_step, vector" in said


@needs_node
def test_a_wrong_number_is_seen_in_javascript(tmp_path):
    export.export_plant(export.plant(tire="linear"), "js", tmp_path)
    source = (tmp_path / f"{NAME}.mjs").read_text()
    (tmp_path / f"{NAME}.mjs").write_text(source.replace("0.5 * timestep", "0.5000000000000001 * timestep"))
    code, said = js_test(tmp_path, NAME)
    assert code == 1
    assert "control_step, vector" in said


@needs_gcc
def test_careless_flags_are_refused(tmp_path):
    export.export_plant(export.plant(tire="linear"), "c", tmp_path)
    code, said = run("gcc", "-std=c99", "-ffast-math", "-c", f"{NAME}.c", folder=tmp_path)
    assert code != 0
    assert "without -ffast-math" in said


def test_a_substep_is_a_function_of_few_operations():
    """Nothing is unrolled beyond RK4's four stages, and what they share is done once."""
    counts = {}
    for name in tires.LAWS:
        _, substep, step, *_ = routines(SingleTrack.of(name), False)
        counts[name] = substep.program().operations
        assert step.c_body
        assert step.js_body
    assert counts == {"linear": 177, "tanh": 959, "fiala": 1017, "magic_formula": 1433}


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_every_field_has_its_unit(geometry):
    for record in (CarParameters, Axles, RelaxedSingleTrack.State):
        assert set(record._fields) <= set(UNITS)


def test_no_call_of_the_mathematics_library_that_rounds(tmp_path):
    export.export_plant(export.plant(tire="tanh"), "c", tmp_path, fma=True)
    source = (tmp_path / f"{NAME}.c").read_text()
    assert not [name for name in ("sin(", "cos(", "tan(", "tanh(", "exp(", "pow(") if name in source]
    assert "fma(" in source
