"""Session settings, and the legends in the lower left corner of the 3D view."""

from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, PointerProperty

from .. import preferences
from ..nodes import scene
from . import analysis

SIDE = 200  # pixels, at a resolution scale of 1
EDGE = 16
MOST, LETTERS = 3, 28  # legends side by side; of the names above them
ABOVE = 44  # room for the box with the last operator's settings

_handler: Any = None
_drawn: dict[tuple[Any, ...], Any] = {}  # the legends that were drawn last, and their textures


class TG4MM_view(bpy.types.PropertyGroup):
    """Session settings, kept on the window manager and not saved in files"""

    measure: EnumProperty(  # type: ignore[valid-type]
        name="Amplitude",
        description="Statistic over all Gaussians that the spectrum's bars show",
        items=[
            ("RMS", "RMS", "Root mean square of the Gaussians' amplitudes, weighted by opacity"),
            ("PEAK", "Largest", "Amplitude of the Gaussian that moves most"),
        ],
    )
    legend: BoolProperty(  # type: ignore[valid-type]
        name="Legend in the View",
        description="Show a legend of the colours in the lower left corner of the 3D view, with its overlays",
        default=True,
    )


def of(context: Any) -> Any:
    """Return the session settings."""
    return context.window_manager.tg4mm_view


def wanted(context: Any) -> list[tuple[str, tuple[Any, ...]]]:
    """The legends that a 3D view shows, of its coloured objects whichever is active: their names, and for each legend
    its function and arguments. The active object's comes first; objects that are coloured alike share one."""
    space = context.space_data
    if space is None or not space.overlay.show_overlays or not of(context).legend:
        return []
    active = scene.splat_object(context)
    seen = sorted(filter(_is_seen, context.view_layer.objects), key=lambda obj: obj != active)
    shared: dict[tuple[Any, ...], list[str]] = {}
    for obj in seen:
        picture = analysis.legend_picture(obj, preferences.unit_for(context, obj), context.scene)
        if picture is not None:
            shared.setdefault(picture, []).append(obj.name)
    return [(", ".join(labels), picture) for picture, labels in list(shared.items())[:MOST]]


def _is_seen(obj: Any) -> bool:
    modifier = scene.splat_modifier(obj)
    return modifier is not None and modifier.node_group is not None and obj.visible_get()


def _draw() -> None:
    global _drawn
    from gpu_extras.presets import draw_texture_2d  # needs a graphics card

    context = bpy.context
    legends = wanted(context)
    _drawn = {picture: _drawn.get(picture) or _texture(picture[0](*picture[1:])) for _, picture in legends}
    scale = context.preferences.system.ui_scale
    tools = next((r for r in context.area.regions if r.type == "TOOLS"), None)
    left = EDGE * scale + (tools.width if tools is not None and tools.width > 1 else 0)
    for label, picture in legends:
        draw_texture_2d(_drawn[picture], (left, ABOVE * scale), SIDE * scale, SIDE * scale)
        if len(legends) > 1:
            _write(label, left, (ABOVE + SIDE + 4) * scale, scale)
        left += (SIDE + EDGE) * scale


def _write(label: str, x: float, y: float, scale: float) -> None:
    import blf

    blf.size(0, 12 * scale)
    blf.position(0, x, y, 0)
    blf.draw(0, label[:LETTERS])


def _texture(picture: np.ndarray) -> Any:
    import gpu

    height, width = picture.shape[:2]
    data = np.ascontiguousarray(picture[::-1], np.float32).ravel()
    buffer = gpu.types.Buffer("FLOAT", len(data), data)
    return gpu.types.GPUTexture((width, height), format="RGBA8", data=buffer)


def register() -> None:
    global _handler
    bpy.utils.register_class(TG4MM_view)
    bpy.types.WindowManager.tg4mm_view = PointerProperty(type=TG4MM_view)
    if not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    global _handler, _drawn
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    _handler, _drawn = None, {}
    del bpy.types.WindowManager.tg4mm_view
    bpy.utils.unregister_class(TG4MM_view)
