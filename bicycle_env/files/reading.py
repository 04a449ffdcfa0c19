"""Reading JSON and TOML that may come from a stranger: regular files of limited size, depth and range of values."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bicycle_env.files.schema import Check
from bicycle_env.files.words import shown

LARGEST = 1_000_000  # bytes of a JSON or TOML file
DEEPEST = 32  # tables and lists in each other
WIDEST = 128  # bits of a whole number: the state of numpy's PCG64 fits
KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISCHR, "a device"),
)
BRACKET = re.compile(r"""[][{}]|"(?:[^"\\]|\\.)*+"?""", re.DOTALL)
"""A bracket, or a text with what stands in it."""
# tomllib's time grows with the square of the parts of a dotted key.
PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
LONG_KEY = re.compile(rf"""(?<![\w."'-]){PART}(?:[ \t]*+\.[ \t]*+{PART}){{{DEEPEST}}}""")


class FileError(ValueError):
    """A file, or a text that a user gave, is not what is expected there. One line; it names the file."""


@contextlib.contextmanager
def naming(name: str | Path) -> Iterator[None]:
    """Turn a ValueError or TypeError inside into a :class:`FileError` that begins with the file's name."""
    try:
        yield
    except FileError:
        raise
    except (ValueError, TypeError) as error:
        raise FileError(f"{shown(name)}: {shown(error)}") from None


def read_bytes(path: str | Path, largest: int = LARGEST) -> bytes:
    """The content of a regular file of at most `largest` bytes; the size is looked at before anything is read.

    Raises:
        FileError: a folder, a FIFO, a device; too large.
        OSError: the file cannot be opened or read.
    """
    with naming(path):
        _check_regular(os.stat(path).st_mode)
        # Should a FIFO take the file's place in between, O_NONBLOCK keeps us from waiting for its writer.
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
        with os.fdopen(os.open(path, flags), "rb") as file:
            status = os.fstat(file.fileno())
            _check_regular(status.st_mode)
            size = status.st_size
            content = b"" if size > largest else file.read(largest + 1)
        if max(size, len(content)) > largest:
            raise ValueError(f"must not be larger than {largest} bytes, has {max(size, len(content))}")
        return content


def _check_regular(mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((words for holds, words in KINDS if holds(mode)), "something else")
        raise ValueError(f"must be a regular file, is {kind}")


def read_json(path: str | Path, check: Check | None = None, largest: int = LARGEST, deepest: int = DEEPEST) -> Any:
    """What a JSON file holds, after `check`.

    Args:
        path: a regular file, UTF-8, with or without a byte order mark.
        check: what the content must be, see :mod:`bicycle_env.files.schema`; None takes anything.
        largest: bytes.
        deepest: tables and lists in each other.

    Raises:
        FileError: no regular file, too large, not UTF-8, not JSON, a key twice in one table, too deep, a number that is
            not finite or has more than 128 bits, a text that is no Unicode, or what `check` refuses.
        OSError: the file cannot be opened or read.
    """
    return read_language(path, "JSON", _json, check, largest, deepest)


def read_toml(path: str | Path, check: Check | None = None, largest: int = LARGEST, deepest: int = DEEPEST) -> Any:
    """What a TOML file holds, after `check`; as :func:`read_json`. Dates and times are refused."""
    return read_language(path, "TOML", _toml, check, largest, deepest)


def read_table(path: str | Path, check: Check | None = None, largest: int = LARGEST, deepest: int = DEEPEST) -> Any:
    """A TOML file if its name ends in .toml, a JSON file otherwise; as :func:`read_json`."""
    read = read_toml if Path(path).suffix.lower() == ".toml" else read_json
    return read(path, check, largest, deepest)


def parse_json(
    content: str | bytes, name: str, check: Check | None = None, largest: int = LARGEST, deepest: int = DEEPEST
) -> Any:
    """JSON that is in memory already, held to the same rules; `name` says in an error where it comes from."""
    with naming(name):
        try:
            content = content.encode() if isinstance(content, str) else content
        except UnicodeEncodeError:
            raise ValueError("not JSON: it holds what is no Unicode") from None
        if len(content) > largest:
            raise ValueError(f"must not be larger than {largest} bytes, has {len(content)}")
    return _parsed(content, name, "JSON", _json, check, deepest)


def read_language(
    path: str | Path, language: str, parse: Callable[[str, int], Any], check: Check | None, largest: int, deepest: int
) -> Any:
    """What a file holds that `parse` reads from its text and the depth allowed; as :func:`read_json`."""
    return _parsed(read_bytes(path, largest), str(path), language, parse, check, deepest)


def _parsed(
    content: bytes, name: str, language: str, parse: Callable[[str, int], Any], check: Check | None, deepest: int
) -> Any:
    with naming(name):
        try:
            value = parse(content.decode("utf-8-sig"), deepest)
        except RecursionError:
            raise ValueError(f"not {language}: nested deeper than {deepest}") from None
        except ValueError as error:
            raise ValueError(f"not {language}: {error}") from None
        _check_values(value, deepest)
        return value if check is None else check("", value)


def _json(content: str, deepest: int) -> Any:
    depth = 0
    for found in BRACKET.finditer(content):  # before the parser, whose own limit is the interpreter's
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(found[0], 0)
        if depth > deepest:
            raise ValueError(f"nested deeper than {deepest}")
    return json.loads(content, object_pairs_hook=_once)


def _toml(content: str, _: int) -> Any:
    if LONG_KEY.search(content):
        raise ValueError(f"a key of more than {DEEPEST} parts")
    return tomllib.loads(content)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object in which no key stands twice."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"{key!r} stands twice")
        found[key] = value
    return found


def _check_values(value: Any, deepest: int) -> None:
    """Refuse depth, numbers and texts that no reader here can want. A place is a chain (the place around it, key)."""
    waiting: list[tuple[Any, Any, int]] = [((), value, 0)]
    while waiting:
        place, item, depth = waiting.pop()
        if isinstance(item, dict | list):
            if depth == deepest:
                raise ValueError(f"nested deeper than {deepest}")
            inside = item.items() if isinstance(item, dict) else enumerate(item)
            for key, content in inside:
                if isinstance(key, str):
                    _check_text("a key", key)
                waiting.append(((place, key), content, depth + 1))
        elif isinstance(item, str):
            _check_text(_place(place), item)
        elif isinstance(item, float):
            if not math.isfinite(item):
                raise ValueError(f"{_place(place)} must be a finite number, got {item}")
        elif isinstance(item, int):  # True and False too
            if item.bit_length() > WIDEST:
                raise ValueError(f"{_place(place)} must be a number of at most {WIDEST} bits")
        elif item is not None:
            raise ValueError(
                f"{_place(place)} must be a number, a text, a list or a table, got a {type(item).__name__}"
            )


def _check_text(name: str, item: str) -> None:
    try:
        item.encode()
    except UnicodeEncodeError:
        raise ValueError(f"{name} holds what is no Unicode: {item[:40]!r}") from None


def _place(chain: Any) -> str:
    keys: list[str] = []
    while chain:
        chain, key = chain
        keys.append(f"[{key}]" if isinstance(key, int) else f".{key[:40]}")
    return "".join(reversed(keys)).removeprefix(".") or "the value"
