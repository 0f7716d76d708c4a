"""The legend of the colours in the 3D view: the panel's picture, drawn over the lower left corner."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .. import preferences
from ..nodes import scene
from . import analysis, view_settings

SIDE = 200  # pixels, at a resolution scale of 1
EDGE = 16
ABOVE = 44  # room for the box with the last operator's settings

_handler: Any = None
_drawn: tuple[Any, Any] | None = None  # what was drawn last, and its texture


def wanted(context: Any) -> tuple[Any, ...] | None:
    """Function and arguments of the legend that a 3D view shows; None for none."""
    space = context.space_data
    if space is None or not space.overlay.show_overlays or not view_settings.of(context).legend:
        return None
    obj = scene.splat_object(context)
    if obj is None or not obj.visible_get():
        return None
    return analysis.legend_picture(obj, preferences.unit_for(context, obj), context.scene)


def _draw() -> None:
    global _drawn
    from gpu_extras.presets import draw_texture_2d  # needs a graphics card

    context = bpy.context
    key = wanted(context)
    if key is None:
        return
    if _drawn is None or _drawn[0] != key:
        _drawn = key, _texture(key[0](*key[1:]))
    scale = context.preferences.system.ui_scale
    tools = next((r for r in context.area.regions if r.type == "TOOLS"), None)
    left = EDGE * scale + (tools.width if tools is not None and tools.width > 1 else 0)
    draw_texture_2d(_drawn[1], (left, ABOVE * scale), SIDE * scale, SIDE * scale)


def _texture(picture: np.ndarray) -> Any:
    import gpu

    height, width = picture.shape[:2]
    data = np.ascontiguousarray(picture[::-1], np.float32).ravel()
    buffer = gpu.types.Buffer("FLOAT", len(data), data)
    return gpu.types.GPUTexture((width, height), format="RGBA8", data=buffer)


def register() -> None:
    global _handler
    if not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    global _handler, _drawn
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    _handler = _drawn = None
