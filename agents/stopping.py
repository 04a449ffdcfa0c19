"""What Ctrl-C and a termination signal do to a command, from its first import to its end: one line and an exit code.

Standard library only: this is imported before everything that takes long.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stopped(KeyboardInterrupt):
    """A signal ended the work. Its text is what the user reads; ``code`` is the exit code, 130 or 143."""

    def __init__(self, number: int, text: str = "stopped") -> None:
        super().__init__(text)
        self.code = 128 + number


def leave_at_once(number: int, _frame: object) -> None:
    """Signal handler: say so and leave without any clean-up, which imports and the interpreter's end do not survive."""
    with contextlib.suppress(OSError):
        os.write(2, b"stopped\n")
    os._exit(128 + number)


def raise_stopped(number: int, _frame: object) -> None:
    """Signal handler: raise :class:`Stopped` where the program is; a second signal leaves at once."""
    handle(leave_at_once)
    raise Stopped(number)


def handle(handler: Callable[[int, Any], None]) -> dict[int, Any]:
    """Let `handler` take both signals; gives the handlers before.

    A signal that the caller of the command ignores stays ignored. Only a main thread may handle signals: in another
    one nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {
        number: signal.signal(number, handler) for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN
    }


class Request:
    """Whether a signal has asked for an end: its ``number``, or None."""

    def __init__(self) -> None:
        self.number: int | None = None

    def take(self, number: int, _frame: object) -> None:
        """Signal handler: remember the first signal; a second one leaves at once."""
        self.number = number
        handle(leave_at_once)


@contextlib.contextmanager
def deferred() -> Iterator[Request]:
    """Inside, a signal only makes a request, to be looked at where the work can be left."""
    request = Request()
    before = handle(request.take)
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def guard_imports() -> None:
    """Take signals from here on if this process is a command on its way, ``python -m agents.NAME``."""
    if sys.argv[:1] == ["-m"]:  # so it is while Python looks for the module that it will run
        handle(leave_at_once)
