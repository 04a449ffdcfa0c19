"""Write a report into a folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from bicycle_env import provenance
from bicycle_env.files import write_bytes
from bicycle_env.physics.vehicle import LABELS, Vehicle
from bicycle_env.plots.style import require_matplotlib
from bicycle_env.report import pictures
from bicycle_env.report.page import page
from bicycle_env.report.quantities import Group, Quantity, groups
from bicycle_env.report.study import Study, compute
from bicycle_env.report.words import summary, title

PAGE = "report.html"
UNITS = {
    "mass": ("kg", "m, of the whole car"),
    "yaw_inertia": ("kg m²", "I_z, about the vertical axis through the centre of mass"),
    "cg_to_front": ("m", "a, centre of mass to front axle"),
    "cg_to_rear": ("m", "b, centre of mass to rear axle"),
    "front_cornering_stiffness": ("N/rad", "Cf, both front tires together"),
    "rear_cornering_stiffness": ("N/rad", "Cr, both rear tires together"),
}
LENGTHS = "does not enter the equations of motion"


def write(study: Study, folder: str | Path, progress: Callable[[str], None] | None = None) -> Path:
    """Write ``report.html``, which holds its pictures, and the pictures as PNG files, directly into a folder.

    Args:
        study: what to report on.
        folder: made if it does not exist; files of the same names are replaced.
        progress: is told in words what comes next.

    Returns:
        The page's path.

    Raises:
        ModuleNotFoundError: matplotlib or python-control is missing; the text is the install line.
        OSError: the folder cannot be written.
    """
    folder = Path(folder)
    tell = progress or (lambda _: None)
    require_matplotlib()
    folder.mkdir(parents=True, exist_ok=True)
    compute(study, tell)
    figures = groups(study)
    drawn, left_out = [], list[str]()
    for picture in pictures.draw(study, tell, left_out):
        write_bytes(folder / picture.file_name, picture.content)
        drawn.append(picture)
    text = page(
        title(study),
        summary(study),
        parameters(study.vehicle),
        study.vehicle.source or "not given",
        figures,
        drawn,
        (
            f"Tire: {study.tire.name}; friction {study.friction:g}. The linear figures and pictures hold for small "
            "angles and every tire. Axes: x forward, y to the left; positive steer, yaw rate and sideslip are to the "
            "left.",
            *left_out,
            f"Made by bicycle-env {provenance.versions()['bicycle-env']}.",
        ),
    )
    write_bytes(folder / PAGE, text.encode())
    return folder / PAGE


def parameters(vehicle: Vehicle) -> Group:
    """The car's fields as rows."""
    rows = []
    for field in dataclasses.fields(vehicle):
        if field.name not in LABELS:
            unit, meaning = UNITS.get(field.name, ("m", LENGTHS))
            rows.append(
                Quantity(field.name, field.name.replace("_", " "), getattr(vehicle, field.name), unit, "", meaning)
            )
    return Group("The car", tuple(rows))
