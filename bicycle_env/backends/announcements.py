"""What is said on standard error while something compiles: one line that names it and how long it took."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

ONCE = "once for this machine"
ALWAYS = "anew in every process: no folder for compiled code can be written (NUMBA_CACHE_DIR may name one)"
SLOW = " (this processor has no fused multiply-add: the same bits as on others, several times slower)"


@dataclass(eq=False)
class _Work:
    label: str
    start: float = field(default_factory=time.perf_counter)
    said: bool = False
    failure: str = ""


_thread = threading.local()
"""Each thread names what it compiles itself."""
_writing = threading.Lock()
_open: _Work | None = None
"""Whose line has no end yet."""
_silent = 0


@contextlib.contextmanager
def progress(label: str) -> Iterator[None]:
    """While inside, the first entry point that is not in the cache prints one line with `label` to stderr."""
    work = _Work(label)
    works = _works()
    works.append(work)
    try:
        yield
    finally:
        works.remove(work)
        if work.said:
            _end(work)


@contextlib.contextmanager
def silenced(wanted: bool = True) -> Iterator[None]:
    """While inside, no thread of this process says what it compiles, if `wanted`."""
    global _silent
    _silent += wanted
    try:
        yield
    finally:
        _silent -= wanted


def compiling(kept: bool, slow: bool = False) -> None:
    """Say what this thread compiles, unless it was said.

    `kept`: later processes will find it on the disk; `slow`: the processor has no fused multiply-add.
    """
    global _open
    works = _works()
    if not works or works[-1].said or _silent:
        return
    with _writing:
        works[-1].said = True
        _say(
            f"{_break()}bicycle_env: compiling {works[-1].label}, {ONCE if kept else ALWAYS}{SLOW if slow else ''} ..."
        )
        _open = works[-1]


def not_kept(reason: str) -> None:
    """What was compiled cannot be written to the disk: to be said at the end of the line."""
    works = _works()
    if works:
        works[-1].failure = f", not kept: {reason}"


def _works() -> list[_Work]:
    if not hasattr(_thread, "works"):
        _thread.works = []
    works: list[_Work] = _thread.works
    return works


def _end(work: _Work) -> None:
    global _open
    with _writing:
        # Another thread may have begun its own line behind this one's.
        begin = "" if _open is work else f"{_break()}bicycle_env: compiled {work.label},"
        _open = None
        _say(f"{begin} {time.perf_counter() - work.start:.0f} s{work.failure}\n")


def _break() -> str:
    return "\n" if _open is not None else ""


def _say(text: str) -> None:
    if sys.stderr is not None:  # there is none without a console
        sys.stderr.write(text)
        sys.stderr.flush()
