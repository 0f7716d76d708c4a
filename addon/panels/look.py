"""Operators that set up a scene or a view for splats: true colours, Solid view, colour range, band."""

from functools import lru_cache
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty

from tg4mm.core.errors import Tg4mmError

from .. import compat, names, preferences
from ..declare import Declared, on_motion, on_splats
from ..nodes import axes, blending, clock, drawing, scene, shapes
from . import analysis, pictures

_EXACT = {names.DRAW: shapes.AS_TRAINED, names.VIEW_COLOUR: True, names.BLEND: True}
_BEFORE_EXACT = "tg4mm_before_exact"  # custom property of an object: what these were


_ui = Declared()
register, unregister = _ui.register, _ui.unregister
_ON = {"on": BoolProperty(name="On", default=True, options={"SKIP_SAVE"})}
_MIDDLE = FloatProperty(
    name="Middle", description="Middle of the band, Hz; 0: all frequencies", min=0.0, precision=3
)
_WIDTH = FloatProperty(
    name="Width", description="Width of the band, Hz; 0: as in the preferences", min=0.0, precision=3
)


@_ui.operator("Set Up True Colours", on_splats)
def true_colours(operator: Any, context: Any) -> str:
    """Show the colours of the file: the view transform that they are made for, and the samples and transparent bounces
    that splats need"""
    changed = blending.true_colours(context.scene)
    return _settings(changed) if changed else "Already set up"


@_ui.operator("Restore Settings")
def restore_picture(operator: Any, context: Any) -> str:
    """Restore the frame rate, frame range, view transform, samples, shading and camera as they were before the first
    splats. A hidden start-up cube stays hidden"""
    return _settings(blending.restore(context.scene), "restored")


def _settings(count: int, done: str = "changed") -> str:
    return f"{count} setting{'' if count == 1 else 's'} {done}"


@_ui.operator("Exact Look", on_splats, **_ON)
def exact_look(operator: Any, context: Any) -> str:
    """Draw the active splats as they were trained: as Splats, in the colours that the camera sees, blended as trained.
    Slow. Click again to go back"""
    obj = scene.splat_object(context)
    modifier = scene.splat_modifier(obj)
    shown = [name for name in _EXACT if compat.has_input(modifier, name)]
    if operator.on:
        obj[_BEFORE_EXACT] = {name: compat.get_input(modifier, name) for name in shown}
    wanted = _EXACT if operator.on else dict(obj.pop(_BEFORE_EXACT, {names.DRAW: drawing.best(*_size(obj))}))
    for name in shown:
        compat.set_input(modifier, name, wanted.get(name, False))
    blending.true_colours(context.scene, bool(wanted.get(names.BLEND, False)))
    return f"Exact Look {'on' if operator.on else 'off'}"


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


@_ui.operator("Blend as Trained", on_splats, **_ON)
def blend_as_trained(operator: Any, context: Any) -> None:
    """Mix the colours of splats as training and other viewers do: view transform Raw, and all splats of the scene drawn
    for it. For scenes of splats alone, as it shows other objects and lamps too dark. Click again to end it"""
    blending.true_colours(context.scene, operator.on)


@_ui.operator("Colours in Solid View", on_splats, **_ON)
def solid_colours(operator: Any, context: Any) -> None:
    """Show the colours in Solid view too; slow with more than some ten thousand Gaussians. Click again to end it"""
    compat.set_input(scene.splat_modifier(scene.splat_object(context)), names.SOLID_COLOUR, operator.on)
    shading = getattr(context.space_data, "shading", None)
    if shading is not None:
        shading.color_type, shading.light = ("VERTEX", "FLAT") if operator.on else ("MATERIAL", "STUDIO")


@_ui.operator("One Mesh", on_splats)
def one_mesh(operator: Any, context: Any) -> None:
    """Draw one mesh in place of instances, so that Array and other modifiers after this one see it; for small sets"""
    compat.set_input(scene.splat_modifier(scene.splat_object(context)), names.SOLID_COLOUR, True)


@_ui.operator(
    "Up", on_splats, axes=EnumProperty(name="Up", items=[(*item, "") for item in axes.LABELS.items()])
)
def up(operator: Any, context: Any) -> None:
    """Turn the object so that this axis of its file points up here"""
    axes.stand_up(scene.splat_object(context), operator.axes)


@_ui.operator("Match Scene Scale to File", on_splats)
def file_units(operator: Any, context: Any) -> str:
    """Set the scene's Unit Scale so that Blender's lengths are those of the file"""
    metres = analysis.metres_per_unit(scene.splat_object(context))
    if metres is None:
        raise Tg4mmError("The file does not state its scale")
    context.scene.unit_settings.scale_length = metres
    return f"Unit Scale of the scene set to {metres:.4g} m"


@_ui.operator("Fit Colour Range", on_motion)
def fit_colour_range(operator: Any, context: Any) -> str:
    """Set the range so that the last colour shows the largest amplitude of the enabled modes in the band"""
    obj = scene.splat_object(context)
    largest = analysis.fit_colour_range(obj)
    return f"0 to {preferences.unit_for(context, obj).text(largest)}"


def _band(context: Any, settings: Any) -> tuple[float, float]:
    return clock.band_around(settings.frequency, settings.width or preferences.get(context).band_width)


def _about_band(context: Any, properties: Any) -> str:
    if not properties.frequency:
        return str(band.__doc__)
    low, high = _band(context, properties)
    return f"Magnify {low:g} to {high:g} Hz, the band around this peak (its width: see the preferences)"


@_ui.operator("Set Band", on_motion, about=_about_band, frequency=_MIDDLE, width=_WIDTH)
def band(operator: Any, context: Any) -> None:
    """Magnify every frequency of the file"""
    obj = scene.splat_object(context)
    if operator.frequency:
        analysis.set_band(obj, *_band(context, operator))
    else:
        analysis.set_band(obj, *clock.whole_band(list(obj[names.FREQUENCIES]), float(obj[names.FPS])))
    pictures.prepare(*analysis.spectrum_picture(context, obj))
