"""Operators that set the band: round a peak, or the whole of it."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import FloatProperty

from .. import names, preferences
from ..nodes import scene, spectrum
from . import analysis


class TG4MM_OT_band(bpy.types.Operator):
    """Magnify every frequency of the file"""

    bl_idname = "tg4mm.band"
    bl_label = "Set Band"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

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
    def poll(cls, context: Any) -> bool:
        return scene.moves(scene.splat_object(context))

    @classmethod
    def description(cls, context: Any, properties: Any) -> str:
        if not properties.frequency:
            return "Magnify every frequency of the file"
        width = properties.width or preferences.get(context).band_width
        low, high = spectrum.band_around(properties.frequency, width)
        return f"Magnify {low:g} to {high:g} Hz, the band around this peak (its width: see the preferences)"

    def execute(self, context: Any) -> set[str]:
        obj = scene.splat_object(context)
        if self.frequency:
            width = self.width or preferences.get(context).band_width
            low, high = spectrum.band_around(self.frequency, width)
        else:
            low, high = spectrum.whole_band(list(obj[names.FREQUENCIES]), float(obj[names.FPS]))
        analysis.set_band(obj, low, high)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory([TG4MM_OT_band])
