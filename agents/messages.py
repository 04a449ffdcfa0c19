"""A user's mistake or wish to stop is one line on stderr and an exit code, not a traceback."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from agents import stopping
from bicycle_env.backends.compiled import CompilerDisabledError
from bicycle_env.files import FileError, checked_output, checked_output_folder, shown
from bicycle_env.streams import take_any_text


class UserError(Exception):
    """Something that the user can put right; its text says how."""


def run(main: Callable[[], int | None]) -> None:
    """Call `main` and exit with its code; 2 and one line for a user's mistake, 130 or 143 for a signal."""
    try:
        stopping.handle(stopping.raise_stopped)
        take_any_text()
        code = main() or 0
    except (UserError, OSError, ModuleNotFoundError, CompilerDisabledError, FileError) as error:
        print(f"error: {error}", file=sys.stderr)
        code = 2
    except KeyboardInterrupt as stopped:
        print(shown(stopped) or "stopped", file=sys.stderr)
        code = getattr(stopped, "code", 130)
    stopping.handle(stopping.leave_at_once)  # the interpreter's end is no place for exceptions
    sys.exit(code)


def console(stderr: bool = False, width: int | None = None) -> Console:
    """Where a command prints: text is text, whatever brackets a policy's name or a folder's has."""
    return Console(stderr=stderr, highlight=False, markup=False, width=width)


def progress(transient: bool = True) -> Progress:
    """A bar on standard error; descriptions are text, as on :func:`console`."""
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    return Progress(*columns, console=console(stderr=True), transient=transient)


def check_least(args: object, **least: int) -> None:
    """Refuse, before any work, numbers below the least allowed, by the names of their options; None is fine."""
    for name, low in least.items():
        value = getattr(args, name)
        if value is not None and value < low:
            raise UserError(f"--{name.replace('_', '-')} must be at least {low}, got {value}")


def check_folder(option: str, path: Path) -> None:
    """Refuse the folder that the user is in: a run's files need one of their own."""
    if path == Path():
        raise UserError(f"{option} must name a folder of its own, not the one you are in")


def check_output(option: str, path: Path | None, folder: bool = False) -> None:
    """Refuse, before any work, a file (or a folder to write into) that cannot be written; None is fine.

    Raises:
        UserError: one line that names the option and the path.
    """
    if path is None:
        return
    if folder:
        check_folder(option, path)
    try:
        (checked_output_folder if folder else checked_output)(path)
    except OSError as error:
        raise UserError(f"{option}: cannot write {shown(error.filename or path)}: {error.strerror}") from None
