"""The panel Crop and Export: boxes, selection, floaters, export, and the drawn shapes as a mesh.

What goes is deleted from the mesh, by its rest position, so it stays away at every magnification and time. The
references of Apply Transform (nodes/points.py) stay.
"""

from collections.abc import Callable, Sequence
from typing import Any

import bmesh
import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty

from tg4mm.core.errors import Tg4mmError

from .. import compat, names
from ..declare import TAB, Declared, on_splats
from ..nodes import drawing, points, scene
from . import framing

ROOM = 1.2  # of what is framed: how large a new box is
Choice = Callable[[Any], np.ndarray]  # of a mesh: [N] bool, which of its Gaussians go
_WHAT = {"BOX": "inside the selected objects' boxes, else the crop box", "SELECTION": "selected in Edit Mode"}

_BY = [
    ("BOX", "Box", "The boxes of the selected objects, else the crop box"),
    ("SELECTION", "Selection", "The points selected in Edit Mode"),
]
_KEEP = BoolProperty(name="Keep", description="Keep what is inside or selected; else delete it", default=True)

_LIMITS = [
    ("OPACITY", "Opacity", "Less opaque than the limit"),
    ("SIZE", "Size", "Larger than this multiple of the median Gaussian, by the longest axis"),
    ("DISTANCE", "Distance", "Farther from the centre than this multiple of the framed radius"),
]


def boxes_of(obj: Any, selected: Sequence[Any]) -> list[Any]:
    """Return the selected objects other than splats or, if there are none, the object's crop boxes.

    Raises Tg4mmError where there is none.
    """
    chosen = [other for other in selected if other != obj and names.MARK not in other]
    chosen = chosen or [other for other in bpy.data.objects if other.get(names.CROP_OF) == obj]
    if not chosen:
        raise Tg4mmError("No crop box: add one with the button beside it, or select an object as the box")
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
            _delete(mesh, np.flatnonzero(points.gaussians(mesh))[drop].tolist())
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


def _delete(mesh: Any, rows: Sequence[int] | None = None) -> None:
    """Delete the vertices with these numbers; by default those without an edge."""
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        edited.verts.ensure_lookup_table()
        loose = (vertex for vertex in edited.verts if not vertex.link_edges)
        gone = [*loose] if rows is None else [edited.verts[i] for i in rows]
        bmesh.ops.delete(edited, geom=gone, context="VERTS")
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
    _delete(mesh)  # the points themselves
    made = bpy.data.objects.new(f"{obj.name} mesh", mesh)
    made.matrix_world = obj.matrix_world
    collection.objects.link(made)
    return made


_ui = Declared()


def _remove(context: Any, choose: Callable[[Any], Choice]) -> str:
    """Remove Gaussians of the active splat object, in Edit Mode too; `choose(obj)` is asked in Object Mode."""
    obj, edited = scene.splat_object(context), context.mode == "EDIT_MESH"
    if context.mode != "OBJECT":  # what is edited is written to the mesh when Edit Mode is left
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        context.view_layer.update()
        gone, left = remove(obj, choose(obj))
    finally:
        if edited:
            bpy.ops.object.mode_set(mode="EDIT")
    return f"{gone:,} Gaussians removed, {left:,} remain"


def _about_crop(context: Any, properties: Any) -> str:
    return f"{'Keep only' if properties.keep else 'Delete'} what is {_WHAT[properties.by]}. {crop.__doc__}"


@_ui.operator("Crop", on_splats, about=_about_crop, by=EnumProperty(name="By", items=_BY), keep=_KEEP)
def crop(operator: Any, context: Any) -> str:
    """Crop by rest position: removed Gaussians stay removed at every magnification and time"""

    def choose(obj: Any) -> Choice:
        if operator.by == "SELECTION":
            return not_selected(obj, selected=not operator.keep)
        boxes = boxes_of(obj, context.selected_objects)
        return outside(obj, boxes, inside=not operator.keep)

    return _remove(context, choose)


def _draw_floaters(operator: Any, context: Any) -> None:
    operator.layout.use_property_split = True
    operator.layout.prop(operator, "by")
    operator.layout.prop(operator, operator.by.lower())


@_ui.operator(
    "Remove Floaters", on_splats, draw=_draw_floaters, by=EnumProperty(name="By", items=_LIMITS),
    opacity=FloatProperty(name="Opacity Below", default=0.05, min=0.0, max=1.0),
    size=FloatProperty(name="Larger Than (× Median)", default=10.0, min=1.0),
    distance=FloatProperty(name="Farther Than (× Radius)", default=3.0, min=1.0),
)  # fmt: skip
def remove_floaters(operator: Any, context: Any) -> str:
    """Remove Gaussians that are faint, oversized, or far from the rest; the limit is in the settings"""
    choices: dict[str, Callable[[Any], Choice]] = {
        "OPACITY": lambda obj: faint(operator.opacity),
        "SIZE": lambda obj: large(operator.size),
        "DISTANCE": lambda obj: far(obj, operator.distance),
    }
    return _remove(context, choices[operator.by])


@_ui.operator("Crop Far Outliers", on_splats)
def crop_outliers(operator: Any, context: Any) -> str:
    """Remove Gaussians so distant that all other positions lose precision in EEVEE and Workbench"""
    return _remove(context, lambda obj: drawing.outliers)


def _on_object(context: Any) -> bool:
    return on_splats(context) and bool(context.mode == "OBJECT")


@_ui.operator("Add Crop Box", _on_object)
def add_crop_box(operator: Any, context: Any) -> None:
    """Add a box around the splats; move, rotate and scale it over the region to keep or remove"""
    context.view_layer.update()
    points.choose_alone(context, add_box(scene.splat_object(context), points.receiving(context)))


@_ui.operator("Make Mesh", _on_object)
def make_mesh(operator: Any, context: Any) -> str:
    """Convert the shapes drawn in this frame to a separate mesh object, for other programs"""
    try:
        made = make(scene.splat_object(context), points.receiving(context), context)
    except MemoryError:
        raise Tg4mmError("Not enough memory for the mesh: crop, or draw as arrows") from None
    return f"{made.name}: {len(made.data.polygons):,} faces"


@_ui.panel("VIEW3D_PT_tg4mm_crop", "Crop and Export", on_splats, TAB, closed=True)
def draw_crop(layout: Any, context: Any) -> None:
    """Crop and export the active splat object"""
    obj = scene.splat_object(context)
    if scene.sequence_frames(obj) is None and obj.mode == "OBJECT":  # else the mesh is an old one
        layout.label(text=f"{points.gaussians(obj.data).sum():,} Gaussians", icon="POINTCLOUD_DATA")
    column = layout.column(align=True)
    for by, text in (("BOX", "Inside Box"), ("SELECTION", "Selected")):
        row = column.row(align=True)
        for keep, verb in ((True, "Keep"), (False, "Delete")):
            button = row.operator("tg4mm.crop", text=f"{verb} {text}")
            button.by, button.keep = by, keep
        if by == "BOX":
            row.operator("tg4mm.add_crop_box", text="", icon="ADD")
    layout.label(text="Floaters")
    row = layout.row(align=True)
    for by, text in (("OPACITY", "Faint"), ("SIZE", "Large"), ("DISTANCE", "Far")):
        row.operator("tg4mm.remove_floaters", text=text).by = by
    row = layout.row(align=True)
    row.operator("export_scene.tg4mm_splat", text="Export", icon="EXPORT")
    row.operator("tg4mm.make_mesh", icon="MESH_DATA")


register, unregister = _ui.register, _ui.unregister
