"""From what a person chose in Blender to what the probe read there; the result is kept on the splat object."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bmesh
import bpy
import numpy as np

from tg4mm.core.errors import Tg4mmError

from .. import compat, names
from ..nodes import drawing, scene
from ..nodes.points import gaussians, values, world
from .probe import Probe, mean_deviation, mean_phasor


class PickError(Tg4mmError):
    """Nothing to probe, in one line that says what to do."""


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


def probe_cursor(obj: Any, cursor: Sequence[float]) -> Probe:
    """Probe the Gaussian whose rest position is nearest to a place in the world, of those that are drawn."""
    modifier = scene.splat_modifier(obj)
    faintest = drawing.least_opacity(compat.get_input(modifier, names.DRAW))
    with _readable(obj) as mesh:
        shown = np.flatnonzero(values(mesh, names.OPACITY) >= compat.get_input(modifier, faintest))
        if not len(shown):
            raise PickError(
                f"No Gaussian is as opaque as {faintest}, {compat.get_input(modifier, faintest):g}"
            )
        away = world(obj, mesh)[shown] - np.asarray(cursor, float)
        return _read(obj, mesh, shown[[np.argmin((away**2).sum(axis=1))]])


def probe_spheres(obj: Any, spheres: Sequence[Any]) -> Probe:
    """Probe the Gaussians whose rest positions are inside any of the empties, each as large as it is drawn."""
    if not spheres:
        raise PickError("No sphere is there: add one with the button beside, and move it over the region")
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
    """The selected sphere empties; without one, the probe spheres that were made for the object."""
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
    """Keep a probe's reading on its object."""
    pairs = np.stack([probe.phasors.real, probe.phasors.imag], axis=-1)
    forget(obj)
    obj[names.PROBE_PHASORS], obj[names.PROBE_LABEL] = pairs.ravel().tolist(), probe.label
    if probe.deviations is not None:
        obj[names.PROBE_DEVIATIONS] = probe.deviations.tolist()


def forget(obj: Any) -> None:
    """Remove a reading."""
    for name in (names.PROBE_PHASORS, names.PROBE_LABEL, names.PROBE_DEVIATIONS):
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
    return _probe(obj, obj[names.PROBE_LABEL], phasors, deviations if len(deviations) == len(freqs) else None)


def _probe(obj: Any, label: str, phasors: np.ndarray, deviations: np.ndarray | None) -> Probe:
    freqs = np.array(obj[names.FREQUENCIES], np.float64)
    axes = np.array(obj[names.MODE_AXES], np.float64).reshape(-1, 3)
    return Probe(label, freqs, phasors, axes, float(obj[names.FPS]), int(obj[names.TIMESTEPS]), deviations)


def _read(obj: Any, mesh: Any, indices: np.ndarray) -> Probe:
    if not len(obj[names.FREQUENCIES]):
        raise PickError(f"{obj.name} holds no motion")
    phasors = []
    for k in range(len(obj[names.FREQUENCIES])):
        part = names.phasor(k)
        phasors.append(values(mesh, part["re"])[indices] + 1j * values(mesh, part["im"])[indices])
    opacities = values(mesh, names.OPACITY)[indices]
    label = f"Point {indices[0]}" if len(indices) == 1 else f"{len(indices):,} points"
    return _probe(
        obj, label, mean_phasor(np.array(phasors), opacities), _deviations(mesh, indices, opacities)
    )


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
