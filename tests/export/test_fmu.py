"""The FMU: its description says what its binary does, and its binary is the plant. FMPy reads it where it is there."""

import ctypes
import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pytest
from building import needs_gcc

from bicycle_env import export
from bicycle_env.export.fmu import BASE_UNITS, can_compile
from bicycle_env.export.plant import Command, routines
from bicycle_env.export.routines import UNITS
from bicycle_env.physics.elementary import PYTHON

needs_binary = pytest.mark.skipif(not can_compile(), reason="no gcc for linux64 here")
STEPS, STEP = 30, 0.01
STARTS = {"lateral_velocity": 1.0, "yaw_rate": 0.2}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The plant, its archive's folder and the tree of its description."""
    folder = tmp_path_factory.mktemp("fmu")
    plant = export.plant(relaxation_length=0.4, pushed=True)
    export.export_plant(plant, "fmu", folder)
    with zipfile.ZipFile(folder / "bicycle_plant.fmu") as file:
        file.extractall(folder)
    return plant, folder, ElementTree.parse(folder / "modelDescription.xml").getroot()


def commands(time):
    return 0.05 * np.sin(5.0 * time), -0.02 * np.sin(4.0 * time)


def driven(plant):
    """(steps + 1, states) by the laws in plain Python: three RK4 steps in 0.01 s, none above 0.004."""
    step = {routine.name: routine for routine in routines(plant.model, plant.pushed)}["control_step"].law(PYTHON)
    car = plant.car._replace(side_force=500.0)
    state = plant.model.State(**{**dict.fromkeys(plant.model.State._fields, 0.0), **STARTS})
    path = [state]
    for k in range(STEPS):
        state = step(state, Command(*commands(k * STEP)), car, STEP / 3, 3)
        path.append(state)
    return np.array(path, dtype=float)


def test_every_unit_has_its_base():
    assert set(UNITS.values()) - {"1"} == set(BASE_UNITS)


def test_the_description_names_all_that_acts(made):
    plant, folder, root = made
    rows = {row.get("name"): row for row in root.find("ModelVariables")}
    assert rows["side_force"].get("causality") == "input"
    assert rows["mass"].find("Real").get("unit") == "kg"
    assert float(rows["mass"].find("Real").get("start")) == plant.vehicle.mass
    assert set(plant.model.State._fields) <= set(rows)
    assert "body_width" not in rows
    assert {file.get("name") for file in root.iter("File")} == {"bicycle_plant.c", "bicycle_plant_fmi2.c"}
    assert (folder / "sources" / "bicycle_plant_fmi2.c").exists()


@pytest.mark.exhaustive
def test_the_same_plant_gives_the_same_bytes(made, tmp_path):
    plant, folder, _ = made
    export.export_plant(plant, "fmu", tmp_path)
    assert (tmp_path / "bicycle_plant.fmu").read_bytes() == (folder / "bicycle_plant.fmu").read_bytes()
    with zipfile.ZipFile(tmp_path / "bicycle_plant.fmu") as file:
        assert {part.date_time[0] for part in file.infolist()} == {1980}


@needs_binary
def test_the_binary_is_the_plant(made):
    """To the bit, by the interface that tools use."""
    plant, folder, root = made
    binary = ctypes.CDLL(str(folder / "binaries" / "linux64" / "bicycle_plant.so"))
    binary.fmi2Instantiate.restype = ctypes.c_void_p
    reference = {row.get("name"): int(row.get("valueReference")) for row in root.find("ModelVariables")}
    assert binary.fmi2Instantiate(b"car", 1, b"another", None, None, 0, 0) is None
    car = ctypes.c_void_p(binary.fmi2Instantiate(b"car", 1, root.get("guid").encode(), None, None, 0, 0))

    def put(**values):
        numbers = (ctypes.c_double * len(values))(*values.values())
        names = (ctypes.c_uint * len(values))(*(reference[name] for name in values))
        assert binary.fmi2SetReal(car, names, len(values), numbers) == 0

    def state():
        fields = plant.model.State._fields
        numbers = (ctypes.c_double * len(fields))()
        names = (ctypes.c_uint * len(fields))(*(reference[name] for name in fields))
        assert binary.fmi2GetReal(car, names, len(fields), numbers) == 0
        return list(numbers)

    put(**STARTS, side_force=500.0)
    path = [state()]
    for k in range(STEPS):
        front, rear = commands(k * STEP)
        put(front_steer_command=front, rear_steer_command=rear)
        assert binary.fmi2DoStep(car, ctypes.c_double(k * STEP), ctypes.c_double(STEP), 1) == 0
        path.append(state())
    assert np.array_equal(path, driven(plant))
    assert binary.fmi2DoStep(car, ctypes.c_double(0.3), ctypes.c_double(-STEP), 1) == 3
    binary.fmi2FreeInstance(car)


@needs_binary
def test_fmpy_validates_and_simulates(made):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    from fmpy.validation import validate_fmu

    plant, folder, _ = made
    archive = str(folder / "bicycle_plant.fmu")
    assert validate_fmu(archive) == []
    time = np.arange(STEPS + 1) * STEP
    front, rear = commands(time)
    given = np.array(
        list(zip(time, front, rear, np.full(STEPS + 1, 500.0), strict=True)),
        dtype=[(name, float) for name in ("time", "front_steer_command", "rear_steer_command", "side_force")],
    )
    result = fmpy.simulate_fmu(
        archive,
        stop_time=STEPS * STEP,
        step_size=STEP,
        output_interval=STEP,
        start_values=STARTS,
        input=given,
        output=list(plant.model.State._fields),
    )
    found = np.array([result[name] for name in plant.model.State._fields]).T
    np.testing.assert_allclose(found, driven(plant), rtol=1e-9, atol=1e-9)


@needs_gcc
@pytest.mark.exhaustive
def test_with_fma_the_binary_is_another(tmp_path):
    export.export_plant(export.plant(), "fmu", tmp_path, fma=True)
    with zipfile.ZipFile(tmp_path / "bicycle_plant.fmu") as file:
        assert b"fma(" in file.read("sources/bicycle_plant.c")
