"""Writing files so that a kill at any moment leaves the old content or the new, never half of it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import secrets
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from bicycle_env.files.arrays import pack_arrays

PARTIAL = re.compile(r"\..*\.[0-9a-f]{16}\.partial")


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write to a temporary file in the same folder, fsync, and rename it over `path`; the folder is made if needed.

    The file's mode follows the umask. A writer that is killed leaves ``.NAME.RANDOM.partial`` behind, which
    :func:`remove_partial_files` removes.

    Raises:
        OSError: the file cannot be written, or a folder or a device has its name.
    """
    path = Path(path)
    _refuse_other_kinds(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / _partial_name(path)
    try:
        with os.fdopen(os.open(temporary, _NEW_FILE, 0o666), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


def write_json(path: str | Path, content: Any) -> None:
    """Write indented JSON; NaN and infinity are refused (ValueError), they are not JSON."""
    write_bytes(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def write_arrays(path: str | Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a safetensors file, see :func:`bicycle_env.files.pack_arrays`."""
    write_bytes(path, pack_arrays(arrays))


def remove_partial_files(folder: str | Path) -> None:
    """Remove what killed writers left directly in a folder. Only for a folder that no one else is writing into."""
    with contextlib.suppress(FileNotFoundError):
        for entry in list(os.scandir(folder)):
            if PARTIAL.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(entry.path)


def checked_output(path: str | Path) -> Path:
    """The path, if a file can be written there: to be asked before hours of work, not after.

    Raises:
        OSError: a folder or a device has the name, or the nearest folder above that exists cannot be written to.
    """
    path = Path(path)
    _refuse_other_kinds(path)
    checked_output_folder(path.parent)
    return path


def checked_output_folder(folder: str | Path) -> Path:
    """The folder, if files can be written into it, or if it can be made; nothing is made yet. Raises OSError."""
    folder = Path(folder)
    nearest = folder
    while not _exists(nearest):
        nearest = nearest.parent
    if not nearest.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(nearest))
    probe = nearest / _partial_name(folder)
    try:
        os.close(os.open(probe, _NEW_FILE, 0o666))  # a superuser may do more than the mode bits say: try it
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(folder)) from None
    os.unlink(probe)
    return folder


_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


def _partial_name(path: Path) -> str:
    name = os.fsdecode(os.fsencode(path.name)[:200])  # a file's name may have 255 bytes
    return f".{name}.{secrets.token_hex(8)}.partial"


def _exists(path: Path) -> bool:
    """Whether a name is taken, by a link that leads nowhere too; OSError where that cannot be known."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except ValueError as error:  # a null character
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    return True


def _refuse_other_kinds(path: Path) -> None:
    """A rename would put a file in the place of a device such as /dev/null."""
    if path.name in ("", ".."):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not _exists(path):
        return
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:  # a link that leads nowhere is replaced
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "Not a regular file", str(path))
