"""The sidebar of the 3D view, tab TG4MM: import, motion, look, colours of the active splat object."""

from __future__ import annotations

from typing import Any

import bpy

from . import analysis, compat, names, scene


class _Tab:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "TG4MM"


class _SplatTab(_Tab):
    """A panel that is there where a splat object is active; sub-panels name their parent."""

    bl_parent_id = "VIEW3D_PT_tg4mm"

    @classmethod
    def poll(cls, context: Any) -> bool:
        modifier = scene.splat_modifier(context.object)
        return modifier is not None and modifier.node_group is not None


class VIEW3D_PT_tg4mm(_Tab, bpy.types.Panel):
    """Splats that move"""

    bl_label = "TG4MM"
    bl_idname = "VIEW3D_PT_tg4mm"

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.operator("import_scene.tg4mm_splat", text="Import Splats", icon="IMPORT")
        if not _SplatTab.poll(context):
            layout.label(text="Select an imported splat object", icon="INFO")


class VIEW3D_PT_tg4mm_motion(_SplatTab, bpy.types.Panel):
    """Magnification and time of the active splat object"""

    bl_label = "Motion"
    bl_idname = "VIEW3D_PT_tg4mm_motion"

    def draw(self, context: Any) -> None:
        layout, modifier = self.layout, scene.splat_modifier(context.object)
        layout.use_property_split = True
        if not (compat.has_input(modifier, names.FIRST)):
            layout.label(text="This file holds no motion", icon="INFO")
            return
        _draw_all(layout, modifier, names.ALPHA, names.LOW, names.HIGH)
        _draw_all(layout, modifier, names.FIRST, names.SPEED, names.LOOP)
        frequencies = names.toggles(context.object[names.FREQUENCIES])
        if frequencies:
            column = layout.column(heading="Play", align=True)
            _draw_all(column, modifier, *frequencies)


class VIEW3D_PT_tg4mm_look(_SplatTab, bpy.types.Panel):
    """How the active splat object is drawn"""

    bl_label = "Look"
    bl_idname = "VIEW3D_PT_tg4mm_look"

    def draw(self, context: Any) -> None:
        layout, modifier = self.layout, scene.splat_modifier(context.object)
        layout.use_property_split = True
        _draw_all(layout, modifier, names.DRAW, names.SIZE)
        drawn = compat.get_input(modifier, names.DRAW)
        if drawn in (names.ELLIPSOIDS, names.POINTS):
            compat.draw_input(layout, modifier, names.RADIUS)
        if drawn == names.ARROWS:
            _draw_all(layout, modifier, names.ARROW_LENGTH, names.ARROW_EVERY)
        faintest = names.MIN_SPLAT_OPACITY if drawn == names.SPLATS else names.MIN_OPACITY
        _draw_all(layout, modifier, faintest, names.VIEW_COLOUR, names.SOLID_COLOUR)
        layout.operator("tg4mm.solid_colours", icon="SHADING_SOLID")
        if context.scene.view_settings.view_transform != "Standard":
            layout.operator("tg4mm.true_colours", icon="COLOR")


class VIEW3D_PT_tg4mm_colours(_SplatTab, bpy.types.Panel):
    """Colours that show amplitude or phase"""

    bl_label = "Colour By"
    bl_idname = "VIEW3D_PT_tg4mm_colours"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return super().poll(context) and compat.has_input(
            scene.splat_modifier(context.object), names.COLOUR_BY
        )

    def draw(self, context: Any) -> None:
        layout, modifier = self.layout, scene.splat_modifier(context.object)
        layout.use_property_split = True
        compat.draw_input(layout, modifier, names.COLOUR_BY)
        legend = analysis.legend(context.object)
        if legend is None:
            return
        compat.draw_input(layout, modifier, names.COLOUR_RANGE)
        layout.operator("tg4mm.fit_colour_range", icon="FULLSCREEN_EXIT")
        if legend.kind == names.AMPLITUDE_COLOUR:
            metric = "" if legend.high_mm is None else f" ({legend.high_mm:.4g} mm)"
            layout.label(text=f"0 to {legend.high:.4g} scene units{metric}")
        else:
            layout.label(text="0 to 360°; grey moves too little to tell")


_CLASSES = (VIEW3D_PT_tg4mm, VIEW3D_PT_tg4mm_motion, VIEW3D_PT_tg4mm_look, VIEW3D_PT_tg4mm_colours)


def _draw_all(layout: Any, modifier: Any, *inputs: str) -> None:
    """Draw those of the inputs that the modifier has."""
    for name in inputs:
        if compat.has_input(modifier, name):
            compat.draw_input(layout, modifier, name)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
