"""What a file holds, before a motion is written: parts, boxes, vertex groups, scale; amplitudes where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .prepare import framed, inspected, motion_of
from .scenes import NAMES
from .settings import Settings, Source, motion_file
from .vibration import Body, reach

if TYPE_CHECKING:
    from .sources.bodies_file import Found

_DIGITS = 4  # significant


def listing(source: Source, settings: Settings | None) -> str:
    """Lines for the terminal. `settings`: with a motion, whose amplitudes are listed, too.

    Raises GenerateError for a file, or a motion on it, that the generator would refuse.
    """
    found = inspected(source)
    lines = [*_about(found), "", *_table(found.bodies)]
    if settings is not None:
        lines += ["", *_modes(settings, found)]
    return "\n".join(lines)


def scenes_listed() -> str:
    """The built-in scenes, a line for each: its name and what moves in it, as its motion description begins."""
    lines = []
    for name in NAMES:
        first = motion_file(name).read_text(encoding="utf-8").splitlines()[0]
        lines.append(f"{name:10s} {first.removeprefix('# ')}")
    return "\n".join(lines)


def _about(found: Found) -> list[str]:
    vertices = sum(len(body.vertices) for body in found.bodies)
    unit, factor = found.own_unit
    scale = "the file does not say how long a scene unit is"
    if unit != "scene units":
        scale = f"1 scene unit is {_number(factor)} {unit}"
    cameras = ", ".join(found.camera_names) or "none"
    return [
        f"{len(found.bodies)} part{'' if len(found.bodies) == 1 else 's'}, {vertices:,} vertices",
        f"scale: {scale}; metres are {'' if found.unit_scale_m else 'not '}known",
        f"looked at: ({_place(found.centre)}), radius {_number(found.radius)} scene units",
        f"cameras of the file: {cameras}",
    ]


def _table(bodies: Sequence[Body]) -> list[str]:
    rows = [("part", "vertices", "box from", "to (scene units)", "vertex groups")]
    for body in bodies:
        low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
        groups = [name if weights.any() else f"{name} (empty)" for name, weights in body.groups.items()]
        row = (
            body.name, f"{len(body.vertices):,}", f"({_place(low)})", f"({_place(high)})", ", ".join(groups),
        )  # fmt: skip
        rows.append(row)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def _modes(settings: Settings, found: Found) -> list[str]:
    """Each mode's largest displacement in scene units, in the file's own unit and in pixels."""
    cameras = settings.cameras.placed(found.centre, found.radius, found.cameras)
    settings = framed(replace(settings, cameras=cameras), found.bodies)
    motion = motion_of(settings, found.bodies)
    lines = []
    for k, mode in enumerate(settings.motion.modes):
        most = max(float(reach(shape[k]).max(initial=0.0)) for shape in motion.shapes)
        per = " per second" if mode.frequency_hz == 0 else ""
        lines.append(
            f"mode {mode.name}: {mode.frequency_hz:g} Hz, up to {amplitude_text(most, found.own_unit)}{per}"
        )
    return lines


def amplitude_text(length: float, own_unit: tuple[str, float]) -> str:
    """A length in scene units, and in the file's own unit where it has another: "0.005 scene units = 1.2 mm"."""
    unit, factor = own_unit
    text = f"{_number(length)} scene units"
    return text if unit == "scene units" else f"{text} = {_number(length * factor)} {unit}"


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _place(position: Sequence[float] | np.ndarray) -> str:
    return ", ".join(_number(round(float(x), 6) + 0.0) for x in position)
