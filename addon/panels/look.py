"""Operators that set up a scene or a view for splats: true colours, Solid view, colour range, band."""

from functools import lru_cache
from typing import Any

import bpy
from bpy.props import BoolProperty, FloatProperty

from tg4mm.core.errors import Tg4mmError

from .. import compat, names, preferences
from ..nodes import blending, clock, drawing, scene, shapes
from ..reporting import reports
from . import analysis

_EXACT = {names.DRAW: shapes.AS_TRAINED, names.VIEW_COLOUR: True, names.BLEND: True}
_BEFORE_EXACT = "tg4mm_before_exact"  # custom property of an object: what these were


class _OnSplats(bpy.types.Operator):
    """An operator on the active splat object"""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.splat_object(context) is not None


class _OnMotion(_OnSplats):
    """An operator on an object with modes of motion"""

    @classmethod
    def poll(cls, context: Any) -> bool:
        return scene.moves(scene.splat_object(context))


class _OnScene(_OnSplats):
    """An operator that sets up a scene and reports what it changed"""

    def execute(self, context: Any) -> set[str]:
        self.report({"INFO"}, self.set_up(context) or "Nothing to change")
        return {"FINISHED"}


class TG4MM_OT_true_colours(_OnScene):
    """Show the colours of the file: the view transform that they are made for, and the samples and transparent bounces
    that splats need"""

    bl_idname = "tg4mm.true_colours"
    bl_label = "Set Up True Colours"

    def set_up(self, context: Any) -> str:
        return blending.true_colours(context.scene)


class TG4MM_OT_restore_picture(_OnScene):
    """Restore the view transform, samples and bounces that the scene had before its first splats"""

    bl_idname = "tg4mm.restore_picture"
    bl_label = "Undo Picture Settings"

    def set_up(self, context: Any) -> str:
        return blending.restore(context.scene)


class TG4MM_OT_exact_look(_OnScene):
    """Draw the active splats as they were trained: as Splats, in the colours that the camera sees, blended as trained.
    Slow. Click again to go back"""

    bl_idname = "tg4mm.exact_look"
    bl_label = "Exact Look"

    on: BoolProperty(name="On", default=True, options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def set_up(self, context: Any) -> str:
        obj = scene.splat_object(context)
        modifier = scene.splat_modifier(obj)
        shown = [name for name in _EXACT if compat.has_input(modifier, name)]
        if self.on:
            obj[_BEFORE_EXACT] = {name: compat.get_input(modifier, name) for name in shown}
        wanted = _EXACT if self.on else dict(obj.pop(_BEFORE_EXACT, {names.DRAW: drawing.best(*_size(obj))}))
        for name in shown:
            compat.set_input(modifier, name, wanted.get(name, False))
        return f"Draw As {wanted[names.DRAW]}; " + blending.true_colours(
            context.scene, bool(wanted.get(names.BLEND, False))
        )


def is_exact(obj: Any) -> bool:
    """Return whether an object is drawn as by Exact Look."""
    modifier = scene.splat_modifier(obj)
    shown = {name: value for name, value in _EXACT.items() if compat.has_input(modifier, name)}
    return all(compat.get_input(modifier, name) == value for name, value in shown.items())


def _size(obj: Any) -> tuple[int, int]:
    return len(scene.first_mesh(obj).vertices), len(obj[names.FREQUENCIES])


@lru_cache(maxsize=16)
def _far_out(name: str, count: int) -> tuple[int, float]:
    return drawing.far_out(bpy.data.meshes[name])


def far_out(obj: Any) -> tuple[int, float]:
    """Return `drawing.far_out`, cached per mesh and vertex count; no outliers in Edit Mode."""
    mesh = obj.data
    in_edit_mode = mesh.is_editmode or scene.sequence_frames(obj) is not None
    return (0, 0.0) if in_edit_mode else _far_out(mesh.name, len(mesh.vertices))


class TG4MM_OT_blend_as_trained(_OnSplats):
    """Mix the colours of splats as training and other viewers do: view transform Raw, and all splats of the scene drawn
    for it. For scenes of splats alone, as it shows other objects and lamps too dark. Click again to end it"""

    bl_idname = "tg4mm.blend_as_trained"
    bl_label = "Blend as Trained"

    on: BoolProperty(name="On", default=True, options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def execute(self, context: Any) -> set[str]:
        blending.true_colours(context.scene, self.on)
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
    """Set the scene's Unit Scale so that Blender's lengths are those of the file"""

    bl_idname = "tg4mm.file_units"
    bl_label = "Take the File's Metres"

    @reports()
    def execute(self, context: Any) -> set[str]:
        metres = analysis.metres_per_unit(scene.splat_object(context))
        if metres is None:
            raise Tg4mmError("The file does not state its scale")
        context.scene.unit_settings.scale_length = metres
        self.report({"INFO"}, f"Unit Scale of the scene set to {metres:.4g} m")
        return {"FINISHED"}


class TG4MM_OT_fit_colour_range(_OnMotion):
    """Set the last colour to the largest amplitude of the enabled modes in the band"""

    bl_idname = "tg4mm.fit_colour_range"
    bl_label = "Fit Colour Range"

    @reports()
    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        largest = analysis.fit_colour_range(obj)
        self.report({"INFO"}, f"0 to {preferences.unit_for(context, obj).text(largest)}")
        return {"FINISHED"}


class TG4MM_OT_band(_OnMotion):
    """Magnify every frequency of the file"""

    bl_idname = "tg4mm.band"
    bl_label = "Set Band"

    frequency: FloatProperty(  # type: ignore[valid-type]
        name="Middle", description="Middle of the band, Hz; 0 for the whole of it", min=0.0, precision=3
    )
    width: FloatProperty(  # type: ignore[valid-type]
        name="Width",
        description="Width of the band, Hz; 0 for the width in the preferences",
        min=0.0,
        precision=3,
    )

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        if not properties.frequency:
            return "Magnify every frequency of the file"
        width = properties.width or preferences.get(context).band_width
        low, high = clock.band_around(properties.frequency, width)
        return f"Magnify {low:g} to {high:g} Hz, the band around this peak (its width: see the preferences)"

    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        if self.frequency:
            width = self.width or preferences.get(context).band_width
            low, high = clock.band_around(self.frequency, width)
        else:
            low, high = clock.whole_band(list(obj[names.FREQUENCIES]), float(obj[names.FPS]))
        analysis.set_band(obj, low, high)
        return {"FINISHED"}


_CLASSES = (
    TG4MM_OT_true_colours, TG4MM_OT_restore_picture, TG4MM_OT_exact_look, TG4MM_OT_blend_as_trained,
    TG4MM_OT_solid_colours, TG4MM_OT_one_mesh, TG4MM_OT_file_units, TG4MM_OT_fit_colour_range, TG4MM_OT_band,
)  # fmt: skip


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
