"""The sidebar of the 3D view, tab TG4MM: import, motion, band, look of the active splat object."""

import textwrap
from typing import Any

import bpy

from .. import compat, names, preferences
from ..declare import TAB, Declared, on_motion, on_splats
from ..nodes import axes, blending, changes, clock, drawing, scene
from ..nodes.shapes import DRAW_MODES
from . import analysis, colour_range, look, overlay, pictures

_ui = Declared()


@_ui.panel(TAB, "TG4MM")
def draw_head(layout: Any, context: Any) -> None:
    """Moving splats"""
    obj = scene.splat_object(context)
    if untried := compat.untried():
        layout.label(text=untried, icon="INFO")
    if obj is None:
        layout.operator("import_scene.tg4mm_splat", text="Import Splats", icon="IMPORT")
        layout.label(text="Select imported splats", icon="INFO")
        return
    for warning in getattr(scene.splat_modifier(obj), "node_warnings", ()):
        box = layout.column(align=True)
        box.alert = True
        for line in textwrap.wrap(warning.message, 34):
            box.label(text=line)
    row = layout.row()
    row.label(text=obj.name, icon="POINTCLOUD_DATA")
    row.operator("import_scene.tg4mm_splat", text="Import", icon="IMPORT")
    if differ := analysis.units_differ(obj, context.scene):
        layout.label(text=differ, icon="INFO")
        layout.operator("tg4mm.file_units", icon="DRIVER_DISTANCE")


@_ui.panel("VIEW3D_PT_tg4mm_motion", "Motion", on_splats, TAB)
def draw_motion(layout: Any, context: Any) -> None:
    """Magnification and time of the active splat object"""
    obj = scene.splat_object(context)
    modifier = scene.splat_modifier(obj)
    if not compat.has_input(modifier, names.FIRST):
        layout.label(text="This file contains no motion", icon="INFO")
        return
    _draw_all(_fields(layout), modifier, names.ALPHA, names.SPEED, names.FIRST)
    _draw_all(layout, modifier, names.LOOP)
    for line in clock.not_finite(modifier):
        row = layout.row()
        row.alert = True
        row.label(text=line, icon="ERROR")
    for line in clock.lines(context.scene, obj, modifier):
        layout.label(text=line)


@_ui.panel("VIEW3D_PT_tg4mm_band", "Band", on_motion, TAB)
def draw_band(layout: Any, context: Any) -> None:
    """The magnified frequency band, on the file's spectrum"""
    obj, row = scene.splat_object(context), layout.split(factor=0.72)
    pictures.draw(row, 0.72 * pictures.fitting_width(context), *analysis.spectrum_picture(context, obj))
    peaks = row.column(align=True)
    for frequency in analysis.peaks(obj):
        peaks.operator("tg4mm.band", text=f"{frequency:.4g} Hz").frequency = frequency
    peaks.operator("tg4mm.band", text="All").frequency = 0.0
    column, modifier = _fields(layout), scene.splat_modifier(obj)
    compat.draw_input(column, modifier, names.LOW, text="Low (Hz)")
    compat.draw_input(column, modifier, names.HIGH, text="High (Hz)")


@_ui.panel("VIEW3D_PT_tg4mm_frequencies", "Frequencies", on_motion, "VIEW3D_PT_tg4mm_band", closed=True)
def draw_frequencies(layout: Any, context: Any) -> None:
    """The modes that are played, and the statistic that the spectrum shows"""
    obj = scene.splat_object(context)
    layout.label(text="Played")
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True)
    _draw_all(grid, scene.splat_modifier(obj), *names.toggles(obj[names.FREQUENCIES]))
    layout.label(text="Shown above")
    layout.row().prop(overlay.of(context), "measure", expand=True)


@_ui.panel("VIEW3D_PT_tg4mm_look", "Look", on_splats, TAB)
def draw_look(layout: Any, context: Any) -> None:
    """Shapes and colours of the active splat object"""
    obj = scene.splat_object(context)
    modifier = scene.splat_modifier(obj)
    _draw_all(_fields(layout), modifier, names.DRAW, names.COLOUR_BY)
    _draw_colour_range(layout, context, obj)
    drawn = DRAW_MODES[compat.get_input(modifier, names.DRAW)]
    _draw_all(_fields(layout), modifier, *drawn.inputs)
    if drawn.still:  # as long as the motion
        layout.label(text="No arrows? Raise Magnification", icon="INFO")
    on, shading = compat.get_input(modifier, names.SOLID_COLOUR), _shading(context)
    if not drawn.native and (on or shading == "SOLID"):  # else the colours are seen anyway
        layout.operator("tg4mm.solid_colours", icon="SHADING_SOLID", depress=on).on = not on
    if blind := _modifiers_after(obj):
        layout.label(text=f"{', '.join(blind)}: works on meshes only", icon="INFO")
        layout.operator("tg4mm.one_mesh", icon="MESH_DATA")
    if drawn.soft and not drawn.native and names.LOW_PASS not in obj:
        column = layout.column(align=True)
        column.label(text="No low-pass in this file:", icon="INFO")
        column.label(text="thin parts may show gaps", icon="BLANK1")
    on = look.is_exact(obj)
    layout.operator("tg4mm.exact_look", icon="SHADING_RENDERED", depress=on).on = not on
    on = blending.blends_as_trained(context.scene)
    if on or drawn.soft:
        layout.operator("tg4mm.blend_as_trained", icon="OVERLAY", depress=on).on = not on
    if not blending.is_set_up(context.scene):
        layout.operator("tg4mm.true_colours", icon="COLOR")
    if drawn.native:
        _draw_far_out(layout, obj)


@_ui.panel("VIEW3D_PT_tg4mm_details", "Size and Opacity", on_splats, "VIEW3D_PT_tg4mm_look", closed=True)
def draw_details(layout: Any, context: Any) -> None:
    """Sizes, opacity limits, and view-dependent colours"""
    modifier, column = scene.splat_modifier(scene.splat_object(context)), _fields(layout)
    name = compat.get_input(modifier, names.DRAW)
    drawn = DRAW_MODES[name]
    _draw_all(column, modifier, names.SIZE)
    if drawn.sized:
        compat.draw_input(column, modifier, names.RADIUS, text="Radius (σ)")
    if not drawn.native:  # Blender draws all of its own, each in its colours for the view
        compat.draw_input(column, modifier, drawing.least_opacity(name), text="Min Opacity")
    painted = not drawn.native or compat.get_input(modifier, names.BLEND)
    if painted and compat.has_input(modifier, names.VIEW_COLOUR):
        compat.draw_input(column, modifier, names.VIEW_COLOUR, text="View Colours")


@_ui.panel("VIEW3D_PT_tg4mm_import", "Changed by Import", on_splats, TAB, order=9)
def draw_import(layout: Any, context: Any) -> None:
    """Settings that the import changed in this scene, and the up axis of the file"""
    obj = scene.splat_object(context)
    changed = changes.listed(context.scene)
    # What stays, then what can be restored.
    for lines in (str(obj.get(names.NOTES, "")).splitlines(), changed):
        column = layout.column(align=True)
        for line in lines:
            for part in textwrap.wrap(line, 38):
                column.label(text=part)
    if changed:
        layout.operator("tg4mm.restore_picture", icon="LOOP_BACK")
    row = layout.row(align=True)
    row.label(text="Up Axis")
    for up, label in axes.LABELS.items():
        row.operator("tg4mm.up", text=label, depress=obj.get(names.AXES, axes.FILE) == up).axes = up


def _draw_colour_range(layout: Any, context: Any, obj: Any) -> None:
    """Draw the settings of colouring by amplitude or phase; nothing for the file's colours."""
    picture = analysis.legend_picture(obj, preferences.unit_for(context, obj), context.scene)
    if picture is None:
        return
    row, view = _fields(layout).row(align=True), overlay.of(context)
    colour_range.draw(row, context, obj)
    row.operator("tg4mm.fit_colour_range", text="", icon="FULLSCREEN_EXIT")
    layout.prop(view, "legend")
    if not view.legend:
        pictures.draw(layout, pictures.fitting_width(context), *picture)


def _draw_far_out(layout: Any, obj: Any) -> None:
    far, span = look.far_out(obj)
    if not far:
        return
    column = layout.column(align=True)
    column.label(text=f"{far:,} far out: {span:.2g} × its size", icon="ERROR")
    column.label(text="Stray Gaussians reduce position precision")
    if hasattr(bpy.types, "TG4MM_OT_crop_outliers"):
        column.operator("tg4mm.crop_outliers")


def _fields(layout: Any) -> Any:
    column = layout.column(align=True)
    column.use_property_split = True
    return column


def _modifiers_after(obj: Any) -> list[str]:
    """Return the names of later modifiers that only see meshes while ours outputs instances or points."""
    ours = scene.splat_modifier(obj)
    if ours is None or compat.get_input(ours, names.SOLID_COLOUR):
        return []
    after = list(obj.modifiers)[obj.modifiers.find(ours.name) + 1 :]
    return [other.name for other in after if other.type != "NODES"]


def _shading(context: Any) -> str | None:
    shading = getattr(getattr(context, "space_data", None), "shading", None)
    return None if shading is None else str(shading.type)


def _draw_all(layout: Any, modifier: Any, *inputs: str) -> None:
    for name in inputs:
        if compat.has_input(modifier, name):
            compat.draw_input(layout, modifier, name, slider=name == names.ALPHA)


register, unregister = _ui.register, _ui.unregister
