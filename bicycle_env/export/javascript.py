"""A library as a JavaScript module, and a script for node that checks the test vectors."""

from __future__ import annotations

import json

from bicycle_env.export.routines import UNITS, Argument, Library, Routine
from bicycle_env.export.source import Language, lines

JAVASCRIPT = Language(
    size="Math.abs({})",
    floor="Math.floor({})",
    root="Math.sqrt({})",
    multiply_add="({} * {} + {})",
    infinity="Infinity",
    declaration="const {name} = {value};",
    table="const {name} = [{values}];",
    lookup="{name}[{index}]",
)


def files(library: Library) -> dict[str, str]:
    """By name."""
    return {f"{library.name}.mjs": module(library), f"{library.name}_test.mjs": _test(library)}


def module(library: Library) -> str:
    """The functions alone."""
    words = [
        *library.words,
        "",
        "Written by `bicycle-env export`. SI units, angles in rad; x forward, y to the left, z up.",
        "Every number is that of the laws in plain Python, to the bit.",
        f"Check it: node {library.name}_test.mjs",
        "The first arguments are records that are written into; they may be those that are read.",
    ]
    parts = ["\n".join(f"// {line}".rstrip() for line in words)]
    for kind, record in library.records.items():
        fields = "".join(f"  {field}: 0,{_unit(field)}\n" for field in record._fields)
        parts.append(f"export const new_{kind} = () => ({{\n{fields}}});")
    for constant, value in library.constants.items():
        if constant in library.constant_types:
            rows = "".join(
                f"  {field}: {JAVASCRIPT.number(number)},{_unit(field)}\n"
                for field, number in zip(value._fields, value, strict=True)
            )
            parts.append(f"export const {constant} = {{\n{rows}}};")
        elif isinstance(value, tuple):
            parts.append(f"export const {constant} = {json.dumps(value)};")
        else:
            parts.append(f"export const {constant} = {JAVASCRIPT.number(value)};")
    parts += [_function(routine) for routine in library.routines]
    return "\n\n".join(parts) + "\n"


def _unit(field: str) -> str:
    return f" // {UNITS[field]}" if field in UNITS else ""


def _function(routine: Routine) -> str:
    given = [] if routine.given[0].record is None else [result.name for result in routine.given]
    names = ", ".join([*given, *(argument.name for argument in routine.taken)])
    head = f"// {routine.words}\nexport function {routine.name}({names}) {{"
    if routine.js_body:
        return "\n".join([head, *(f"  {line}" for line in routine.js_body.splitlines()), "}"])
    program = routine.program()
    used = {step.value for step in program.steps if step.operation == "input"}
    reads, inputs = [], {}
    for argument in routine.taken:
        for field in argument.fields:
            inputs[argument.name, field] = f"{argument.name}_{field}" if field else argument.name
            if field and (argument.name, field) in used:
                reads.append(f"const {argument.name}_{field} = {argument.name}.{field};")
    found = lines(program, JAVASCRIPT, inputs, routine.name)
    if not given:
        writes = [f"return {found.results[0]};"]
    else:
        places = [f"{result.name}.{field}" for result in routine.given for field in result.fields]
        values = [f"const r{k + 1} = {value};" for k, value in enumerate(found.results)]
        writes = [*values, *(f"{place} = r{k + 1};" for k, place in enumerate(places))]
    return "\n".join([*found.tables, head, *(f"  {line}" for line in (*reads, *found.body, *writes)), "}"])


def _test(library: Library) -> str:
    vectors = library.vectors(fma=False)
    rows = {
        routine.name: {
            "takes": [_shape(argument) for argument in routine.taken],
            "gives": [_shape(result) for result in routine.given],
            "vectors": [[*map(_coded, inputs), *map(_coded, results)] for inputs, results in vectors[routine.name]],
        }
        for routine in library.routines
    }
    content = json.dumps(rows, allow_nan=False).replace('"vectors": ', '"vectors":\n').replace("], [", "],\n[")
    return TEST.replace("NAME", library.name).replace("ROWS", content)


def _shape(argument: Argument) -> list[str] | None:
    return None if argument.record is None else list(argument.fields)


def _coded(number: float) -> float | str:
    """JSON has no infinity, and JavaScript reads its -0.0 as what it is."""
    return number if abs(number) != float("inf") else "Infinity" if number > 0.0 else "-Infinity"


TEST = """\
// Test vectors of NAME.mjs: what the laws of bicycle_env give, compared to the bit. Run: node NAME_test.mjs
import * as library from "./NAME.mjs";

const rows = ROWS;

let wrong = 0, total = 0;
for (const [name, { takes, gives, vectors }] of Object.entries(rows)) {
  for (const [place, coded] of vectors.entries()) {
    const numbers = coded.map(Number);
    const take = (fields) =>
      fields === null ? numbers.shift() : Object.fromEntries(fields.map((field) => [field, numbers.shift()]));
    const taken = takes.map(take);
    const given = gives.filter((fields) => fields !== null).map(() => ({}));
    const returned = library[name](...given, ...taken);
    const found = gives.flatMap((fields, k) => (fields === null ? [returned] : fields.map((field) => given[k][field])));
    const bad = found.findIndex((number, k) => !Object.is(number, numbers[k]));
    total += 1;
    if (bad >= 0) {
      wrong += 1;
      console.log(`${name}, vector ${place}, number ${bad}: ${found[bad]}, must be ${numbers[bad]}`);
    }
  }
}
console.log(`${wrong} of ${total} test vectors of NAME differ`);
process.exitCode = wrong === 0 ? 0 : 1;
"""
