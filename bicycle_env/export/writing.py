"""Writing what is exported into a folder, and nothing over what is somebody else's."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bicycle_env.files import (
    FileError,
    anything,
    checked_output_folder,
    mapping,
    read_bytes,
    read_json,
    table,
    write_bytes,
    write_json,
)

LIST = "export.json"
LARGEST = 100_000_000  # bytes
SCHEMA = table({"written_by": anything, "files": mapping(anything)}, others=True)


def write_folder(
    folder: str | Path,
    files: Mapping[str, str | bytes],
    settings: Mapping[str, Any],
    writer: str = "bicycle-env export",
) -> list[Path]:
    """Write files and, in ``export.json``, what they are and their digests; the paths.

    A file is replaced only if an earlier export by this `writer` wrote it, into this folder, and it was left as it is.

    Raises:
        FileError: a file is there that no export wrote, or that was edited since; nothing is written then.
        OSError: the folder cannot be written to.
    """
    folder = checked_output_folder(folder)
    contents = {name: content.encode() if isinstance(content, str) else content for name, content in files.items()}
    known = _known(folder / LIST, writer)
    for name, content in contents.items():
        path = folder / name
        if path.exists() and _digest(read_bytes(path, LARGEST)) not in (*known.get(name, ()), _digest(content)):
            raise FileError(
                f"{path}: is there, and is not what `{writer}` has written; move it, or name another folder"
            )
    new = {name: [_digest(content)] for name, content in contents.items()}
    listed = {"written_by": writer, **settings}
    # Killed in between, the next export must know the old files and the new ones.
    write_json(
        folder / LIST,
        {
            **listed,
            "files": {name: [*known.get(name, ()), *new[name]] for name in new}
            | {name: digests for name, digests in known.items() if name not in new},
        },
    )
    for name, content in contents.items():
        write_bytes(folder / name, content)
    write_json(folder / LIST, {**listed, "files": {**known, **new}})
    return [folder / name for name in contents]


def _known(path: Path, writer: str) -> dict[str, list[str]]:
    """By name, the digests of what earlier exports wrote."""
    if not path.exists():
        return {}
    content = read_json(path, SCHEMA)
    if content["written_by"] != writer:
        raise FileError(f"{path}: is there, and is not what `{writer}` has written; name another folder")
    return {name: list(map(str, digests)) for name, digests in content["files"].items() if isinstance(digests, list)}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
