"""A user's mistake is one line on stderr and an exit code, not a traceback."""

from __future__ import annotations

import sys
from collections.abc import Callable

from bicycle_env.physics.compiled import CompilerDisabledError
from bicycle_env.streams import take_any_text


class UserError(Exception):
    """Something that the user can put right; its text says how."""


def run(main: Callable[[], int | None]) -> None:
    """Call `main` and exit with its code; 2 and one line for a user's mistake, 130 for Ctrl-C."""
    take_any_text()
    try:
        sys.exit(main() or 0)
    except (UserError, OSError, ModuleNotFoundError, CompilerDisabledError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        sys.exit(130)
