"""The plant as a Functional Mock-up Unit: FMI 2.0 for co-simulation, with its C sources and a binary for Linux."""

from __future__ import annotations

import io
import platform
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from bicycle_env.export import c_source
from bicycle_env.export.fmu_source import FMI2
from bicycle_env.export.plant import Plant, library
from bicycle_env.export.routines import UNITS, Library

BASE_UNITS = {
    "m": "m='1'",
    "rad": "rad='1'",
    "s": "s='1'",
    "kg": "kg='1'",
    "m/s": "m='1' s='-1'",
    "m/s^2": "m='1' s='-2'",
    "rad/s": "rad='1' s='-1'",
    "rad/s^2": "rad='1' s='-2'",
    "kg m^2": "kg='1' m='2'",
    "N": "kg='1' m='1' s='-2'",
    "N/rad": "kg='1' m='1' s='-2' rad='-1'",
    "N m": "kg='1' m='2' s='-2'",
}
"""Of `UNITS`, in those of the SI."""
PUSHES = ("side_force", "yaw_moment")
STAMP = (1980, 1, 1, 0, 0, 0)
"""Of the files in the archive: the same plant gives the same bytes."""


class Variable(NamedTuple):
    """One that a tool sees; its place among them is its value reference."""

    name: str
    place: str
    """In the C source's component."""
    attributes: str
    start: float | None


def files(plant: Plant, fma: bool) -> dict[str, bytes]:
    """By name; OSError where the compiler fails."""
    made = library(plant)
    sources = {name: text for name, text in c_source.files(made, fma).items() if not name.endswith("_test.c")}
    variables = _variables(made)
    places = ",\n    ".join(f"offsetof(component, {variable.place})" for variable in variables)
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, "".join([*sources.values(), places, str(plant)])))
    sources[f"{made.name}_fmi2.c"] = FMI2.replace("NAME", made.name).replace("PLACES", places).replace("GUID", guid)
    compiled = [name for name in sources if name.endswith(".c")]
    content = {
        "modelDescription.xml": _description(plant, made, variables, compiled, guid).encode(),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
    }
    if can_compile():
        content[f"binaries/linux64/{made.name}.so"] = _compiled(sources, compiled)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for name, part in content.items():
            file.writestr(zipfile.ZipInfo(name, STAMP), part, zipfile.ZIP_DEFLATED)
    return {f"{made.name}.fmu": archive.getvalue()}


def can_compile() -> bool:
    """Whether a binary can be made here: for linux64, by gcc."""
    return (platform.system(), platform.machine()) == ("Linux", "x86_64") and shutil.which("gcc") is not None


def _compiled(sources: dict[str, str], names: Sequence[str]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        command = ["gcc", *c_source.FLAGS.split(), "-shared", "-fPIC", "-s", *names, "-o", "plant.so", "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise OSError(f"gcc could not compile the FMU: {done.stderr.strip().splitlines()[0]}")
        return (Path(folder) / "plant.so").read_bytes()


def _variables(made: Library) -> list[Variable]:
    """Inputs, the state, what the axles do, and those numbers of the car that do anything."""
    used = {
        step.value[1]
        for routine in made.routines
        if not routine.c_body
        for step in routine.program().steps
        if step.operation == "input" and step.value[0] == "car"
    }
    records, car = made.records, made.constants["exported_car"]
    found = [Variable(name, f"command.{name}", "causality='input'", 0.0) for name in records["command"]._fields]
    found += [Variable(name, f"car.{name}", "causality='input'", 0.0) for name in PUSHES if name in used]
    found += [
        Variable(name, f"state.{name}", "causality='output' initial='exact'", 0.0) for name in records["state"]._fields
    ]
    found += [
        Variable(name, f"acting.{name}", "causality='output' initial='calculated'", None)
        for name in records["axle_forces"]._fields
    ]
    found += [
        Variable(name, f"car.{name}", "causality='parameter' variability='tunable'", getattr(car, name))
        for name in car._fields
        if name in used and name not in PUSHES
    ]
    return found


def _description(plant: Plant, made: Library, variables: Sequence[Variable], compiled: Sequence[str], guid: str) -> str:
    units = "".join(
        f"    <Unit name={quoteattr(unit)}><BaseUnit {base}/></Unit>\n" for unit, base in BASE_UNITS.items()
    )
    rows = "".join(
        f"    <ScalarVariable name='{variable.name}' valueReference='{k}' {variable.attributes}>"
        f"<Real unit={quoteattr(UNITS[variable.name])}{_start(variable)}/></ScalarVariable>\n"
        for k, variable in enumerate(variables)
    )
    outputs = [k + 1 for k, variable in enumerate(variables) if "causality='output'" in variable.attributes]
    unknown = [k + 1 for k, variable in enumerate(variables) if "initial='calculated'" in variable.attributes]
    listed = "".join(f"<File name='{name}'/>" for name in compiled)
    return f"""\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion='2.0' modelName='{made.name}' guid='{guid}'
    description={quoteattr(str(plant))} generationTool='bicycle-env export' variableNamingConvention='flat'>
  <CoSimulation modelIdentifier='{made.name}' canHandleVariableCommunicationStepSize='true'
      canGetAndSetFMUstate='true' canSerializeFMUstate='true' canNotUseMemoryManagementFunctions='true'>
    <SourceFiles>{listed}</SourceFiles>
  </CoSimulation>
  <UnitDefinitions>
{units}  </UnitDefinitions>
  <DefaultExperiment startTime='0' stopTime='5' stepSize='0.02'/>
  <ModelVariables>
{rows}  </ModelVariables>
  <ModelStructure>
    <Outputs>{"".join(f"<Unknown index='{k}'/>" for k in outputs)}</Outputs>
    <InitialUnknowns>{"".join(f"<Unknown index='{k}'/>" for k in unknown)}</InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def _start(variable: Variable) -> str:
    """XML has no infinite number that every tool reads: the largest one limits nothing either."""
    return "" if variable.start is None else f" start='{min(variable.start, 1e300)!r}'"
