"""The sidebar of the 3D view, tab TG4MM: import, motion, band, look, colours of the active splat object."""

from __future__ import annotations

from typing import Any

import bpy

from . import analysis, compat, names, pictures, plots, preferences, scene, spectrum, view_settings


class _Tab:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "TG4MM"


class _SplatTab(_Tab):
    """A panel that is there where a splat object is active; sub-panels name their parent."""

    bl_parent_id = "VIEW3D_PT_tg4mm"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None


class _MotionTab(_SplatTab):
    """A panel that is there where a splat object with modes of motion is active."""

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.moves(scene.splat_object(context))


class VIEW3D_PT_tg4mm(_Tab, bpy.types.Panel):
    """Splats that move"""

    bl_label = "TG4MM"
    bl_idname = "VIEW3D_PT_tg4mm"

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.operator("import_scene.tg4mm_splat", text="Import Splats", icon="IMPORT")
        obj = scene.splat_object(context)
        if obj is None:
            layout.label(text="Select imported splats", icon="INFO")
        else:
            layout.label(text=obj.name, icon="POINTCLOUD_DATA")


class VIEW3D_PT_tg4mm_motion(_SplatTab, bpy.types.Panel):
    """Magnification and time of the active splat object"""

    bl_label = "Motion"
    bl_idname = "VIEW3D_PT_tg4mm_motion"

    def draw(self, context: Any) -> None:
        layout, modifier = self.layout, scene.splat_modifier(scene.splat_object(context))
        layout.use_property_split = True
        if not (compat.has_input(modifier, names.FIRST)):
            layout.label(text="This file holds no motion", icon="INFO")
            return
        _draw_all(layout, modifier, names.ALPHA, names.SPEED, names.FIRST, names.LOOP)


class VIEW3D_PT_tg4mm_band(_MotionTab, bpy.types.Panel):
    """Which frequencies are magnified, beside the spectrum of the file"""

    bl_label = "Band"
    bl_idname = "VIEW3D_PT_tg4mm_band"

    def draw(self, context: Any) -> None:
        layout, obj = self.layout, scene.splat_object(context)
        modifier, view = scene.splat_modifier(obj), view_settings.of(context)
        pictures.draw(layout, pictures.fitting_width(context), *spectrum_picture(context, obj))
        layout.row().prop(view, "measure", expand=True)
        _draw_peaks(layout, obj)
        column = layout.column(align=True)
        column.use_property_split = True
        compat.draw_input(column, modifier, names.LOW, text="Low (Hz)")
        compat.draw_input(column, modifier, names.HIGH, text="High (Hz)")


class VIEW3D_PT_tg4mm_frequencies(_MotionTab, bpy.types.Panel):
    """Which modes are played at all"""

    bl_label = "Play Frequencies"
    bl_idname = "VIEW3D_PT_tg4mm_frequencies"
    bl_parent_id = "VIEW3D_PT_tg4mm_band"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        obj = scene.splat_object(context)
        grid = self.layout.grid_flow(row_major=True, columns=2, even_columns=True)
        _draw_all(grid, scene.splat_modifier(obj), *names.toggles(obj[names.FREQUENCIES]))


class VIEW3D_PT_tg4mm_look(_SplatTab, bpy.types.Panel):
    """How the active splat object is drawn"""

    bl_label = "Look"
    bl_idname = "VIEW3D_PT_tg4mm_look"

    def draw(self, context: Any) -> None:
        layout, modifier = self.layout, scene.splat_modifier(scene.splat_object(context))
        layout.use_property_split = True
        _draw_all(layout, modifier, names.DRAW, names.SIZE)
        drawn = compat.get_input(modifier, names.DRAW)
        if drawn in (names.ELLIPSOIDS, names.POINTS):
            compat.draw_input(layout, modifier, names.RADIUS, text="Radius (σ)")
        if drawn == names.ARROWS:
            _draw_all(layout, modifier, names.ARROW_LENGTH, names.ARROW_EVERY)
        faintest = names.MIN_SPLAT_OPACITY if drawn == names.SPLATS else names.MIN_OPACITY
        compat.draw_input(layout, modifier, faintest, text="Min Opacity")
        if compat.has_input(modifier, names.VIEW_COLOUR):
            compat.draw_input(layout, modifier, names.VIEW_COLOUR, text="View Colours")
        compat.draw_input(layout, modifier, names.SOLID_COLOUR, text="Solid Colours")
        layout.operator("tg4mm.solid_colours", icon="SHADING_SOLID")
        if context.scene.view_settings.view_transform != "Standard":
            layout.operator("tg4mm.true_colours", icon="COLOR")


class VIEW3D_PT_tg4mm_colours(_MotionTab, bpy.types.Panel):
    """Colours that show amplitude or phase"""

    bl_label = "Colour By"
    bl_idname = "VIEW3D_PT_tg4mm_colours"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context: Any) -> None:
        layout, obj = self.layout, scene.splat_object(context)
        modifier, unit = scene.splat_modifier(obj), preferences.unit_for(context, obj)
        layout.use_property_split = True
        compat.draw_input(layout, modifier, names.COLOUR_BY)
        picture = analysis.legend_picture(obj, unit)
        if picture is None:
            return
        compat.draw_input(layout, modifier, names.COLOUR_RANGE)
        layout.operator("tg4mm.fit_colour_range", icon="FULLSCREEN_EXIT")
        view = view_settings.of(context)
        row = layout.row()
        row.use_property_split = False  # else its name has half the width
        row.prop(view, "legend")
        if not view.legend:
            pictures.draw(layout, pictures.fitting_width(context), *picture)


def spectrum_picture(context: Any, obj: Any) -> tuple[Any, ...]:
    """The function that draws an object's spectrum, and its arguments."""
    measure = view_settings.of(context).measure
    freqs = tuple(float(f) for f in obj[names.FREQUENCIES])
    highest = spectrum.whole_band(freqs, float(obj[names.FPS]))[1]
    strengths = tuple(analysis.mode_strengths(obj, measure))
    title = {"RMS": "Rms", "PEAK": "Largest"}[measure]
    unit = preferences.unit_for(context, obj)
    return plots.spectrum, freqs, strengths, analysis.band(obj), highest, title, unit


def _draw_peaks(layout: Any, obj: Any) -> None:
    """A button for the band round each peak, and one for everything."""
    freqs = [float(f) for f in obj[names.FREQUENCIES]]
    grid = layout.grid_flow(row_major=True, columns=3, even_columns=True, align=True)
    for k in spectrum.peaks(freqs, analysis.mode_strengths(obj, "RMS")):
        grid.operator("tg4mm.band", text=f"{freqs[k]:g} Hz").frequency = freqs[k]
    grid.operator("tg4mm.band", text="All").frequency = 0.0


_CLASSES = (
    VIEW3D_PT_tg4mm,
    VIEW3D_PT_tg4mm_motion,
    VIEW3D_PT_tg4mm_band,
    VIEW3D_PT_tg4mm_frequencies,
    VIEW3D_PT_tg4mm_look,
    VIEW3D_PT_tg4mm_colours,
)


def _draw_all(layout: Any, modifier: Any, *inputs: str) -> None:
    """Draw those of the inputs that the modifier has."""
    for name in inputs:
        if compat.has_input(modifier, name):
            compat.draw_input(layout, modifier, name, slider=name == names.ALPHA)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
