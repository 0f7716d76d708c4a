"""Differences between Blender 4.5 and 5.2, in one place."""

from __future__ import annotations

import bpy


def is_5() -> bool:
    """True from Blender 5.0 on."""
    return bool(bpy.app.version >= (5, 0, 0))


def version() -> str:
    """Blender's version as numbers, "4.5.15"."""
    return ".".join(str(n) for n in bpy.app.version)


def eevee() -> str:
    """The engine's name."""
    return "BLENDER_EEVEE" if is_5() else "BLENDER_EEVEE_NEXT"


def set_float_exr(settings: bpy.types.ImageFormatSettings) -> None:
    """32-bit RGBA EXR, not compressed: it is read back at once."""
    if is_5():
        settings.media_type = "IMAGE"
    settings.file_format = "OPEN_EXR"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"


def set_multilayer_exr(settings: bpy.types.ImageFormatSettings) -> None:
    """32-bit multilayer EXR in one part."""
    if is_5():
        settings.media_type = "MULTI_LAYER_IMAGE"
        settings.use_exr_interleave = True
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"


def use_physical_sky(node: bpy.types.ShaderNodeTexSky) -> None:
    """The sky model of single scattering with a sun disc, called Nishita before 5.0."""
    node.sky_type = "SINGLE_SCATTERING" if is_5() else "NISHITA"
    node.sun_disc = True
