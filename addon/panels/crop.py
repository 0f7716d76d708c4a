"""The panel Crop and Export and its operators: boxes, selection, floaters, export, mesh."""

from collections.abc import Callable
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty

from tg4mm.core.errors import Tg4mmError

from ..declare import TAB, Declared, on_splats
from ..nodes import drawing, points, scene
from . import cropping

_ui = Declared()


def _remove(context: Any, choose: Callable[[Any], cropping.Choice]) -> str:
    """Remove Gaussians of the active splat object, in Edit Mode too; `choose(obj)` is asked in Object Mode."""
    obj, edited = scene.splat_object(context), context.mode == "EDIT_MESH"
    if context.mode != "OBJECT":  # what is edited is written to the mesh when Edit Mode is left
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        context.view_layer.update()
        gone, left = cropping.remove(obj, choose(obj))
    finally:
        if edited:
            bpy.ops.object.mode_set(mode="EDIT")
    return f"{gone:,} Gaussians removed, {left:,} remain"


_WHAT = {"BOX": "inside the selected objects' boxes, else the crop box", "SELECTION": "selected in Edit Mode"}


def _about_crop(context: Any, properties: Any) -> str:
    return f"{'Keep only' if properties.keep else 'Delete'} what is {_WHAT[properties.by]}. {crop.__doc__}"


_BY = [
    ("BOX", "Box", "The boxes of the selected objects, else the crop box"),
    ("SELECTION", "Selection", "The points selected in Edit Mode"),
]
_KEEP = BoolProperty(name="Keep", description="Keep what is inside or selected; else delete it", default=True)


@_ui.operator("Crop", on_splats, about=_about_crop, by=EnumProperty(name="By", items=_BY), keep=_KEEP)
def crop(operator: Any, context: Any) -> str:
    """Crop by rest position: removed Gaussians stay removed at every magnification and time"""

    def choose(obj: Any) -> cropping.Choice:
        if operator.by == "SELECTION":
            return cropping.not_selected(obj, selected=not operator.keep)
        boxes = cropping.boxes_of(obj, context.selected_objects)
        return cropping.outside(obj, boxes, inside=not operator.keep)

    return _remove(context, choose)


_LIMITS = [
    ("OPACITY", "Opacity", "Less opaque than the limit"),
    ("SIZE", "Size", "Larger than this multiple of the median Gaussian, by the longest axis"),
    ("DISTANCE", "Distance", "Farther from the centre than this multiple of the framed radius"),
]


def _draw_floaters(operator: Any, context: Any) -> None:
    operator.layout.use_property_split = True
    operator.layout.prop(operator, "by")
    operator.layout.prop(operator, operator.by.lower())


@_ui.operator(
    "Remove Floaters", on_splats, draw=_draw_floaters, by=EnumProperty(name="By", items=_LIMITS),
    opacity=FloatProperty(name="Opacity Below", default=0.05, min=0.0, max=1.0),
    size=FloatProperty(name="Median Sizes", default=10.0, min=1.0),
    distance=FloatProperty(name="Radii", default=3.0, min=1.0),
)  # fmt: skip
def remove_floaters(operator: Any, context: Any) -> str:
    """Remove Gaussians that are faint, oversized, or far from the rest; the limit is in the settings"""
    choices: dict[str, Callable[[Any], cropping.Choice]] = {
        "OPACITY": lambda obj: cropping.faint(operator.opacity),
        "SIZE": lambda obj: cropping.large(operator.size),
        "DISTANCE": lambda obj: cropping.far(obj, operator.distance),
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
    points.choose_alone(context, cropping.add_box(scene.splat_object(context), points.receiving(context)))


@_ui.operator("Make Mesh", _on_object)
def make_mesh(operator: Any, context: Any) -> str:
    """Convert the shapes drawn in this frame to a separate mesh object, for other programs"""
    try:
        made = cropping.make(scene.splat_object(context), points.receiving(context), context)
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
