"""The car, a task or a policy written out for other languages: see docs/export.md and ``bicycle-env export --help``."""

from __future__ import annotations

from pathlib import Path

from bicycle_env.export import c_source, javascript
from bicycle_env.export.plant import Plant, library, plant
from bicycle_env.export.writing import write_folder

__all__ = ["FORMATS", "Plant", "export_plant", "plant"]

FORMATS = ("c", "js")


def export_plant(plant: Plant, format: str, out: str | Path, *, fma: bool = False) -> list[Path]:
    """Write a plant into a folder.

    Args:
        format: a word of ``FORMATS``.
        fma: of C, whether a multiply-add rounds once, as in the environments.

    Returns:
        The paths of what was written.

    Raises:
        FileError: the folder holds a file of such a name that no export wrote.
        OSError: the folder cannot be written to.
    """
    made = library(plant)
    files = c_source.files(made, fma) if format == "c" else javascript.files(made)
    return write_folder(out, files, {"what": str(plant), "format": format, "fma": fma})
