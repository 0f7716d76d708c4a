"""Preferences of the extension: how imports start, how numbers are written, where the core is installed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, StringProperty

from . import names
from .nodes import drawing
from .nodes.points import shown_size
from .nodes.shapes import available
from .units import Unit, unit_of

PACKAGE = __package__  # "bl_ext.user_default.tg4mm" where installed

_WALKTHROUGH = (
    "Needed to train, and for depth, normals and the report of a dataset:",
    "1. In a terminal: python3.11 -m venv tg4mm-env",
    "2. With the release's wheel: tg4mm-env/bin/pip install 'tg4mm-0.1.0-py3-none-any.whl[core,generate]'",
    "3. Above: choose tg4mm-env/bin/python (Windows: Scripts\\python.exe), and press Test",
)


class TG4MM_preferences(bpy.types.AddonPreferences):
    """Settings for all files"""

    bl_idname = PACKAGE

    draw_as: EnumProperty(  # type: ignore[valid-type]
        name="Draw As",
        description="How splats are drawn after import",
        items=[
            (
                drawing.AUTOMATIC,
                "Automatic",
                "Blender's own splats if it has them, otherwise the best shapes that play smoothly",
            ),
            *((name, name, mode.about) for name, mode in available(moves=True).items()),
        ],
        default=drawing.AUTOMATIC,
    )
    band_width: FloatProperty(  # type: ignore[valid-type]
        name="Band Around a Peak",
        description="Width, in Hz, of the band that a peak's button sets; the peak is in its middle",
        default=1.0,
        min=0.001,
        soft_max=20.0,
        step=10,
        precision=2,
    )
    most: IntProperty(  # type: ignore[valid-type]
        name="Max Gaussians",
        description="Limit, in Gaussians of all chosen files together, that the import proposes",
        default=5_000_000,
        min=1,
        max=100_000_000,
    )
    length_unit: EnumProperty(  # type: ignore[valid-type]
        name="Lengths",
        description="Unit in which amplitudes and displacements are shown and exported",
        items=[
            ("METRIC", "Millimetres", "Millimetres where the file says how long a scene unit is"),
            ("SCENE", "Scene Units", "Scene units always"),
        ],
        default="METRIC",
    )
    digits: IntProperty(  # type: ignore[valid-type]
        name="Digits",
        description="Number of significant digits in the panel",
        default=4,
        min=2,
        max=8,
    )
    core_python: StringProperty(  # type: ignore[valid-type]
        name="Python of the Core",
        description="Python of the environment in which tg4mm is installed; needed only to generate and to train",
        subtype="FILE_PATH",
    )

    def draw(self, context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        column = layout.column(heading="Import")
        column.prop(self, "draw_as")
        column.prop(self, "most")
        column = layout.column(heading="Numbers")
        column.prop(self, "band_width", text="Band Around a Peak (Hz)")
        column.prop(self, "length_unit")
        column.prop(self, "digits")
        column = layout.column(heading="Generate and Train")
        column.prop(self, "core_python")
        column.operator("tg4mm.test_core", icon="CHECKMARK")
        for line in _WALKTHROUGH:
            column.label(text=line)


def get(context: Any) -> Any:
    """The preferences; where the extension runs without being enabled as one (a test), their defaults."""
    addon = context.preferences.addons.get(PACKAGE)
    return TG4MM_defaults if addon is None or addon.preferences is None else addon.preferences


def unit_for(context: Any, obj: Any) -> Unit:
    """The unit that lengths of a splat object, which are those of its file, are shown in.

    Millimetres are of what was recorded, whatever size it is shown in. Scene units are as the scene has it now: the
    object's scale and what Apply Transform did count, of an uneven one the mean factor.
    """
    chosen = get(context)
    scale = obj.get(names.UNIT_SCALE)
    unit = unit_of(None if scale is None else float(scale), chosen.length_unit == "METRIC", chosen.digits)
    if unit.name == "mm":
        return unit
    # To what float32 holds: a picture of a spectrum is drawn anew for another unit.
    return replace(unit, per_scene_unit=float(f"{shown_size(obj):.5g}"))


class TG4MM_defaults:
    """Values that `get` returns without an enabled extension; the same names."""

    draw_as, band_width, most = drawing.AUTOMATIC, 1.0, 5_000_000
    length_unit, digits, core_python = "METRIC", 4, ""


register, unregister = bpy.utils.register_classes_factory([TG4MM_preferences])
