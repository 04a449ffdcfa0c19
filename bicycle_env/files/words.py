"""Text from a file or a user, made harmless before it is shown."""

from __future__ import annotations

LONGEST = 400  # characters


def shown(text: object, longest: int = LONGEST) -> str:
    """One line of printable characters that says what `text` holds.

    Line ends, control characters, escape sequences and the marks that turn the direction of writing become backslash
    codes; what is longer than `longest` characters is cut, with dots. It is plain text: print it where square brackets
    mean nothing, for example with rich's ``markup=False``.
    """
    words = str(text)
    cut = words[:longest]
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in cut)
    return line if len(line) <= longest and len(words) <= longest else f"{line[:longest]} ..."
