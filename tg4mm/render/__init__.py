"""Pictures and videos of a run: from its test cameras, from a file of cameras, or on an orbit."""

from tg4mm.render.cameras import Camera, cameras_from_file, capture_cameras, look_at_point, orbit
from tg4mm.render.image import render_features, render_image
from tg4mm.render.sequence import RenderRequest, render_orbit, render_sequence

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
