"""A library as C99: a header, the functions, and a program that checks the test vectors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from bicycle_env.export.routines import UNITS, Argument, Library, Routine
from bicycle_env.export.source import Language, lines

C = Language(
    size="fabs({})",
    floor="floor({})",
    root="sqrt({})",
    multiply_add="({} * {} + {})",
    infinity="INFINITY",
    declaration="const double {name} = {value};",
    table="static const double {name}[] = {{{values}}};",
    lookup="{name}[(int)({index})]",
)
C_FUSED = dataclasses.replace(C, multiply_add="fma({}, {}, {})")
FLAGS = "-std=c99 -Wall -Werror -ffp-contract=off -O2"


def files(library: Library, fma: bool) -> dict[str, str]:
    """By name; `fma`: what the laws call a multiply-add is rounded once, as in the environments."""
    name = library.name
    return {
        f"{name}.h": _header(library, fma),
        f"{name}.c": _source(library, fma),
        f"{name}_test.c": _test(library, fma),
    }


def build_line(name: str) -> str:
    """The command that compiles and runs the test."""
    return f"gcc {FLAGS} {name}.c {name}_test.c -o {name}_test -lm && ./{name}_test"


def comment(words: Sequence[str]) -> str:
    """A block of them."""
    safe = [line.replace("*/", "* /") for line in words]
    return "\n".join([f"/* {safe[0]}", *(f" * {line}".rstrip() for line in safe[1:]), " */"])


def prototype(library: Library, routine: Routine) -> str:
    """Without the semicolon."""
    prefix = library.name
    taken = [_parameter(prefix, argument, "const ") for argument in routine.taken]
    if routine.given[0].record is None:
        return f"double {prefix}_{routine.name}({', '.join(taken)})"
    given = [_parameter(prefix, argument) for argument in routine.given]
    return f"void {prefix}_{routine.name}({', '.join([*given, *taken])})"


def _parameter(prefix: str, argument: Argument, qualifier: str = "") -> str:
    if argument.record is None:
        return f"{'int' if argument.kind == 'count' else 'double'} {argument.name}"
    return f"{qualifier}{prefix}_{argument.type_name} *{argument.name}"


def _header(library: Library, fma: bool) -> str:
    name = library.name
    guard = f"{name.upper()}_H"
    rounding = (
        "A multiply-add is C's fma(), rounded once: equal to the environments to the bit."
        if fma
        else "A multiply-add rounds twice: equal to the laws in plain Python to the bit; the environments round once."
    )
    words = [
        *library.words,
        "",
        "Written by `bicycle-env export`. SI units, angles in rad; x forward, y to the left, z up.",
        rounding,
        f"Check it: {build_line(name)}",
        "Results may stand where arguments stand: everything is read before anything is written.",
    ]
    parts = [comment(words), f"#ifndef {guard}\n#define {guard}", '#ifdef __cplusplus\nextern "C" {\n#endif']
    for kind, record in library.records.items():
        fields = [f"    double {field};{_unit(field)}" for field in record._fields]
        parts.append("\n".join(["typedef struct {", *fields, f"}} {name}_{kind};"]))
    for constant, value in library.constants.items():
        if _is_words(value):
            parts.append(f"extern const char *const {name}_{constant}[{len(value)}];")
            continue
        of = library.constant_types.get(constant)
        parts.append(f"extern const {f'{name}_{of}' if of else 'double'} {name}_{constant};")
    for routine in library.routines:
        parts.append(f"{comment([routine.words]).replace(chr(10), '')}\n{prototype(library, routine)};")
    parts.append("#ifdef __cplusplus\n}\n#endif\n#endif")
    return "\n\n".join(parts) + "\n"


def _unit(field: str) -> str:
    return f" /* {UNITS[field]} */" if field in UNITS else ""


def _is_words(value: Any) -> bool:
    return isinstance(value, tuple) and all(isinstance(word, str) for word in value)


def _source(library: Library, fma: bool) -> str:
    name, language = library.name, C_FUSED if fma else C
    parts = [
        f'#include "{name}.h"\n\n#include <math.h>',
        "#ifdef __FAST_MATH__\n#error compile without -ffast-math: the order of operations decides the bits\n#endif",
        "#ifdef __clang__\n#pragma STDC FP_CONTRACT OFF\n#endif",
    ]
    for constant, value in library.constants.items():
        kind = library.constant_types.get(constant)
        if _is_words(value):
            listed = ", ".join(f'"{word}"' for word in value)
            parts.append(f"const char *const {name}_{constant}[{len(value)}] = {{{listed}}};")
            continue
        if kind is None:
            parts.append(f"const double {name}_{constant} = {language.number(value)};")
            continue
        rows = [
            f"    .{field} = {language.number(number)},{_unit(field)}"
            for field, number in zip(value._fields, value, strict=True)
        ]
        parts.append("\n".join([f"const {name}_{kind} {name}_{constant} = {{", *rows, "};"]))
    for routine in library.routines:
        if routine.c_body:
            body = routine.c_body.replace("{p}", name).splitlines()
            parts.append("\n".join([prototype(library, routine), "{", *(f"    {line}".rstrip() for line in body), "}"]))
        else:
            parts.append(_function(library, routine, language))
    return "\n\n".join(parts) + "\n"


def _function(library: Library, routine: Routine, language: Language) -> str:
    program = routine.program()
    used = {step.value for step in program.steps if step.operation == "input"}
    reads, names = [], {}
    for argument in routine.taken:
        for field in argument.fields:
            names[argument.name, field] = f"{argument.name}_{field}" if field else argument.name
            if field and (argument.name, field) in used:
                reads.append(f"const double {argument.name}_{field} = {argument.name}->{field};")
    found = lines(program, language, names, f"{library.name}_{routine.name}")
    if routine.given[0].record is None:
        writes = [f"return {found.results[0]};"]
    else:
        places = [f"{result.name}->{field}" for result in routine.given for field in result.fields]
        # All results have their values before the first is written: they may be the arguments.
        values = [f"const double r{k + 1} = {value};" for k, value in enumerate(found.results)]
        writes = [*values, *(f"{place} = r{k + 1};" for k, place in enumerate(places))]
    body = [f"    {line}" for line in (*reads, *found.body, *writes)]
    return "\n".join([*found.tables, prototype(library, routine), "{", *body, "}"])


def _test(library: Library, fma: bool) -> str:
    name, vectors = library.name, library.vectors(fma)
    parts = [
        comment([f"Test vectors of {name}.c: what the laws of bicycle_env give, compared to the bit."]),
        f'#include "{name}.h"\n\n#include <math.h>\n#include <stdio.h>\n#include <string.h>',
        "static int differ(const char *function, int vector, const double *found, const double *wanted, int count)\n{\n"
        "    for (int k = 0; k < count; k++) {\n"
        "        if (memcmp(&found[k], &wanted[k], sizeof(double)) != 0) {\n"
        '            printf("%s, vector %d, number %d: %.17g, must be %.17g\\n", function, vector, k, found[k], '
        "wanted[k]);\n"
        "            return 1;\n        }\n    }\n    return 0;\n}",
    ]
    calls = []
    for routine in library.routines:
        rows = vectors[routine.name]
        parts.append(_table(routine, rows))
        calls.append(_check(library, routine, len(rows)))
    total = sum(map(len, vectors.values()))
    parts.append(
        "\n".join(
            [
                "int main(void)",
                "{",
                "    int wrong = 0;",
                *calls,
                f'    printf("%d of {total} test vectors of {name} differ\\n", wrong);',
                "    return wrong != 0;",
                "}",
            ]
        )
    )
    return "\n\n".join(parts) + "\n"


def _table(routine: Routine, rows: Any) -> str:
    width = len(rows[0][0]) + len(rows[0][1])
    texts = [f"    {{{', '.join(C.number(number) for number in (*inputs, *results))}}}," for inputs, results in rows]
    return "\n".join([f"static const double {routine.name}_vectors[][{width}] = {{", *texts, "};"])


def _check(library: Library, routine: Routine, count: int) -> str:
    """A loop over the vectors of a routine."""
    at = 0
    read: list[str] = []
    handed: list[str] = []
    for argument in routine.taken:
        if argument.record is None:
            handed.append(f"{'(int)' if argument.kind == 'count' else ''}row[{at}]")
        else:
            values = ", ".join(f"row[{at + k}]" for k in range(len(argument.fields)))
            read.append(f"        const {library.name}_{argument.type_name} {argument.name} = {{{values}}};")
            handed.append(f"&{argument.name}")
        at += len(argument.fields)
    size = sum(len(result.fields) for result in routine.given)
    if routine.given[0].record is None:
        read.append(f"        const double found[] = {{{library.name}_{routine.name}({', '.join(handed)})}};")
    else:
        given = [f"given_{result.name}" for result in routine.given]
        for result, local in zip(routine.given, given, strict=True):
            read.append(f"        {library.name}_{result.type_name} {local};")
        call = ", ".join([*(f"&{local}" for local in given), *handed])
        read.append(f"        {library.name}_{routine.name}({call});")
        numbers = [
            f"{local}.{field}" for result, local in zip(routine.given, given, strict=True) for field in result.fields
        ]
        read.append(f"        const double found[] = {{{', '.join(numbers)}}};")
    return "\n".join(
        [
            f"    for (int k = 0; k < {count}; k++) {{",
            f"        const double *row = {routine.name}_vectors[k];",
            *read,
            f'        wrong += differ("{routine.name}", k, found, row + {at}, {size});',
            "    }",
        ]
    )
