"""The probe's selection, its reading, which is stored on the splat object, and its panel."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import bmesh
import bpy
import numpy as np

from tg4mm.core.errors import Tg4mmError

from .. import compat, names, preferences
from ..declare import TAB, Declared, on_motion
from ..nodes import clock, drawing, points, scene
from ..nodes.points import gaussians, shown_size, values, world
from ..nodes.shapes import DRAW_MODES
from ..panels import analysis, framing, pictures, plots
from ..units import Unit
from . import probe
from .probe import Probe, mean_deviation, mean_phasor

SIGMAS, NEAR = 3.0, 0.05
MOST_ROWS = 4
SMALLEST = 0.01  # of the largest amplitude: what is below has no row
PER_TIMESTEP = 8  # samples of the curve


class PickError(Tg4mmError):
    """Raised when there is nothing to probe; the message says what to do."""


def probe_selection(obj: Any) -> Probe:
    """Probe the vertices that are selected, or were when Edit Mode was left. PickError if there are none."""
    with _readable(obj) as mesh:
        chosen = np.empty(len(mesh.vertices), bool)
        mesh.vertices.foreach_get("select", chosen)
        chosen = chosen[gaussians(mesh)]
        if not chosen.any():
            raise PickError(
                "No point is selected: enter Edit Mode (Tab) and click one, or box-select several"
            )
        return _read(obj, mesh, np.flatnonzero(chosen))


def shown_weights(scene_: Any, obj: Any) -> np.ndarray:
    """Return the complex weights [M] of the phasors that are shown in this frame: displacement = Σ_k Re[w_k m_k]."""
    modifier, magnified = scene.splat_modifier(obj), analysis.active_modes(obj)
    if DRAW_MODES[compat.get_input(modifier, names.DRAW)].still:
        return np.zeros(len(obj[names.FREQUENCIES]), complex)
    alpha = compat.get_number(modifier, names.ALPHA)
    played = [compat.get_input(modifier, name) for name in names.toggles(obj[names.FREQUENCIES])]
    gains = [on * (1 + alpha * (k in magnified)) for k, on in enumerate(played)]
    turns = np.array(obj[names.FREQUENCIES]) * clock.timestep(scene_, obj, modifier) / float(obj[names.FPS])
    return np.asarray(np.array(gains) * np.exp(2j * np.pi * turns))


def _drawn(scene_: Any, obj: Any, mesh: Any) -> np.ndarray:
    """[N, 3] float64: where the Gaussians are drawn in this frame, in the world."""
    moved = np.zeros_like(values(mesh, "position"), float)
    for k, weight in enumerate(shown_weights(scene_, obj)):
        mode = names.phasor(k)
        moved += weight.real * values(mesh, mode["re"]) - weight.imag * values(mesh, mode["im"])
    for part in points.parts(mesh):
        if part.applied is not None:
            moved[part.rows] = moved[part.rows] @ part.applied[:3, :3].T
    return np.asarray(world(obj, mesh) + moved @ np.array(obj.matrix_world)[:3, :3].T)


def probe_cursor(scene_: Any, obj: Any) -> Probe:
    """Probe the Gaussian that is drawn nearest to the 3D cursor in this frame.

    PickError where the cursor is outside of that Gaussian and farther from it than NEAR times the object's size.
    """
    modifier = scene.splat_modifier(obj)
    faintest = drawing.least_opacity(compat.get_input(modifier, names.DRAW))
    with _readable(obj) as mesh:
        shown = np.flatnonzero(values(mesh, names.OPACITY) >= compat.get_input(modifier, faintest))
        if not len(shown):
            raise PickError(
                f"No Gaussian is as opaque as {faintest}, {compat.get_input(modifier, faintest):g}"
            )
        away = np.linalg.norm(_drawn(scene_, obj, mesh)[shown] - np.array(scene_.cursor.location), axis=1)
        nearest = shown[np.argmin(away)]
        reach = SIGMAS * values(mesh, names.SCALE)[nearest].max() * shown_size(obj)
        low, high = framing.box([obj])
        if away.min() > max(reach, NEAR * float((high - low).max())):
            raise PickError(f"No Gaussian at the 3D cursor: the nearest is {away.min():.3g} units away")
        return _read(obj, mesh, np.array([nearest]))


def probe_spheres(obj: Any, spheres: Sequence[Any]) -> Probe:
    """Probe the Gaussians whose rest positions are inside any of the empties, each as large as it is drawn."""
    if not spheres:
        raise PickError("No probe sphere: add one with the button beside it, and move it over the region")
    with _readable(obj) as mesh:
        places = world(obj, mesh)
        places = np.column_stack([places, np.ones(len(places))])
        inside = np.zeros(len(places), bool)
        for sphere in spheres:
            local = places @ np.array(sphere.matrix_world.inverted_safe()).T
            inside |= np.linalg.norm(local[:, :3], axis=1) <= sphere.empty_display_size
        if not inside.any():
            raise PickError(f"No Gaussian's rest position is inside {', '.join(s.name for s in spheres)}")
        return _read(obj, mesh, np.flatnonzero(inside))


def spheres_of(obj: Any, selected: Sequence[Any]) -> list[Any]:
    """Return the selected sphere empties or, if there are none, the object's probe spheres."""
    chosen = [other for other in selected if other.type == "EMPTY" and other.empty_display_type == "SPHERE"]
    return chosen or [other for other in bpy.data.objects if other.get(names.PROBE_OF) == obj]


def add_sphere(obj: Any, collection: Any, place: Sequence[float]) -> Any:
    """A sphere empty for the probe of an object, a tenth of its size, at a place in the world."""
    sphere = bpy.data.objects.new(f"{obj.name} probe", None)
    sphere.empty_display_type = "SPHERE"
    corners = np.array(obj.bound_box)
    extent = float(
        np.linalg.norm(corners.max(axis=0) - corners.min(axis=0)) * max(obj.matrix_world.to_scale())
    )
    sphere.empty_display_size = max(0.05 * extent, 1e-4)
    sphere.location = place
    sphere.show_in_front = True
    sphere[names.PROBE_OF] = obj
    collection.objects.link(sphere)
    return sphere


def store(obj: Any, probe: Probe) -> None:
    """Store a probe's reading on its object."""
    pairs = np.stack([probe.phasors.real, probe.phasors.imag], axis=-1)
    forget(obj)
    obj[names.PROBE_PHASORS], obj[names.PROBE_LABEL] = pairs.ravel().tolist(), probe.label
    obj[names.PROBE_PLACE] = probe.place
    if probe.deviations is not None:
        obj[names.PROBE_DEVIATIONS] = probe.deviations.tolist()


def forget(obj: Any) -> None:
    """Remove a reading."""
    for name in (names.PROBE_PHASORS, names.PROBE_LABEL, names.PROBE_DEVIATIONS, names.PROBE_PLACE):
        if name in obj:
            del obj[name]


def stored(obj: Any) -> Probe | None:
    """The reading that is kept on the object; None without one, or if it is not of the object's modes."""
    freqs = list(obj.get(names.FREQUENCIES, ()))
    numbers = np.array(obj.get(names.PROBE_PHASORS, ()), np.float64)
    if not freqs or numbers.size != 6 * len(freqs):
        return None
    pairs = numbers.reshape(-1, 3, 2)
    deviations = np.array(obj.get(names.PROBE_DEVIATIONS, ()), np.float64)
    phasors = pairs[..., 0] + 1j * pairs[..., 1]
    place = tuple(obj.get(names.PROBE_PLACE, ()))
    return _probe(
        obj, obj[names.PROBE_LABEL], phasors, deviations if len(deviations) == len(freqs) else None, place
    )


def _probe(
    obj: Any, label: str, phasors: np.ndarray, deviations: np.ndarray | None, place: tuple[float, ...]
) -> Probe:
    freqs = np.array(obj[names.FREQUENCIES], np.float64)
    axes = np.array(obj[names.MODE_AXES], np.float64).reshape(-1, 3)
    fps, steps = float(obj[names.FPS]), int(obj[names.TIMESTEPS])
    return Probe(label, freqs, phasors, axes, fps, steps, deviations, place)


def _read(obj: Any, mesh: Any, indices: np.ndarray) -> Probe:
    if not len(obj[names.FREQUENCIES]):
        raise PickError(f"{obj.name} contains no motion")
    phasors = []
    for k in range(len(obj[names.FREQUENCIES])):
        part = names.phasor(k)
        phasors.append(values(mesh, part["re"])[indices] + 1j * values(mesh, part["im"])[indices])
    opacities = values(mesh, names.OPACITY)[indices]
    label = f"Point {indices[0]}" if len(indices) == 1 else f"{len(indices):,} points"
    place = values(mesh, "position")[indices].mean(axis=0, dtype=float)
    if (applied := points.applied(mesh)) is not None:
        place = np.linalg.solve(applied[:3, :3], place - applied[:3, 3])
    deviations = _deviations(mesh, indices, opacities)
    mean = mean_phasor(np.array(phasors), opacities)
    return _probe(obj, label, mean, deviations, tuple(place.tolist()))


def _deviations(mesh: Any, indices: np.ndarray, opacities: np.ndarray) -> np.ndarray | None:
    """[M] of the amplitudes, None where the file did not say them."""
    given: list[np.ndarray] = []
    while (name := names.deviation(len(given))) in mesh.attributes:
        given.append(values(mesh, name)[indices])
    return mean_deviation(np.array(given), opacities) if given else None


@contextmanager
def _readable(obj: Any) -> Iterator[Any]:
    """A mesh with the object's points: in Edit Mode, where the object's own cannot be read, a copy."""
    if obj.mode != "EDIT":
        yield obj.data
        return
    copy = bpy.data.meshes.new("TG4MM probe")
    try:
        bmesh.from_edit_mesh(obj.data).to_mesh(copy)
        yield copy
    finally:
        bpy.data.meshes.remove(copy)


Phasors = tuple[complex, ...]  # hashable, x y z of each mode


_ui = Declared()


@_ui.panel("VIEW3D_PT_tg4mm_probe", "Probe", on_motion, TAB, closed=True)
def draw_probe(layout: Any, context: Any) -> None:
    """The measured motion at a point or in a region"""
    obj, column = scene.splat_object(context), layout.column(align=True)
    column.operator("tg4mm.probe", text="Selected Points", icon="VERTEXSEL").source = "SELECTION"
    column.operator("tg4mm.probe", text="At 3D Cursor", icon="PIVOT_CURSOR").source = "CURSOR"
    row = column.row(align=True)
    row.operator("tg4mm.probe", text="In Sphere", icon="SPHERE").source = "SPHERE"
    row.operator("tg4mm.add_probe_sphere", text="", icon="ADD")
    found = stored(obj)
    if found is None:
        layout.label(text="Nothing probed yet", icon="INFO")
        return
    unit = preferences.unit_for(context, obj)
    column = layout.column(align=True)
    column.label(text=f"{found.label}: actual motion")
    column.label(text="as recorded, not magnified")
    picture = curve_picture(found, unit, time_part(context, obj, found))
    pictures.draw(layout, pictures.fitting_width(context), *picture)
    column = layout.column(align=True)
    column.operator("tg4mm.export_probe", text="Export Curve (CSV)", icon="EXPORT").content = "SERIES"
    column.operator("tg4mm.export_probe", text="Export Table (CSV)", icon="EXPORT").content = "PHASORS"
    _draw_rows(layout, found, unit)


def shown_ellipses(found: probe.Probe) -> tuple[list[probe.Ellipse], int]:
    """Those that have a row, the largest, by frequency; and how many have none."""
    every = probe.ellipses(found)
    least = SMALLEST * max(e.amplitude for e in every)
    large = sorted((e for e in every if e.amplitude >= least), key=lambda e: -e.amplitude)[:MOST_ROWS]
    return sorted(large, key=lambda e: e.frequency_hz), len(every) - len(large)


def row_texts(ellipse: probe.Ellipse, unit: Unit) -> tuple[str, str, str, str, str]:
    """Frequency, amplitude, phase; direction; second axis."""
    second = "moves along a straight line"
    if ellipse.second > 0:
        second = f"minor axis {unit.number(ellipse.second)}, {_direction(ellipse.second_direction)}"
    return (
        f"{ellipse.frequency_hz:g} Hz",
        unit.text(ellipse.amplitude, ellipse.deviation),
        f"phase {ellipse.phase_deg:.0f}°",
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
    """Return the position of the current frame in the recording: 0 is its first timestep, 1 its last."""
    modifier = scene.splat_modifier(obj)
    return clock.timestep(context.scene, obj, modifier) / max(found.n_timesteps - 1, 1)


@lru_cache(maxsize=8)
def _curve(
    freqs: tuple[float, ...], phasors: Phasors, fps: float, n_timesteps: int, unit: Unit
) -> np.ndarray:
    values = np.array(phasors).reshape(-1, 3)
    read = probe.Probe("", np.array(freqs), values, np.zeros((len(freqs), 3)), fps, n_timesteps)
    if n_timesteps > 4 * plots.SIDE:  # more than can be distinguished
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
        column.label(text=second)
    if any(ellipse.deviation is not None for ellipse in rows):
        layout.label(text="± one standard deviation")
    if left_out:
        layout.label(text=f"{left_out} more in the exported table")


def _direction(vector: tuple[float, float, float]) -> str:
    # Adding 0.0 makes of −0.0 a plain 0.
    return "({:.2f}, {:.2f}, {:.2f})".format(*(round(c, 2) + 0.0 for c in vector))


register, unregister = _ui.register, _ui.unregister
