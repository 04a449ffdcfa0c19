"""Reading the plain part of YAML: names, numbers, short texts, and tables of them by indentation. No library needed.

A stranger's YAML can hold objects to be made, and names for parts that repeat until memory is full. Here there are
neither tags nor anchors, nor lists, documents, or texts of several lines: each is refused with its line.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from bicycle_env.files.reading import DEEPEST, LARGEST, read_language
from bicycle_env.files.schema import Check

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
NUMBER = re.compile(r"[-+]?(?:[0-9]++(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan", re.IGNORECASE)
TEXT = re.compile(r"[\w./+-][\w ./+-]*")
QUOTED = re.compile(r"""(?:'([^']*)'|"([^"\\]*)") *(?: #.*)?""")


def read_yaml(path: str | Path, check: Check | None = None, largest: int = LARGEST, deepest: int = DEEPEST) -> Any:
    """What a YAML file holds, after `check`; as :func:`bicycle_env.files.read_json`.

    Lines are ``name: number``, ``name: text`` or ``name:`` with an indented table below; numbers are floats.
    """
    return read_language(path, "YAML", _parse, check, largest, deepest)


def _parse(content: str, deepest: int) -> dict[str, Any]:
    top: dict[str, Any] = {}
    tables, opened = [(0, top)], None  # the tables around a line with their indentation; one whose first line is next
    for number, line in enumerate(content.split("\n"), 1):
        words = line.strip(" \r")
        if not words or words.startswith("#") or (words == "---" and not top):
            continue
        indent = len(line) - len(line.lstrip(" "))
        name, colon, rest = words.partition(":")
        if not colon or not NAME.fullmatch(name) or rest[:1] not in ("", " "):
            raise ValueError(f"line {number}: must be 'name: value' or a table's 'name:', got {words[:60]!r}")
        if opened is not None and indent > tables[-1][0]:
            tables.append((indent, opened))
        while indent < tables[-1][0]:
            tables.pop()
        if indent != tables[-1][0]:
            raise ValueError(f"line {number}: {name[:60]!r} is indented like no line above")
        if len(tables) > deepest:
            raise ValueError(f"nested deeper than {deepest}")
        table = tables[-1][1]
        if name in table:
            raise ValueError(f"line {number}: {name[:60]!r} stands twice")
        table[name] = value = _value(number, rest)
        opened = value if isinstance(value, dict) else None
    return top


def _value(number: int, rest: str) -> float | str | dict[str, Any]:
    words = rest.strip(" ")
    if quoted := QUOTED.fullmatch(words):
        return quoted[1] or quoted[2] or ""
    words = rest.partition(" #")[0].strip(" ")
    if not words:
        return {}
    if NUMBER.fullmatch(words):
        return float(words.replace(".inf", "inf").replace(".nan", "nan"))
    if not TEXT.fullmatch(words):
        raise ValueError(f"line {number}: a value must be a number or a plain text, got {words[:60]!r}")
    return words
