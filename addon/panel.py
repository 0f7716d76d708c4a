"""The sidebar of the 3D view: the magnification slider of the active splat object."""

from __future__ import annotations

from typing import Any

import bpy

from . import compat, nodes, scene


class VIEW3D_PT_tg4mm(bpy.types.Panel):
    """Motion of the active splat object"""

    bl_label = "TG4MM"
    bl_idname = "VIEW3D_PT_tg4mm"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "TG4MM"

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.operator("import_scene.tg4mm_splat", text="Import Splat", icon="IMPORT")
        modifier = scene.splat_modifier(context.object)
        if modifier is None or modifier.node_group is None:
            layout.label(text="Select an imported splat object", icon="INFO")
            return
        frequencies = list(context.object[scene.FREQUENCIES])
        if frequencies:
            for name in (nodes.ALPHA, nodes.LOW, nodes.HIGH, nodes.FIRST, nodes.SPEED):
                compat.draw_input(layout, modifier, name)
            layout.label(text=f"Modes: {', '.join(f'{f:g}' for f in frequencies)} Hz")
        else:
            layout.label(text="This file holds no motion", icon="INFO")
        for name in (nodes.SIZE, nodes.MIN_OPACITY):
            compat.draw_input(layout, modifier, name)
        if context.scene.view_settings.view_transform != "Standard":
            layout.label(text="View transform Standard shows true colours", icon="COLOR")


def register() -> None:
    bpy.utils.register_class(VIEW3D_PT_tg4mm)


def unregister() -> None:
    bpy.utils.unregister_class(VIEW3D_PT_tg4mm)
