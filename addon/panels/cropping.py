"""Cropping by boxes and limits, and the conversion of the drawn shapes to a mesh.

What goes is deleted from the mesh, by its rest position, so it stays away at every magnification and time. The
references of Apply Transform (nodes/points.py) stay.
"""

from collections.abc import Callable, Sequence
from typing import Any

import bmesh
import bpy
import numpy as np

from tg4mm.core.errors import Tg4mmError

from .. import compat, names
from ..nodes import points, scene
from . import framing

ROOM = 1.2  # of what is framed: how large a new box is
Choice = Callable[[Any], np.ndarray]  # of a mesh: [N] bool, which of its Gaussians go


def boxes_of(obj: Any, selected: Sequence[Any]) -> list[Any]:
    """Return the selected objects other than splats or, if there are none, the object's crop boxes.

    Raises Tg4mmError where there is none.
    """
    chosen = [other for other in selected if other != obj and names.MARK not in other]
    chosen = chosen or [other for other in bpy.data.objects if other.get(names.CROP_OF) == obj]
    if not chosen:
        raise Tg4mmError("No crop box: add one with the button beside, or select an object as the box")
    return chosen


def outside(obj: Any, boxes: Sequence[Any], inside: bool = False) -> Choice:
    """Return the mask of Gaussians that rest outside all boxes; with `inside`, in any of them."""
    frames = [(np.array(box.matrix_world.inverted_safe()), *_extent(box)) for box in boxes]

    def choice(mesh: Any) -> np.ndarray:
        world = points.world(obj, mesh)
        held = np.zeros(len(world), bool)
        for inverse, low, high, is_round in frames:
            local = world @ inverse[:3, :3].T + inverse[:3, 3]
            within = (
                np.linalg.norm(local, axis=1) <= high[0]
                if is_round
                else ((local >= low) & (local <= high)).all(1)
            )
            held |= within
        return held if inside else ~held

    return choice


def not_selected(obj: Any, selected: bool = False) -> Choice:
    """Return the mask of Gaussians not selected in Edit Mode; with `selected`, of the selected. Raises Tg4mmError."""
    if scene.sequence_frames(obj) is not None:
        raise Tg4mmError(f"{obj.name} is a sequence, whose points cannot be selected: crop by a box")

    def choice(mesh: Any) -> np.ndarray:
        flags = np.empty(len(mesh.vertices), bool)
        mesh.vertices.foreach_get("select", flags)
        flags = flags[points.gaussians(mesh)]
        if not flags.any():
            raise Tg4mmError("No point is selected: enter Edit Mode (Tab) and box-select some")
        return flags if selected else ~flags

    return choice


def faint(opacity: float) -> Choice:
    """Return the mask of Gaussians below an opacity."""
    return lambda mesh: points.values(mesh, names.OPACITY) < opacity


def large(times: float) -> Choice:
    """Return the mask of Gaussians larger than a multiple of the median, by the longest axis."""

    def choice(mesh: Any) -> np.ndarray:
        sizes = points.values(mesh, names.SCALE).max(axis=1)
        return sizes > times * np.median(sizes)

    return choice


def far(obj: Any, radii: float) -> Choice:
    """Return the mask of Gaussians farther from the centre than a multiple of the framed radius."""
    low, high = framing.box([obj])
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    return lambda mesh: np.linalg.norm(points.world(obj, mesh) - middle, axis=1) > radii * radius


def remove(obj: Any, choice: Choice) -> tuple[int, int]:
    """Remove the chosen Gaussians, in every frame of a sequence; return the counts removed and remaining.

    Raises Tg4mmError, and changes nothing, where none would be left or the mesh is another file's.
    """
    frames = scene.sequence_frames(obj)
    meshes = [obj.data] if frames is None else [frame.data for frame in frames]
    if linked := [mesh for mesh in meshes if not mesh.is_editable]:
        raise Tg4mmError(
            f"{obj.name}: the mesh is linked from {linked[0].library.filepath}: make it local first"
        )
    dropped = [choice(mesh) for mesh in meshes]
    gone, total = sum(int(d.sum()) for d in dropped), sum(len(d) for d in dropped)
    if any(d.all() for d in dropped):
        raise Tg4mmError(
            f"None of {total:,} Gaussians would be left{'' if frames is None else ' in a frame'}"
        )
    for mesh, drop in zip(meshes, dropped, strict=True):
        if drop.any():
            _delete(mesh, np.flatnonzero(points.gaussians(mesh))[drop])
    if gone and frames is None:
        scene.measure_modes(obj)
    return gone, total - gone


def add_box(obj: Any, collection: Any) -> Any:
    """Add a box-shaped empty around the framed part of the object."""
    low, high = framing.box([obj])
    box = bpy.data.objects.new(f"{obj.name} crop", None)
    box.empty_display_type, box.empty_display_size = "CUBE", 1.0
    box.location, box.scale = ((low + high) / 2).tolist(), np.maximum(ROOM * (high - low) / 2, 1e-6).tolist()
    box.show_in_front = True
    box[names.CROP_OF] = obj
    collection.objects.link(box)
    return box


def _delete(mesh: Any, rows: np.ndarray) -> None:
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        edited.verts.ensure_lookup_table()
        bmesh.ops.delete(edited, geom=[edited.verts[i] for i in rows.tolist()], context="VERTS")
        edited.to_mesh(mesh)
    finally:
        edited.free()
    mesh.update()


def _extent(box: Any) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the lowest and highest corner [3] in local axes, and whether the object is a ball."""
    if box.type == "EMPTY":
        size = np.full(3, box.empty_display_size)
        return -size, size, box.empty_display_type == "SPHERE"
    corners = np.array(box.bound_box)
    return corners.min(axis=0), corners.max(axis=0), False


def modifiers_after(obj: Any) -> list[str]:
    """Return the names of later modifiers that only see meshes while ours outputs instances or points."""
    ours = scene.splat_modifier(obj)
    if ours is None or compat.get_input(ours, names.SOLID_COLOUR):
        return []
    after = list(obj.modifiers)[obj.modifiers.find(ours.name) + 1 :]
    return [other.name for other in after if other.type != "NODES"]


def make(obj: Any, collection: Any, context: Any) -> Any:
    """Create an object with a mesh of the shapes drawn in the current frame, at the same transform."""
    modifier = scene.splat_modifier(obj)
    before = compat.get_input(modifier, names.SOLID_COLOUR)
    compat.set_input(modifier, names.SOLID_COLOUR, True)
    try:
        depsgraph = context.evaluated_depsgraph_get()
        depsgraph.update()
        evaluated = obj.evaluated_get(depsgraph)
        mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
    finally:
        compat.set_input(modifier, names.SOLID_COLOUR, before)
    _drop_loose(mesh)  # the points themselves
    made = bpy.data.objects.new(f"{obj.name} mesh", mesh)
    made.matrix_world = obj.matrix_world
    collection.objects.link(made)
    return made


def _drop_loose(mesh: Any) -> None:
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        loose = [vertex for vertex in edited.verts if not vertex.link_edges]
        bmesh.ops.delete(edited, geom=loose, context="VERTS")
        edited.to_mesh(mesh)
    finally:
        edited.free()
