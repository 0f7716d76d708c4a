"""Pictures and videos of a run: from its test cameras, from a file of cameras, or on an orbit.

The names are imported when they are first asked for: what lies beside them here and needs no torch (pages, charts,
picture files, image metrics) can then be imported without it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tg4mm.render.cameras import Camera, cameras_from_file, capture_cameras, look_at_point, orbit
    from tg4mm.render.image import render_features, render_image
    from tg4mm.render.sequence import RenderRequest, render_orbit, render_sequence

_WHERE = {
    "Camera": "tg4mm.render.cameras",
    "RenderRequest": "tg4mm.render.sequence",
    "cameras_from_file": "tg4mm.render.cameras",
    "capture_cameras": "tg4mm.render.cameras",
    "look_at_point": "tg4mm.render.cameras",
    "orbit": "tg4mm.render.cameras",
    "render_features": "tg4mm.render.image",
    "render_image": "tg4mm.render.image",
    "render_orbit": "tg4mm.render.sequence",
    "render_sequence": "tg4mm.render.sequence",
}

__all__ = [
    "Camera",
    "RenderRequest",
    "cameras_from_file",
    "capture_cameras",
    "look_at_point",
    "orbit",
    "render_features",
    "render_image",
    "render_orbit",
    "render_sequence",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name]), name)
