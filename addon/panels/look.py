"""Operators that set a scene or a view up for splats: true colours, Solid view, the range of the colour map."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty

from .. import compat, names, preferences
from ..core.errors import Tg4mmError
from ..nodes import scene
from ..nodes.blending import true_colours
from . import analysis


class _OnSplats(bpy.types.Operator):
    """An operator on the active splat object"""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None


class TG4MM_OT_true_colours(_OnSplats):
    """Show the colours of the file: the view transform that they are made for, and transparent bounces for splats"""

    bl_idname = "tg4mm.true_colours"
    bl_label = "Set Up True Colours"

    def execute(self, context: Any) -> set[str]:
        true_colours(context.scene)
        return {"FINISHED"}


class TG4MM_OT_blend_as_trained(_OnSplats):
    """Mix the colours of splats as training and other viewers do: view transform Raw, and all splats of the scene drawn
    for it. For scenes of splats alone, as it shows other objects and lamps too dark. Click again to end it"""

    bl_idname = "tg4mm.blend_as_trained"
    bl_label = "Blend as Trained"

    on: BoolProperty(name="On", default=True, options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        true_colours(context.scene, self.on)
        return {"FINISHED"}


class TG4MM_OT_solid_colours(_OnSplats):
    """Show the colours in Solid view too; slow with more than some ten thousand Gaussians. Click again to end it"""

    bl_idname = "tg4mm.solid_colours"
    bl_label = "Colours in Solid View"

    on: BoolProperty(name="On", default=True, options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        compat.set_input(scene.splat_modifier(scene.splat_object(context)), names.SOLID_COLOUR, self.on)
        shading = getattr(context.space_data, "shading", None)
        if shading is not None:
            shading.color_type, shading.light = ("VERTEX", "FLAT") if self.on else ("MATERIAL", "STUDIO")
        return {"FINISHED"}


class TG4MM_OT_one_mesh(_OnSplats):
    """Draw one mesh in place of instances, so that Array and other modifiers after this one see it; for small sets"""

    bl_idname = "tg4mm.one_mesh"
    bl_label = "One Mesh"

    def execute(self, context: Any) -> set[str]:
        compat.set_input(scene.splat_modifier(scene.splat_object(context)), names.SOLID_COLOUR, True)
        return {"FINISHED"}


class TG4MM_OT_file_units(_OnSplats):
    """Let Blender's own lengths in this scene be those of the file, by the scene's Unit Scale"""

    bl_idname = "tg4mm.file_units"
    bl_label = "Take the File's Metres"

    def execute(self, context: Any) -> set[str]:
        metres = analysis.metres_per_unit(scene.splat_object(context))
        if metres is None:
            self.report({"ERROR"}, "The file does not say how long its unit is")
            return {"CANCELLED"}
        context.scene.unit_settings.scale_length = metres
        self.report({"INFO"}, f"Unit Scale of the scene set to {metres:.4g} m")
        return {"FINISHED"}


class TG4MM_OT_fit_colour_range(_OnSplats):
    """Let the last colour stand for the largest amplitude of the modes shown in the band"""

    bl_idname = "tg4mm.fit_colour_range"
    bl_label = "Fit Colour Range"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.moves(scene.splat_object(context))

    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        try:
            largest = analysis.fit_colour_range(obj)
        except Tg4mmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"0 to {preferences.unit_for(context, obj).text(largest)}")
        return {"FINISHED"}


_CLASSES = (
    TG4MM_OT_true_colours,
    TG4MM_OT_blend_as_trained,
    TG4MM_OT_solid_colours,
    TG4MM_OT_one_mesh,
    TG4MM_OT_file_units,
    TG4MM_OT_fit_colour_range,
)


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
