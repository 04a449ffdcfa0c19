"""Compiled code on the disk, one file per content and processor. Whatever is wrong with a file costs a compile."""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, NullCache
from numba.core.serialize import dumps

from bicycle_env.backends import announcements
from bicycle_env.files import write_bytes

ABANDONED = 3600.0  # s
"""The age at which a temporary file is of a process that was killed."""
CHECKSUM = hashlib.sha256().digest_size


class ContentCache(NullCache):  # type: ignore[misc]
    """What numba asks for compiled code, and gives it to: a file ``NAME-CONTENT-PROCESSOR.nbc`` in numba's folder.

    As numba's, it is of this user's own making and holds machine code and a pickle: no place for files from elsewhere.
    numba's own cache has an index beside the code. Between two machines that share a disk, the index of one could lead
    to the code of the other; and a damaged or unwritable file there is an error.

    Args:
        function: what is compiled; numba chooses the folder by the place of its source.
        content: hexadecimal digest of all that the code depends on, but for the processor.
    """

    def __init__(self, function: Callable[..., Any], content: str) -> None:
        self._name = f"{function.__name__}-{content[:20]}"
        self._numba: Any = None
        with contextlib.suppress(RuntimeError, OSError):  # no folder can be written: compile in every process
            self._numba = CompileResultCacheImpl(function)

    @property
    def cache_path(self) -> str | None:
        """The folder; None if there is none."""
        return None if self._numba is None else self._numba.locator.get_cache_path()

    def load_overload(self, _signature: Any, target_context: Any) -> Any:
        """What is kept for this processor, or None: it will be compiled, and is announced."""
        target_context.refresh()
        found = None
        if self._numba is not None:
            with contextlib.suppress(Exception):  # a pickle that is not what was written may raise anything
                found = self._numba.rebuild(target_context, _read(self._path(target_context.codegen())))
        if found is None:
            slow = not has_multiply_add(*target_context.codegen().magic_tuple())
            announcements.compiling(kept=self._numba is not None, slow=slow)
        return found

    def save_overload(self, _signature: Any, data: Any) -> None:
        """Keep it, if the disk takes it."""
        if self._numba is None or not self._numba.check_cachable(data):
            return
        path = self._path(data.codegen)
        content = dumps(self._numba.reduce(data))
        try:
            self._numba.locator.ensure_cache_path()
            _remove_abandoned(path)
            write_bytes(path, hashlib.sha256(content).digest() + content)
        except OSError as error:
            announcements.not_kept(error.strerror or str(error))

    def _path(self, codegen: Any) -> Path:
        processor = hashlib.sha256(repr(codegen.magic_tuple()).encode()).hexdigest()
        return Path(self._numba.locator.get_cache_path()) / f"{self._name}-{processor[:8]}.nbc"


def has_multiply_add(triple: str, _name: str, features: str) -> bool:
    """Whether a processor, as LLVM describes it, rounds a b + c once in one instruction; only on x86 some do not."""
    return not triple.startswith(("x86_64", "i686", "i386")) or "+fma" in features.split(",")


def _read(path: Path) -> Any:
    content = path.read_bytes()
    if hashlib.sha256(content[CHECKSUM:]).digest() != content[:CHECKSUM]:
        raise ValueError(f"{path} is not what was written")  # damage, before pickle or the linker meets it
    return pickle.loads(content[CHECKSUM:])


def _remove_abandoned(path: Path) -> None:
    """Remove the temporary files that killed processes have left of this file."""
    for stray in path.parent.glob(f".{path.name}.*"):
        if time.time() - stray.stat().st_mtime > ABANDONED:
            stray.unlink()
