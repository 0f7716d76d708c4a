"""Pictures and videos of a run: from its test cameras, from a file of cameras, or on an orbit.

The names are imported when they are first asked for (tg4mm/core/lazy.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tg4mm.core.lazy import lazily

if TYPE_CHECKING:
    from tg4mm.show.render.cameras import Camera, cameras_from_file, capture_cameras, look_at_point, orbit
    from tg4mm.show.render.image import render, render_features, render_image
    from tg4mm.show.render.sequence import RenderRequest, render_orbit, render_sequence

__all__ = [
    "Camera",
    "RenderRequest",
    "cameras_from_file",
    "capture_cameras",
    "look_at_point",
    "orbit",
    "render",
    "render_features",
    "render_image",
    "render_orbit",
    "render_sequence",
]

__getattr__ = lazily(
    __name__,
    {
        "Camera": "cameras",
        "RenderRequest": "sequence",
        "cameras_from_file": "cameras",
        "capture_cameras": "cameras",
        "look_at_point": "cameras",
        "orbit": "cameras",
        "render": "image",
        "render_features": "image",
        "render_image": "image",
        "render_orbit": "sequence",
        "render_sequence": "sequence",
    },
)
