"""The car, a task or a policy written out for other languages: see docs/export.md and ``bicycle-env export --help``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bicycle_env.export import c_source, casadi_file, fmu, javascript, policy, task
from bicycle_env.export.plant import Plant, library, plant
from bicycle_env.export.routines import Library
from bicycle_env.export.writing import write_folder
from bicycle_env.physics.validation import choice

__all__ = ["FORMATS", "LANGUAGES", "Plant", "export_plant", "export_policy", "export_task", "plant"]

LANGUAGES = ("c", "js")
FORMATS = (*LANGUAGES, "casadi", "fmu")
"""Of a plant; tasks and policies come in `LANGUAGES` only."""


def export_plant(plant: Plant, format: str, out: str | Path, *, fma: bool = False) -> list[Path]:
    """Write a plant into a folder.

    Args:
        format: a word of ``FORMATS``.
        out: the folder; made if needed.
        fma: of C and an FMU, whether a multiply-add rounds once, as in the environments.

    Returns:
        The paths of what was written.

    Raises:
        ValueError: an unknown format; `fma` of another than these; a pushed plant for CasADi.
        FileError: the folder holds a file of such a name that no export wrote.
        OSError: the folder cannot be written to.
        ModuleNotFoundError: CasADi is not installed.
    """
    choice("format", format, FORMATS)
    _check_fma(format, fma)
    files: Mapping[str, str | bytes]
    if format == "casadi":
        files = casadi_file.files(plant)
    elif format == "fmu":
        files = fmu.files(plant, fma)
    else:
        files = _source(library(plant), format, fma)
    return write_folder(out, files, {"what": str(plant), "format": format, "fma": fma})


def export_task(env_id: str, format: str, out: str | Path, *, fma: bool = False, **keywords: Any) -> list[Path]:
    """Write the start, the observation and a step of an environment into a folder.

    Args:
        env_id: an id of the package, or one that ``bicycle_env.register`` knows.
        format: a word of ``LANGUAGES``.
        out, fma: as of :func:`export_plant`.
        keywords: as ``gym.make`` takes them, without telemetry and render_mode.

    Returns, raises:
        As :func:`export_plant`; TraceError: a law that cannot be written out, such as sensors' noise.
    """
    choice("format", format, LANGUAGES)
    _check_fma(format, fma)
    configuration = task.configuration_of(env_id, **keywords)
    files = _source(task.library(configuration, env_id), format, fma)
    return write_folder(out, files, {"what": env_id, "format": format, "fma": fma})


def export_policy(policy_object: Any, format: str, out: str | Path, *, observation_names: Any = None) -> list[Path]:
    """Write a policy in single precision into a folder.

    Args:
        policy_object: a ``control.Network``, or a linear controller: ``control.LQR`` and the like.
        format: a word of ``LANGUAGES``.
        out: the folder; made if needed.
        observation_names: of the environment that a linear controller was designed for.

    Returns, raises:
        As :func:`export_plant`; ValueError: another kind of controller.
    """
    choice("format", format, LANGUAGES)
    files = policy.files(policy_object, format, observation_names)
    return write_folder(out, files, {"what": f"policy {policy_object.name}", "format": format})


def _check_fma(format: str, fma: bool) -> None:
    if fma and format not in ("c", "fmu"):
        raise ValueError(f"fma goes with the formats c and fmu, got {format!r}")


def _source(made: Library, format: str, fma: bool) -> Mapping[str, str]:
    return c_source.files(made, fma) if format == "c" else javascript.files(made)
