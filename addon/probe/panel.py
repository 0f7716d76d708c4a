"""The panel Probe: the motion of a point or a region in numbers, and over time."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from .. import preferences
from ..nodes import clock, scene
from ..panels import pictures, plots
from ..panels.panel import _MotionTab
from ..units import Unit
from . import picking, probe

MOST_ROWS = 4
SMALLEST = 0.01  # of the largest amplitude: what is below has no row
PER_TIMESTEP = 8  # samples of the curve

Phasors = tuple[complex, ...]  # hashable, x y z of each mode


class VIEW3D_PT_tg4mm_probe(_MotionTab, bpy.types.Panel):
    """The motion that was measured at a point or in a region"""

    bl_label = "Probe"
    bl_idname = "VIEW3D_PT_tg4mm_probe"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        layout, obj = self.layout, scene.splat_object(context)
        column = layout.column(align=True)
        for source, text, icon in (
            ("SELECTION", "Selected Points", "VERTEXSEL"),
            ("CURSOR", "At 3D Cursor", "PIVOT_CURSOR"),
        ):
            column.operator("tg4mm.probe", text=text, icon=icon).source = source
        row = column.row(align=True)
        row.operator("tg4mm.probe", text="In Sphere", icon="SPHERE").source = "SPHERE"
        row.operator("tg4mm.add_probe_sphere", text="", icon="ADD")
        found = picking.stored(obj)
        if found is None:
            layout.label(text="Nothing probed yet", icon="INFO")
            return
        unit = preferences.unit_for(context, obj)
        column = layout.column(align=True)
        column.label(text=f"{found.label}: actual motion")
        column.label(text="not magnified, α = 0")
        picture = curve_picture(found, unit, time_part(context, obj, found))
        pictures.draw(layout, pictures.fitting_width(context), *picture)
        row = layout.row(align=True)
        row.operator("tg4mm.export_probe", text="Series CSV", icon="EXPORT").content = "SERIES"
        row.operator("tg4mm.export_probe", text="Table CSV", icon="EXPORT").content = "PHASORS"
        _draw_rows(layout, found, unit)


def shown_ellipses(found: probe.Probe) -> tuple[list[probe.Ellipse], int]:
    """Those that have a row, the largest, by frequency; and how many have none."""
    every = probe.ellipses(found)
    least = SMALLEST * max(e.amplitude for e in every)
    large = sorted((e for e in every if e.amplitude >= least), key=lambda e: -e.amplitude)[:MOST_ROWS]
    return sorted(large, key=lambda e: e.frequency_hz), len(every) - len(large)


def row_texts(ellipse: probe.Ellipse, unit: Unit) -> tuple[str, str, str, str, str]:
    """Frequency, amplitude, phase; direction; second axis."""
    second = "0: moves along a line"
    if ellipse.second > 0:
        second = f"{unit.number(ellipse.second)}, {_direction(ellipse.second_direction)}"
    return (
        f"{ellipse.frequency_hz:g} Hz",
        unit.text(ellipse.amplitude, ellipse.deviation),
        f"{ellipse.phase_deg:.0f}°",
        f"along {_direction(ellipse.direction)}",
        second,
    )


def curve_picture(found: probe.Probe, unit: Unit, part: float) -> tuple[Any, ...]:
    """The function that draws the displacement over time with the current frame, and its arguments."""
    phasors = tuple(complex(value) for value in found.phasors.ravel())
    freqs = tuple(float(f) for f in found.freqs_hz)
    return marked_curve, freqs, phasors, found.fps, found.n_timesteps, unit, round(part, 3)


def marked_curve(
    freqs: tuple[float, ...], phasors: Phasors, fps: float, n_timesteps: int, unit: Unit, part: float
) -> np.ndarray:
    """The picture; the curve is kept, so that a new frame costs only its line."""
    return plots.mark_time(_curve(freqs, phasors, fps, n_timesteps, unit), part)


def time_part(context: Any, obj: Any, found: probe.Probe) -> float:
    """Where in the recording the current frame is: 0 its first timestep, 1 its last."""
    modifier = scene.splat_modifier(obj)
    return clock.timestep(context.scene, obj, modifier) / max(found.n_timesteps - 1, 1)


@lru_cache(maxsize=8)
def _curve(
    freqs: tuple[float, ...], phasors: Phasors, fps: float, n_timesteps: int, unit: Unit
) -> np.ndarray:
    values = np.array(phasors).reshape(-1, 3)
    read = probe.Probe("", np.array(freqs), values, np.zeros((len(freqs), 3)), fps, n_timesteps)
    if n_timesteps > 4 * plots.SIDE:  # more than can be told apart
        return plots.series(*probe.envelope(read, plots.SIDE), unit)
    return plots.series(*probe.series(read, min(PER_TIMESTEP, 4 * plots.SIDE // n_timesteps)), unit)


def _draw_rows(layout: Any, found: probe.Probe, unit: Unit) -> None:
    rows, left_out = shown_ellipses(found)
    for ellipse in rows:
        frequency, amplitude, phase, direction, second = row_texts(ellipse, unit)
        column = layout.box().column(align=True)
        split = column.row()
        split.label(text=frequency)
        split.label(text=phase)
        column.label(text=amplitude)
        column.label(text=direction)
        column.label(text=f"2nd {second}")
    if left_out:
        layout.label(text=f"{left_out} more in the table CSV")


def _direction(vector: tuple[float, float, float]) -> str:
    # Adding 0.0 makes of −0.0 a plain 0.
    return "({:.2f}, {:.2f}, {:.2f})".format(*(round(c, 2) + 0.0 for c in vector))


register, unregister = bpy.utils.register_classes_factory([VIEW3D_PT_tg4mm_probe])
