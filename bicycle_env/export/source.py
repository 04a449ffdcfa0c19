"""Straight-line code as lines of source, for languages whose expressions are written as in C."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from typing import NamedTuple

from bicycle_env.backends.trace import CONDITIONS, Program

LONGEST = 90
"""Letters of an expression that is written where it is used, not under a name of its own."""
BINARY = ("+", "-", "*", "/", "<", "<=", ">", ">=", "==", "!=")


@dataclasses.dataclass(frozen=True)
class Language:
    """How operations are written; each ``{}`` is an operand."""

    size: str
    floor: str
    root: str
    multiply_add: str
    infinity: str
    declaration: str
    """``{name}`` and ``{value}``."""
    table: str
    """``{name}`` and ``{values}``, outside of functions."""
    lookup: str
    """``{name}`` and ``{index}``."""
    suffix: str = ""
    """Of a number's digits."""

    def number(self, value: float) -> str:
        """Digits that give back the same bits."""
        if math.isnan(value):
            raise ValueError("a constant that is not a number cannot be written out")
        if math.isinf(value):
            return self.infinity if value > 0.0 else f"(-{self.infinity})"
        digits = repr(float(value)) + self.suffix
        return f"({digits})" if digits.startswith("-") else digits


class Lines(NamedTuple):
    """The source of a program."""

    tables: list[str]
    """Before the function."""
    body: list[str]
    results: list[str]
    """Expressions."""


def lines(program: Program, language: Language, names: dict[tuple[str, str], str], prefix: str) -> Lines:
    """Write a program; `names`: of its inputs; `prefix`: before the names of its tables."""
    templates = {
        "negative": "(-{})",
        "size": language.size,
        "floor": language.floor,
        "root": language.root,
        "multiply_add": language.multiply_add,
        "choose": "({} ? {} : {})",
        "and": "({} && {})",
        "or": "({} || {})",
        "not": "(!{})",
        **{operation: f"({{}} {operation} {{}})" for operation in BINARY},
    }
    uses = Counter(operand for step in program.steps for operand in step.operands) + Counter(program.results)
    written: list[str] = []
    tables: dict[tuple[float, ...], str] = {}
    body: list[str] = []
    for k, step in enumerate(program.steps):
        operands = [written[operand] for operand in step.operands]
        if step.operation == "constant":
            written.append(language.number(step.value))
            continue
        if step.operation == "input":
            written.append(names[step.value])
            continue
        if step.operation == "lookup":
            name = tables.setdefault(step.value, f"{prefix}_table{len(tables) + 1}")
            text = language.lookup.format(name=name, index=operands[0])
        else:
            text = templates[step.operation].format(*operands)
        if uses[k] == 1 and len(text) <= LONGEST:
            written.append(text)
            continue
        name = f"v{len(body) + 1}"
        body.append(language.declaration.format(name=name, value=bare(text)))
        written.append(name)
    listed = [
        language.table.format(name=name, values=", ".join(map(language.number, values)))
        for values, name in tables.items()
    ]
    results = [
        f"({written[k]} ? {language.number(1.0)} : {language.number(0.0)})"
        if program.steps[k].operation in CONDITIONS
        else written[k]
        for k in program.results
    ]
    return Lines(listed, body, [bare(result) for result in results])


def bare(text: str) -> str:
    """An expression without the brackets around all of it."""
    if not text.startswith("("):
        return text
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if k == len(text) - 1 else text
    return text
