"""What the content of a file must be: checks `(name, value) -> value` that raise ValueError or TypeError.

A check is any function of that form; those of ``bicycle_env.physics.validation`` are. An empty name is the whole file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from bicycle_env.physics.validation import choice, known_keys, number, whole

Check = Callable[[str, Any], Any]
MOST = 100_000  # entries of a list or a table


def anything(_: str, value: Any) -> Any:
    """Whatever it is."""
    return value


def number_in(low: float, high: float) -> Check:
    """A finite float in [low, high]."""
    return lambda name, value: number(name, value, low, high)


def whole_in(low: int, high: int) -> Check:
    """A whole number in [low, high]."""
    return lambda name, value: whole(name, value, low, high)


def one_of(words: Iterable[str]) -> Check:
    """One of these words."""
    allowed = list(words)
    return lambda name, value: choice(name, value, allowed)


def text(longest: int = 1000) -> Check:
    """A text of at most `longest` characters."""

    def check(name: str, value: Any) -> str:
        if not isinstance(value, str):
            raise TypeError(f"{_of(name)} must be a text, got {_kind(value)}")
        if len(value) > longest:
            raise ValueError(f"{_of(name)} must have at most {longest} characters, has {len(value)}")
        return value

    return check


def listed(check: Check, least: int = 0, most: int = MOST) -> Check:
    """A list of `least` to `most` entries that each pass `check`."""

    def whole_list(name: str, value: Any) -> list[Any]:
        if not isinstance(value, list):
            raise TypeError(f"{_of(name)} must be a list, got {_kind(value)}")
        if not least <= len(value) <= most:
            raise ValueError(f"{_of(name)} must have {least} to {most} entries, has {len(value)}")
        return [check(f"{name}[{k}]", entry) for k, entry in enumerate(value)]

    return whole_list


def mapping(check: Check, most: int = MOST) -> Check:
    """A table whose keys are free and whose values pass `check`."""

    def whole_table(name: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise TypeError(f"{_of(name)} must be a table, got {_kind(value)}")
        if len(value) > most:
            raise ValueError(f"{_of(name)} must have at most {most} entries, has {len(value)}")
        return {key: check(_inside(name, key), entry) for key, entry in value.items()}

    return whole_table


def table(required: Mapping[str, Check], optional: Mapping[str, Check] | None = None, others: bool = False) -> Check:
    """A table with the `required` keys and perhaps the `optional` ones; other keys are refused unless `others`."""
    known = {**required, **(optional or {})}

    def whole_table(name: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise TypeError(f"{_of(name)} must be a table of {', '.join(known)}, got {_kind(value)}")
        if not others:
            known_keys(f"key in {name}" if name else "key", value, known)
        missing = [key for key in required if key not in value]
        if missing:
            raise ValueError(
                f"{_of(name)} must have the keys {', '.join(required)}; missing: {', '.join(map(repr, missing))}"
            )
        return {key: known.get(key, anything)(_inside(name, key), entry) for key, entry in value.items()}

    return whole_table


def _of(name: str) -> str:
    return name or "the content"


def _inside(name: str, key: str) -> str:
    return f"{name}.{key}" if name else key


def _kind(value: Any) -> str:
    return "nothing" if value is None else f"a {type(value).__name__}"
