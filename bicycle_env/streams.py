"""Standard output and standard error take every text, whatever their encoding: GBK and ASCII have no square metres."""

from __future__ import annotations

import codecs
import io
import sys

PLAIN = {"²": "^2", "±": "+-", "°": " deg"}
"""How to write what an encoding lacks; "?" for anything else."""


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(PLAIN.get(character, "?") for character in error.object[error.start : error.end]), error.end


codecs.register_error("bicycle_env.plain", _plain)


def take_any_text() -> None:
    """What a command calls first: a character that cannot be printed is written plainly, not an error.

    Streams for which the user has chosen another remedy (PYTHONIOENCODING=ascii:backslashreplace) keep it.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="bicycle_env.plain")
