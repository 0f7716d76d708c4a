"""The mark in the 3D view at the point that the probe took."""

from typing import Any

import bpy
import numpy as np

from ..nodes import points, scene
from . import picking

COLOUR, RADIUS = (1.0, 0.55, 0.1, 1.0), 9.0  # pixels, at a resolution scale of 1
_handler: Any = None


def place(scene_: Any, obj: Any) -> np.ndarray | None:
    """Return where the probed point is drawn now, [3] in the world; None without a reading."""
    found = picking.stored(obj)
    if found is None or not found.place:
        return None
    moved = (picking.shown_weights(scene_, obj)[:, None] * found.phasors).real.sum(axis=0)
    applied, world = points.applied(obj.data), np.array(obj.matrix_world)
    inner = np.append(np.array(found.place) + moved, 1.0)
    return np.asarray((world @ (inner if applied is None else applied @ inner))[:3])


def _draw() -> None:
    from bpy_extras.view3d_utils import location_3d_to_region_2d
    from gpu_extras.presets import draw_circle_2d  # needs a graphics card

    context = bpy.context
    obj = scene.splat_object(context)
    if not context.space_data.overlay.show_overlays or not scene.moves(obj) or not obj.visible_get():
        return
    where = place(context.scene, obj)
    if where is None:
        return
    at = location_3d_to_region_2d(context.region, context.region_data, where)
    if at is not None:
        scale = context.preferences.system.ui_scale
        for radius, colour in ((RADIUS, COLOUR), (RADIUS + 1.5, (0.0, 0.0, 0.0, 1.0)), (2.0, COLOUR)):
            draw_circle_2d(at, colour, radius * scale)


def register() -> None:
    global _handler
    if not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    global _handler
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    _handler = None
